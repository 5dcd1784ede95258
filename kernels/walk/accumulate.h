/* How many work items add into one number.
 *
 * Values are rounded to integers and summed in fixed point, 64 bits wide: the sum has the same
 * bits whatever the order, and does not drift however many they are. Devices without 64-bit
 * atomics add the two halves apart and carry. The host scales what is added so that one unit
 * is the wanted resolution.
 *
 * A sum that leaves +-LARGEST_SUM (2^62, half of what 64 bits hold), and one to which something
 * beyond half of that is added, or no number, becomes OVERFLOWN. Whoever adds to that finds it
 * outside of the range as well and puts it back, so it stays there for the host to see
 * (cloudtomo_cl/fixed_point.py), even if several add at the same time.
 */
#ifndef CLOUDTOMO_ACCUMULATE_H
#define CLOUDTOMO_ACCUMULATE_H

#include "walk/arithmetic.h"

typedef long Accumulator;

#define LARGEST_ADDEND (0.5f * (float)LARGEST_SUM)

#ifdef CLOUDTOMO_WIDE_ATOMICS
#pragma OPENCL EXTENSION cl_khr_int64_base_atomics : enable
#define OVERFLOWN LONG_MIN
inline void accumulate(volatile __global Accumulator *sum, float value)
{
    if (magnitude(value) < LARGEST_ADDEND) {
        const ulong addend = as_ulong(convert_long_rte(value));
        const ulong after = as_ulong(atom_add(sum, as_long(addend))) + addend;
        if (after + LARGEST_SUM < 2ul * LARGEST_SUM)
            return;
    }
    atom_xchg(sum, OVERFLOWN);
}
#else
#ifdef __ENDIAN_LITTLE__
#define LOW_WORD 0
#else
#define LOW_WORD 1
#endif
#define OVERFLOWN 0x80000000u /* the high word */
/* Every wrap of the low word is seen by exactly one work item, which carries it. */
inline void accumulate(volatile __global Accumulator *sum, float value)
{
    volatile __global uint *words = (volatile __global uint *)sum;
    if (magnitude(value) < LARGEST_ADDEND) {
        const ulong bits = as_ulong(convert_long_rte(value));
        const uint low = (uint)bits;
        const uint before = atomic_add(words + LOW_WORD, low);
        const uint high = (uint)(bits >> 32) + (before + low < low);
        if (high == 0u)
            return;
        const uint limit = (uint)(LARGEST_SUM >> 32);
        if (atomic_add(words + 1 - LOW_WORD, high) + high + limit < 2u * limit)
            return;
    }
    atomic_xchg(words + 1 - LOW_WORD, OVERFLOWN);
}
#endif

/* Whether a sum has left its range. */
inline bool has_overflowed(Accumulator sum) { return (ulong)sum + LARGEST_SUM >= 2ul * LARGEST_SUM; }

/* A sum of many floats that does not drift: sum + low holds about twice the bits (Knuth's
 * two-sum; what `low` has gathered is carried over into `sum`, else it would drift itself). */
inline void add_compensated(float *sum, float *low, float value)
{
    const float total = *sum + value;
    const float part = total - *sum;
    const float rest = *low + ((*sum - (total - part)) + (value - part));
    *sum = total + rest;
    *low = rest - (*sum - total);
}

#endif
