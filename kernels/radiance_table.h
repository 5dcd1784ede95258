/* The radiance table: diffuse radiance by cell and bin of directions. Cells are the voxels of a mask, or parts of
 * voxels that are optically deep.
 *
 * Bins are rings around the vertical, cut into equal azimuths. The host defines DIRECTION_RINGS, DIRECTION_BINS
 * and the values of the three tables of rings. A column of the table is a voxel of the mask. */
#ifndef CLOUDTOMO_RADIANCE_TABLE_H
#define CLOUDTOMO_RADIANCE_TABLE_H

#include "walk/grid.h"
#include "walk/medium.h"
#include "walk/phase.h"

__constant float ring_cosine[DIRECTION_RINGS + 1] = {RING_COSINES}; /* edges, from 1 down to -1 */
__constant int ring_azimuths[DIRECTION_RINGS] = {RING_AZIMUTHS};
__constant int ring_first[DIRECTION_RINGS] = {RING_FIRSTS};

inline int direction_bin(float3 direction)
{
    int ring = 0;
    while (ring < DIRECTION_RINGS - 1 && direction.z < ring_cosine[ring + 1])
        ++ring;
    const float turn = turn_of(direction.x, direction.y);
    return ring_first[ring] + min((int)(turn * (float)ring_azimuths[ring]), ring_azimuths[ring] - 1);
}

typedef struct {
    const __global int *column;     /* [voxel]: column of the table, or -1 */
    const __global uint4 *cells;    /* [column]: first cell, and numbers of cells along x, y, z */
    const __global float *diffuse;  /* [cell][2][bin]: source minus radiance, and source, sr^-1 */
    const __global float *sunlight; /* [cell]: direct sunlight, share of the irradiance, over sunlight_at */
} RadianceTable;

#define TABLE_ARGUMENTS column, cells, diffuse, sunlight
inline RadianceTable make_table(const __global int *column, const __global uint4 *cells, const __global float *diffuse,
                                const __global float *sunlight)
{
    const RadianceTable table = {column, cells, diffuse, sunlight};
    return table;
}

/* Source function of droplets by diffuse light, minus the radiance, sr^-1. */
inline float scattered_less_radiance(const RadianceTable *table, uint cell, int bin)
{
    return table->diffuse[2 * cell * DIRECTION_BINS + bin];
}

/* Source function of droplets by diffuse light, sr^-1. */
inline float diffuse_source(const RadianceTable *table, uint cell, int bin)
{
    return table->diffuse[(2 * cell + 1) * DIRECTION_BINS + bin];
}

/* Direct sunlight changes within a voxel as exp(rate x way towards the sun), since the way out of the voxel gets
 * shorter; the rate is in km^-1. Where the change is small it is taken to be constant. */
#define LEAST_CHANGE 0.1f
#define MOST_CHANGE 30.0f
#define LITTLE 0.01f /* below, a series of two terms is exact enough */
inline float sunlight_rate(const __constant Scene *scene, float droplets)
{
    const float3 spacing = grid_spacing(scene);
    const float size = spacing.x + spacing.y + spacing.z;
    return droplets * size < LEAST_CHANGE ? 0.0f : lesser(droplets, MOST_CHANGE / size);
}

/* The exponential of a number of either sign. */
inline float growth(float a)
{
    const float falls = exponential(-magnitude(a));
    return a > 0.0f ? 1.0f / falls : falls;
}

/* Direct sunlight over that in the voxel's lower corner; `way`: distance from there towards the sun, km. */
inline float sunlight_at(float rate, float way) { return rate == 0.0f ? 1.0f : growth(rate * way); }

/* Direct sunlight along a crossing of a voxel. */
typedef struct {
    float rate, way, slope; /* way (km) at the crossing's start; slope: change of the way per km of the crossing */
} SunlightWalk;

inline SunlightWalk walk_sunlight(const __constant Scene *scene, const Ray *ray, float begin, float length,
                                  float droplets)
{
    SunlightWalk walk = {sunlight_rate(scene, droplets), 0.0f, 0.0f};
    if (walk.rate == 0.0f)
        return walk;
    const float3 spacing = grid_spacing(scene), slope = ray->direction / spacing;
    const float3 corner = floor(ray->position + (begin + 0.5f * length) * slope);
    const float3 sun = sun_direction(scene);
    walk.way = scalar_product(sun, (ray->position + begin * slope - corner) * spacing);
    walk.slope = scalar_product(sun, ray->direction);
    return walk;
}

