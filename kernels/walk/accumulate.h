/* Sums in fixed point, to which many work items add.
 *
 * Values are rounded to integers and summed in fixed point, 64 bits wide: the sum has the same
 * bits whatever the order, and does not drift however many values there are. Devices without
 * 64-bit atomics add the two halves separately and carry. The host scales values so that one
 * unit is the wanted resolution.
 *
 * A sum becomes OVERFLOWN if it leaves +-LARGEST_SUM (2^62, half of what 64 bits hold), or if a
 * value beyond half of that, or NaN, is added. A work item that adds to it later finds the sum
 * outside of the range again and sets it to OVERFLOWN again, so that the host can see it
 * (cloudtomo_cl/opencl/fixed_point.py), even if several work items add at the same time.
 */
#ifndef CLOUDTOMO_ACCUMULATE_H
#define CLOUDTOMO_ACCUMULATE_H

#include "walk/arithmetic.h"

typedef long Accumulator;

#define LARGEST_ADDEND (0.5f * (float)LARGEST_SUM)

#define OVERFLOWN LONG_MIN
#define OVERFLOWN_WORD 0x80000000u /* its high word */
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

/* The units that stand for a value; OVERFLOWN if it is too large, or NaN. */
inline Accumulator units_of(float value)
{
    return magnitude(value) < LARGEST_ADDEND ? convert_long_rte(value) : OVERFLOWN;
}

inline void accumulate(volatile __global Accumulator *sum, float value) { add_units(sum, units_of(value)); }

/* Whether a sum has left its range. */
inline bool has_overflowed(Accumulator sum) { return (ulong)sum + LARGEST_SUM >= 2ul * LARGEST_SUM; }

/* A sum of many floats that does not drift: sum + low has about twice the bits (Knuth's
 * two-sum; `low` is carried over into `sum`, since otherwise it would drift itself). */
inline void add_compensated(float *sum, float *low, float value)
{
    const float total = *sum + value;
    const float part = total - *sum;
    const float rest = *low + ((*sum - (total - part)) + (value - part));
    *sum = total + rest;
    *low = rest - (*sum - total);
}

#endif
