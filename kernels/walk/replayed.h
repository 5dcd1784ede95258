/* Paths that are walked again, with the same random numbers: what they contribute is known from the start. */
#ifndef CLOUDTOMO_REPLAYED_H
#define CLOUDTOMO_REPLAYED_H

#include "walk/arithmetic.h"

/* Share of its radiance by which a replayed path may differ: rounding. */
#define REPLAY_TOLERANCE 1e-4f

/* Of a path: derivative of the cost with respect to its radiance, which even and odd samples of a pixel have apart. */
inline float adjoint_of(const __global float2 *adjoint, uint pixel_in_list, uint sample)
{
    const float2 halves = adjoint[pixel_in_list];
    return sample & 1u ? halves.y : halves.x;
}

/* Radiance that a path has still to gather, of a total; rounding counts as nothing. */
inline float remaining_radiance(float total, float radiance)
{
    const float rest = total - radiance;
    return rest > 4.0f * FLT_EPSILON * total ? rest : 0.0f;
}

/* A replayed path contributes what it did before. If not, what it deposited is wrong: the device
 * computes wrongly, or has ended a loop before its time. */
inline void check_replay(float radiance, float total, volatile __global uint *astray)
{
    if (!(magnitude(radiance - total) <= REPLAY_TOLERANCE * total))
        atomic_inc(astray);
}

#endif
