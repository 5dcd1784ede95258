/* How many work items add into one voxel.
 *
 * With 64-bit integer atomics, values are rounded to integers and summed in fixed point: the
 * sum has the same bits whatever the order. Without, floats are summed by compare-and-swap.
 * In both cases the host has scaled the adjoint so that one unit is the wanted resolution. */
#ifndef CLOUDTOMO_ACCUMULATE_H
#define CLOUDTOMO_ACCUMULATE_H

#ifdef CLOUDTOMO_FIXED_POINT
#pragma OPENCL EXTENSION cl_khr_int64_base_atomics : enable
typedef long Accumulator;

inline void accumulate(volatile __global Accumulator *sum, float value)
{
    atom_add(sum, convert_long_sat_rte(value));
}
#else
typedef float Accumulator;

inline void accumulate(volatile __global Accumulator *sum, float value)
{
    volatile __global uint *bits = (volatile __global uint *)sum;
    uint expected = *bits, seen;
    while ((seen = atomic_cmpxchg(bits, expected, as_uint(as_float(expected) + value))) != expected)
        expected = seen;
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
