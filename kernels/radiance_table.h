/* The radiance table: diffuse radiance by cell and bin of directions. Cells are the voxels of a mask, or parts of
 * those that are optically deep.
 *
 * Bins are rings around the vertical, cut into equal azimuths. The host defines DIRECTION_RINGS, DIRECTION_BINS
 * and the values of the three tables of rings. */
#ifndef CLOUDTOMO_RADIANCE_TABLE_H
#define CLOUDTOMO_RADIANCE_TABLE_H

#include "walk/grid.h"
#include "walk/phase.h"

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

typedef struct {
    const __global int *column;      /* of every voxel in the table, or -1 */
    const __global uint4 *cells;     /* of every column: its first cell, and parts along x, y, z */
    const __global float *scattered; /* [cell][bin]: source - radiance, sr^-1 */
    const __global float *sunlight;  /* [cell]: direct, share of the irradiance */
} RadianceTable;

#define TABLE_ARGUMENTS column, cells, scattered, sunlight
inline RadianceTable make_table(const __global int *column, const __global uint4 *cells,
                                const __global float *scattered, const __global float *sunlight)
{
    const RadianceTable table = {column, cells, scattered, sunlight};
    return table;
}

/* The cell at a position, in voxel units, inside of a column's voxel or a periodic copy of it. */
inline uint cell_at(const RadianceTable *table, int column, float3 position)
{
    const uint4 cells = table->cells[column];
    const uint3 parts = cells.yzw;
    const uint3 part = min(convert_uint3((position - floor(position)) * convert_float3(parts)), parts - 1u);
    return cells.x + (part.x * parts.y + part.y) * parts.z + part.z;
}

#endif