/* The mean of the sunlight over `length` km of the crossing from `from` km on. */
inline float mean_sunlight(const SunlightWalk *walk, float from, float length)
{
    if (walk->rate == 0.0f)
        return 1.0f;
    const float more = walk->rate * walk->slope * length;
    const float mean = magnitude(more) < LITTLE ? 1.0f + 0.5f * more : (growth(more) - 1.0f) / more;
    return growth(walk->rate * (walk->way + walk->slope * from)) * mean;
}

/* A walk along a crossing of a voxel, from cell to cell. */
typedef struct {
    float next_x, next_y, next_z;             /* km from the crossing's start to the next face of a cell, per axis */
    float per_part_x, per_part_y, per_part_z; /* km between faces of cells, per axis */
    int ahead_x, ahead_y, ahead_z;            /* cells ahead in the voxel, per axis; -1: it has been left */
    int stride_x, stride_y, stride_z;         /* to the next cell's number, per axis */
    uint cell;                                /* number of the present cell */
    float from;                               /* km from the crossing's start to where the cell begins */
} CellWalk;

/* Begins the walk along one axis: `start` is the crossing's start in the voxel, from 0 to 1, `slope` voxels per km. */
inline void begin_axis(float start, float slope, uint parts, int stride, CellWalk *walk, float *next, float *per_part,
                       int *ahead, int *step)
{
    const float at = within(start, 0.0f, 1.0f) * (float)parts;
    const int part = min((int)at, (int)parts - 1);
    const bool up = slope > 0.0f;
    *per_part = 1.0f / (magnitude(slope) * (float)parts);
    *next = slope == 0.0f ? INFINITY : (up ? (float)(part + 1) - at : at - (float)part) * *per_part;
    *ahead = up ? (int)parts - 1 - part : part;
    *step = up ? stride : -stride;
    walk->cell += part * stride;
}

/* The walk for a crossing of a column's voxel that begins `begin` km along a ray and is `length` km long. */
inline CellWalk walk_cells(const __constant Scene *scene, uint4 cells, const Ray *ray, float begin, float length)
{
    const float3 slope = ray->direction / grid_spacing(scene);
    const float3 corner = floor(ray->position + (begin + 0.5f * length) * slope);
    const float3 start = ray->position + begin * slope - corner;
    CellWalk walk;
    walk.cell = cells.x;
    walk.from = 0.0f;
    begin_axis(start.x, slope.x, cells.y, cells.z * cells.w, &walk, &walk.next_x, &walk.per_part_x, &walk.ahead_x,
               &walk.stride_x);
    begin_axis(start.y, slope.y, cells.z, cells.w, &walk, &walk.next_y, &walk.per_part_y, &walk.ahead_y,
               &walk.stride_y);
    begin_axis(start.z, slope.z, cells.w, 1, &walk, &walk.next_z, &walk.per_part_z, &walk.ahead_z, &walk.stride_z);
    return walk;
}

/* Goes to the next cell; returns the length in the cell that is left, km. The walk ends at `length`. */
inline float leave_cell(CellWalk *walk, float length)
{
    const float exit = lesser(walk->next_z, lesser(walk->next_x, walk->next_y));
    const bool z = walk->next_z == exit;
    const bool x = !z && walk->next_x == exit;
    const bool y = !z && !x;
    walk->next_x += x ? walk->per_part_x : 0.0f;
    walk->next_y += y ? walk->per_part_y : 0.0f;
    walk->next_z += z ? walk->per_part_z : 0.0f;
    walk->ahead_x -= x;
    walk->ahead_y -= y;
    walk->ahead_z -= z;
    /* The last cell gets what rounding leaves of the crossing. */
    const bool leaves = (walk->ahead_x | walk->ahead_y | walk->ahead_z) < 0;
    const float from = walk->from;
    walk->from = leaves ? length : within(exit, from, length);
    walk->cell += leaves ? 0 : z ? walk->stride_z : x ? walk->stride_x : walk->stride_y;
    return walk->from - from;
}

inline bool is_whole(uint4 cells) { return cells.y * cells.z * cells.w == 1u; }

#endif
