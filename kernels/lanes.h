/* Vectors of lanes. */
#ifndef CLOUDTOMO_LANES_H
#define CLOUDTOMO_LANES_H

/* The sum of the lanes, always in the same order. */
inline float sum_of(float8 lanes)
{
    const float4 four = lanes.lo + lanes.hi;
    const float2 two = four.lo + four.hi;
    return two.x + two.y;
}

#endif
