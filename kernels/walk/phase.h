/* Phase functions: evaluate (sr^-1, integral over the sphere 1) and sample the cosine of
 * the scattering angle. Light from the sun that scatters towards a backward path of
 * direction d has scattering cosine dot(d, sun), with `sun` pointing to the sun. */
#ifndef CLOUDTOMO_PHASE_H
#define CLOUDTOMO_PHASE_H

#include "walk/arithmetic.h"

#define ONE_OVER_PI 0.318309886183790672f /* 1 / pi, sr^-1 of a Lambertian surface */

/* Henyey and Greenstein 1941. g: asymmetry, -1 < g < 1. Written so that nothing cancels at
 * the peak, where 1 + g^2 - 2 g cosine is the small (1 - |g|)^2. */
inline float henyey_greenstein(float cosine, float g)
{
    const float off_peak = 1.0f - (g < 0.0f ? -cosine : cosine);
    const float size = magnitude(g);
    const float base = (1.0f - size) * (1.0f - size) + 2.0f * size * greater(off_peak, 0.0f);
    return 0.25f * ONE_OVER_PI * (1.0f - g * g) / (base * square_root(base));
}

/* The cosine by the inverse of the cumulative distribution, for g of either sign and 0. */
inline float sample_henyey_greenstein(float u, float g)
{
    const float ratio = (1.0f - g) / (1.0f - g + 2.0f * g * u);
    return within(1.0f - 2.0f * (1.0f - u) * (1.0f + g * u) * ratio * ratio, -1.0f, 1.0f);
}

/* forward_fraction x HG(forward_g) + the rest x HG(backward_g). */
inline float double_henyey_greenstein(float cosine, float forward_g, float backward_g, float forward_fraction)
{
    float density = forward_fraction * henyey_greenstein(cosine, forward_g);
    if (forward_fraction < 1.0f)
        density += (1.0f - forward_fraction) * henyey_greenstein(cosine, backward_g);
    return density;
}

/* u chooses the lobe; rescaled to the lobe's share it gives the cosine. */
inline float sample_double_henyey_greenstein(float u, float forward_g, float backward_g, float forward_fraction)
{
    const float backward = 1.0f - forward_fraction;
    return u < backward ? sample_henyey_greenstein(u / backward, backward_g)
                        : sample_henyey_greenstein(lesser((u - backward) / forward_fraction, 1.0f), forward_g);
}

/* Scalar Rayleigh: 3 / (16 pi) (1 + cos^2). */
inline float rayleigh(float cosine) { return 0.1875f * ONE_OVER_PI * (1.0f + cosine * cosine); }

/* Root of c^3 + 3 c = 8 u - 4 (Cardano). */
inline float sample_rayleigh(float u)
{
    const float q = 4.0f * u - 2.0f;
    const float root = cube_root(magnitude(q) + square_root(q * q + 1.0f)); /* >= 1: no cancellation */
    return within(copysign(root - 1.0f / root, q), -1.0f, 1.0f);
}

/* A table of phase functions. Its variable is s = (1 - cosine) / 2 = sin^2(angle / 2), in which
 * single precision resolves the forward peak; each row is linear in s between its nodes, hence
 * linear in the cosine. */
typedef struct {
    const __global float *node;       /* s, from 0 to 1 */
    const __global float *density;    /* sr^-1, [row][node] */
    const __global float *cumulative; /* share of the light scattered at less than s, [row][node] */
    int nodes;
} PhaseTable;

/* The interval [sorted[j], sorted[j + 1]] that holds a value. */
inline int interval(const __global float *sorted, int count, float value)
{
    int low = 0, high = count - 1;
    while (high - low > 1) {
        const int middle = (low + high) / 2;
        if (sorted[middle] <= value)
            low = middle;
        else
            high = middle;
    }
    return low;
}

inline float table_density(const PhaseTable *table, int row, float s)
{
    const int j = interval(table->node, table->nodes, s);
    const __global float *density = table->density + row * table->nodes;
    const float part = (s - table->node[j]) / (table->node[j + 1] - table->node[j]);
    return mix(density[j], density[j + 1], within(part, 0.0f, 1.0f));
}

/* The cosine by the inverse of the cumulative distribution; it grows with u. */
inline float sample_table(const PhaseTable *table, int row, float u)
{
    const __global float *cumulative = table->cumulative + row * table->nodes;
    const __global float *density = table->density + row * table->nodes;
    const float share = 1.0f - u;
    const int j = interval(cumulative, table->nodes, share);
    const float width = table->node[j + 1] - table->node[j];
    /* 4 pi (density x + slope x^2 / 2) = what is left of the share; solved without cancellation. */
    const float rest = 0.25f * ONE_OVER_PI * greater(share - cumulative[j], 0.0f);
    const float slope = (density[j + 1] - density[j]) / width;
    const float root = square_root(greater(density[j] * density[j] + 2.0f * slope * rest, 0.0f));
    const float x = rest > 0.0f ? 2.0f * rest / (density[j] + root) : 0.0f;
    return 1.0f - 2.0f * (table->node[j] + within(x, 0.0f, width));
}

/* A unit vector at the given cosine from `axis` and azimuth 2 pi u around it
 * (frame: Duff et al. 2017, "Building an orthonormal basis, revisited"). */
inline float3 direction_around(float3 axis, float cosine, float u)
{
    const float sign = sign_of(axis.z);
    const float a = -1.0f / (sign + axis.z);
    const float b = axis.x * axis.y * a;
    const float3 first = (float3)(1.0f + sign * axis.x * axis.x * a, sign * b, -sign * axis.x);
    const float3 second = (float3)(b, sign + axis.y * axis.y * a, -axis.y);
    const float sine = square_root(greater(1.0f - cosine * cosine, 0.0f));
    const float2 azimuth = cosine_and_sine_of_turn(u);
    return unit_vector(sine * (azimuth.x * first + azimuth.y * second) + cosine * axis);
}

#endif
