/* Bins of directions on the sphere: rings around the vertical, cut into equal azimuths. The host
 * defines DIRECTION_RINGS, DIRECTION_BINS and the values of the three tables. */
#ifndef CLOUDTOMO_DIRECTIONS_H
#define CLOUDTOMO_DIRECTIONS_H

__constant float ring_cosine[DIRECTION_RINGS + 1] = {RING_COSINES}; /* edges, from 1 down to -1 */
__constant int ring_azimuths[DIRECTION_RINGS] = {RING_AZIMUTHS};
__constant int ring_first[DIRECTION_RINGS] = {RING_FIRSTS};

inline int direction_bin(float3 direction)
{
    int ring = 0;
    while (ring < DIRECTION_RINGS - 1 && direction.z < ring_cosine[ring + 1])
        ++ring;
    float turn = atan2(direction.y, direction.x) * (0.5f * ONE_OVER_PI);
    turn -= floor(turn);
    return ring_first[ring] + min((int)(turn * (float)ring_azimuths[ring]), ring_azimuths[ring] - 1);
}

#endif
