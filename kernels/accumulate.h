/* How many work items add into one number.
 *
 * Values are rounded to integers and summed in fixed point, 64 bits wide: the sum has the same
 * bits whatever the order, and does not drift however many they are. Devices without 64-bit
 * atomics add the two halves apart and carry. The host scales what is added so that one unit
 * is the wanted resolution. */
#ifndef CLOUDTOMO_ACCUMULATE_H
#define CLOUDTOMO_ACCUMULATE_H

typedef long Accumulator;

#ifdef CLOUDTOMO_WIDE_ATOMICS
#pragma OPENCL EXTENSION cl_khr_int64_base_atomics : enable
inline void accumulate(volatile __global Accumulator *sum, float value)
{
    atom_add(sum, convert_long_sat_rte(value));
}
#else
#ifdef __ENDIAN_LITTLE__
#define LOW_WORD 0
#else
#define LOW_WORD 1
#endif
/* Every wrap of the low word is seen by exactly one work item, which carries it. */
inline void accumulate(volatile __global Accumulator *sum, float value)
{
    volatile __global uint *words = (volatile __global uint *)sum;
    const ulong bits = as_ulong(convert_long_sat_rte(value));
    const uint low = (uint)bits;
    const uint before = atomic_add(words + LOW_WORD, low);
    const uint high = (uint)(bits >> 32) + (before + low < low);
    if (high != 0u)
        atomic_add(words + 1 - LOW_WORD, high);
}
#endif

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
