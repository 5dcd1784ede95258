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
 * (cloudtomo_cl/opencl/fixed_point.py), even if several add at the same time.
 */
#ifndef CLOUDTOMO_ACCUMULATE_H
#define CLOUDTOMO_ACCUMULATE_H

#include "walk/arithmetic.h"

typedef long Accumulator;

#define LARGEST_ADDEND (0.5f * (float)LARGEST_SUM)

#define OVERFLOWN LONG_MIN
#define OVERFLOWN_WORD 0x80000000u /* the high one */
#ifdef __ENDIAN_LITTLE__
#define LOW_WORD 0
#else
#define LOW_WORD 1
#endif

#define ADD_UNITS add_units
#define SUM_SPACE __global
#include "walk/add_fixed_point.h"

/* Whether a number of units may be added at a time. */
inline bool is_addend(Accumulator units) { return (ulong)units + LARGEST_SUM / 2 <= LARGEST_SUM; }

/* The units that stand for a value; OVERFLOWN for one that is too large, or no number. */
inline Accumulator units_of(float value)
{
    return magnitude(value) < LARGEST_ADDEND ? convert_long_rte(value) : OVERFLOWN;
}

inline void accumulate(volatile __global Accumulator *sum, float value) { add_units(sum, units_of(value)); }

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
