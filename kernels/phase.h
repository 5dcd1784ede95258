/* Phase functions: evaluate (sr^-1, integral over the sphere 1) and sample the cosine of
 * the scattering angle. Light from the sun that scatters towards a backward path of
 * direction d has scattering cosine dot(d, sun), with `sun` pointing to the sun. */
#ifndef CLOUDTOMO_PHASE_H
#define CLOUDTOMO_PHASE_H

#define ONE_OVER_PI 0.318309886183790672f /* 1 / pi, sr^-1 of a Lambertian surface */

/* Henyey and Greenstein 1941. g: asymmetry, -1 < g < 1. Written so that nothing cancels at
 * the peak, where 1 + g^2 - 2 g cosine is the small (1 - |g|)^2. */
inline float henyey_greenstein(float cosine, float g)
{
    const float off_peak = 1.0f - (g < 0.0f ? -cosine : cosine);
    const float base = (1.0f - fabs(g)) * (1.0f - fabs(g)) + 2.0f * fabs(g) * fmax(off_peak, 0.0f);
    return 0.25f * ONE_OVER_PI * (1.0f - g * g) / (base * sqrt(base));
}

/* The inverse of its distribution function, for g of either sign and 0. */
inline float sample_henyey_greenstein(float u, float g)
{
    const float ratio = (1.0f - g) / (1.0f - g + 2.0f * g * u);
    return clamp(1.0f - 2.0f * (1.0f - u) * (1.0f + g * u) * ratio * ratio, -1.0f, 1.0f);
}

/* Scalar Rayleigh: 3 / (16 pi) (1 + cos^2). */
inline float rayleigh(float cosine)
{
    return 0.1875f * ONE_OVER_PI * (1.0f + cosine * cosine);
}

/* Root of c^3 + 3 c = 8 u - 4 (Cardano). */
inline float sample_rayleigh(float u)
{
    const float q = 4.0f * u - 2.0f;
    const float root = cbrt(fabs(q) + sqrt(q * q + 1.0f)); /* >= 1: no cancellation */
    return clamp(copysign(root - 1.0f / root, q), -1.0f, 1.0f);
}

/* A unit vector at the given cosine from `axis` and azimuth 2 pi u around it
 * (frame: Duff et al. 2017, "Building an orthonormal basis, revisited"). */
inline float3 direction_around(float3 axis, float cosine, float u)
{
    const float sign = copysign(1.0f, axis.z);
    const float a = -1.0f / (sign + axis.z);
    const float b = axis.x * axis.y * a;
    const float3 first = (float3)(1.0f + sign * axis.x * axis.x * a, sign * b, -sign * axis.x);
    const float3 second = (float3)(b, sign + axis.y * axis.y * a, -axis.y);
    const float sine = sqrt(fmax(1.0f - cosine * cosine, 0.0f));
    float cos_azimuth;
    const float sin_azimuth = sincos(6.283185307179586f * u, &cos_azimuth);
    return normalize(sine * (cos_azimuth * first + sin_azimuth * second) + cosine * axis);
}

#endif
