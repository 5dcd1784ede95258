/* Paths that are walked again with the same random numbers: their radiance is known from the start. */
#ifndef CLOUDTOMO_REPLAYED_H
#define CLOUDTOMO_REPLAYED_H

#include "walk/arithmetic.h"

/* Largest relative change of a replayed path's radiance, by rounding. */
#define REPLAY_TOLERANCE 1e-4f

/* Derivative of the cost with respect to a path's radiance; a pixel has one for even and one for odd samples. */
inline float adjoint_of(const __global float2 *adjoint, uint pixel_in_list, uint sample)
{
    const float2 halves = adjoint[pixel_in_list];
    return sample & 1u ? halves.y : halves.x;
}

/* What is still to come of a path's radiance up to an `end`; 0 if it is within the rounding of the path's `total`. */
inline float remaining_radiance(float end, float radiance, float total)
{
    const float rest = end - radiance;
    return rest > 4.0f * FLT_EPSILON * total ? rest : 0.0f;
}

/* A replayed path must have the same radiance as before. If not, its deposits are wrong: the device
 * computes wrongly, or has ended a loop too early. */
inline void check_replay(float radiance, float total, volatile __global uint *astray)
{
    if (!(magnitude(radiance - total) <= REPLAY_TOLERANCE * total))
        atomic_inc(astray);
}

#endif
