/* Small functions that the kernels call all the time.
 *
 * The functions of OpenCL are not inlined everywhere (PoCL calls its library where that was built for a
 * processor with more features than the one it believes to have), and differ in the last bits from
 * device to device. These are a few instructions each, with the same results on every device. */
#ifndef CLOUDTOMO_ARITHMETIC_H
#define CLOUDTOMO_ARITHMETIC_H

/* As fmin, fmax, clamp and fabs, but not for NaN. */
inline float lesser(float a, float b) { return a < b ? a : b; }
inline float greater(float a, float b) { return a > b ? a : b; }
inline float within(float value, float least, float most) { return lesser(greater(value, least), most); }
inline float magnitude(float a) { return as_float(as_uint(a) & 0x7fffffffu); }
/* 1 or -1, by the sign bit: -1 of -0. */
inline float sign_of(float a) { return as_float((as_uint(a) & 0x80000000u) | 0x3f800000u); }

inline float square_root(float a)
{
#if defined(__clang__) && (defined(__x86_64__) || defined(__aarch64__))
    return __builtin_sqrtf(a);
#else
    return sqrt(a);
#endif
}

inline float scalar_product(float3 a, float3 b) { return a.x * b.x + a.y * b.y + a.z * b.z; }

/* A vector of length 1 in the direction of a. */
inline float3 unit_vector(float3 a) { return a / square_root(scalar_product(a, a)); }

/* The natural logarithm of a normal number above 0, to 1.5 units in the last place: by its exponent
 * and the series of the inverse hyperbolic tangent, economised. */
inline float logarithm(float a)
{
    const uint bits = as_uint(a);
    const int exponent = (int)(bits - 0x3f3504f3u) >> 23; /* the rest is in [1/sqrt(2), sqrt(2)) */
    const float rest = as_float(bits - ((uint)exponent << 23));
    const float s = (rest - 1.0f) / (rest + 1.0f);
    const float z = s * s;
    const float series = z * (0.33333333f + z * (0.20000061f + z * (0.14275387f + z * 0.11665814f)));
    return 2.0f * s + 2.0f * s * series + (float)exponent * 0.69314718f;
}

/* The exponential of a number that is not above 0; 0 below the least normal number. */
inline float exponential(float a)
{
    if (!(a > -87.0f))
        return 0.0f;
    const int exponent = (int)(a * 1.44269504f - 0.5f); /* rounded: a is not above 0 */
    /* ln 2 in two parts, of which the first times the exponent is exact. */
    const float rest = (a - (float)exponent * 0.693359375f) + (float)exponent * 2.12194440e-4f;
    /* clang-format off */
    const float power = 1.0f + rest * (1.0f + rest * (0.5f + rest * (0.166665099f + rest * (0.0416664468f
                        + rest * (0.00836987309f + rest * 0.0013936722f)))));
    /* clang-format on */
    return power * as_float((uint)(exponent + 127) << 23);
}

/* Halley's step towards the cube root of a: the relative error becomes about its cube. */
inline float nearer_cube_root(float guess, float a)
{
    const float cube = guess * guess * guess;
    return guess - guess * (cube - a) / (2.0f * cube + a);
}

/* The cube root of a normal number above 0, to 1.5 units in the last place; the guess by its bits is within 4 %. */
inline float cube_root(float a)
{
    return nearer_cube_root(nearer_cube_root(as_float(as_uint(a) / 3u + 0x2a51379fu), a), a);
}

/* Cosine and sine of 2 pi u, u from 0 to 1. */
inline float2 cosine_and_sine_of_turn(float u)
{
    const int quarter = (int)(4.0f * u + 0.5f);
    const float f = u - 0.25f * (float)quarter; /* exact, within 1/8 of 0 */
    const float z = f * f;
    const float s = f * (6.28318531f + z * (-41.3416662f + z * (81.5925482f + z * -75.4018402f)));
    const float c = 1.0f + z * (-19.7392087f + z * (64.9393162f + z * (-85.4428484f + z * 59.2202882f)));
    const float2 turned = quarter & 1 ? (float2)(-s, c) : (float2)(c, s);
    return quarter & 2 ? -turned : turned;
}

/* The turn from the x axis to (x, y), from 0 to below 1, to 1e-7; 0 of the zero vector. */
inline float turn_of(float x, float y)
{
    const float ahead = magnitude(x), aside = magnitude(y), longer = greater(ahead, aside);
    const float t = longer > 0.0f ? lesser(ahead, aside) / longer : 0.0f;
    const float z = t * t;
    /* clang-format off */
    const float octant = t * (0.15915432f + z * (-0.053026239f + z * (0.03152512f + z * (-0.021061522f
                         + z * (0.012672503f + z * (-0.0053482765f + z * 0.0010841295f))))));
    /* clang-format on */
    const float quarter = aside > ahead ? 0.25f - octant : octant;
    const float half_turn = x < 0.0f ? 0.5f - quarter : quarter;
    const float turn = y < 0.0f ? 1.0f - half_turn : half_turn;
    return turn < 1.0f ? turn : 0.0f;
}

#endif
