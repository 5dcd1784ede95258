/* The voxel grid: rays into it, and the one walk from voxel to voxel.
 *
 * Positions inside kernels are in voxel units from the domain's lower corner, so that
 * voxel (i, j, k) is the cube [i, i+1) x [j, j+1) x [k, k+1); directions are unit vectors
 * in space; distances along a ray are in km. Arrays are [x][y][z], z fastest.
 */
#ifndef CLOUDTOMO_GRID_H
#define CLOUDTOMO_GRID_H

#include "walk/arithmetic.h"
#include "walk/kept.h"

typedef struct {
    float3 position;  /* voxel units */
    float3 direction; /* unit vector */
    int3 voxel;       /* the voxel that holds position; valid if inside */
    bool inside;      /* the position is known to lie in the domain */
} Ray;

/* A ray as part of a path's state (kept.h).
 *
 *   RAY_OF(name, kept)    declares `name`, a pointer to the kept ray, or to a copy of one in local memory
 *   keep_ray(kept, name)  writes a changed ray back */
#ifdef CLOUDTOMO_KEEPS_LOCAL
typedef struct {
    KeptVector position, direction;
    KeptVoxel voxel;
    int inside;
} KeptRay;

#define RAY_OF(name, kept) \
    Ray name##_taken = kept_ray(kept); \
    Ray *const name = &name##_taken

inline Ray kept_ray(const KEPT KeptRay *kept)
{
    Ray ray;
    ray.position = kept_vector(&kept->position);
    ray.direction = kept_vector(&kept->direction);
    ray.voxel = (int3)(kept->voxel.x, kept->voxel.y, kept->voxel.z);
    ray.inside = kept->inside;
    return ray;
}

inline void keep_ray(KEPT KeptRay *kept, const Ray *ray)
{
    keep_vector(&kept->position, ray->position);
    keep_vector(&kept->direction, ray->direction);
    kept->voxel.x = ray->voxel.x;
    kept->voxel.y = ray->voxel.y;
    kept->voxel.z = ray->voxel.z;
    kept->inside = ray->inside;
}
#else
typedef Ray KeptRay;

#define RAY_OF(name, kept) Ray *const name = (Ray *)(kept)

inline Ray kept_ray(const KeptRay *kept) { return *kept; }

inline void keep_ray(KeptRay *kept, const Ray *ray)
{
    if (kept != ray)
        *kept = *ray;
}
#endif

/* A walk along a ray from voxel to voxel. It has single numbers in place of vectors: compilers for CPUs
 * keep vectors of three in memory, or split and join them at every step. */
typedef struct {
    float distance;                              /* km from the ray's start to where the current voxel begins */
    float next_x, next_y, next_z;                /* km from the ray's start to the next face, per axis */
    float per_voxel_x, per_voxel_y, per_voxel_z; /* km between faces, per axis */
    int stride_x, stride_y, stride_z;            /* to the next voxel's index, per axis */
    int ahead_x, ahead_y, ahead_z;               /* voxels ahead in the domain, per axis; -1: it has been left */
    int index;                                   /* of the current voxel, in an array [x][y][z] */
} VoxelWalk;

inline float3 grid_spacing(const RARELY_READ __constant Scene *scene) /* km */
{
    return (float3)(scene->spacing[0], scene->spacing[1], scene->spacing[2]);
}

inline int3 grid_shape(const __constant Scene *scene)
{
    return (int3)(scene->shape[0], scene->shape[1], scene->shape[2]);
}

inline int voxel_index(const __constant Scene *scene, int3 voxel)
{
    return (voxel.x * scene->shape[1] + voxel.y) * scene->shape[2] + voxel.z;
}

/* The position in the domain for a position in one of its periodic copies. */
inline float3 wrapped(const __constant Scene *scene, float3 position)
{
    if (scene->periodic) {
        const float2 count = (float2)((float)scene->shape[0], (float)scene->shape[1]);
        position.xy -= count * floor(position.xy / count);
    }
    return position;
}

/* Limits [*near, *far], km along a ray, to where it is between the domain's two faces across one axis. */
inline void clip_axis(float position, float direction, float spacing, float count, float *near, float *far)
{
    if (direction == 0.0f) {
        if (position < 0.0f || position > count)
            *far = -1.0f;
        return;
    }
    const float per_voxel = spacing / direction;
    const float lower = -position * per_voxel;
    const float upper = (count - position) * per_voxel;
    *near = greater(*near, lesser(lower, upper));
    *far = lesser(*far, greater(lower, upper));
}

/* Moves a ray that is outside to where it enters the domain, and sets the `distance` to there, km; returns false
 * if it never does. */
inline bool enter_domain(const __constant Scene *scene, Ray *ray, float *distance)
{
    const float3 spacing = grid_spacing(scene);
    const float3 count = convert_float3(grid_shape(scene));
    float near = 0.0f, far = INFINITY;
    clip_axis(ray->position.z, ray->direction.z, spacing.z, count.z, &near, &far);
    if (!scene->periodic) {
        clip_axis(ray->position.x, ray->direction.x, spacing.x, count.x, &near, &far);
        clip_axis(ray->position.y, ray->direction.y, spacing.y, count.y, &near, &far);
    }
    if (!(near < far))
        return false;
    float3 position = ray->position + near * ray->direction / spacing;
    position = wrapped(scene, position);
    ray->position.x = within(position.x, 0.0f, count.x);
    ray->position.y = within(position.y, 0.0f, count.y);
    ray->position.z = within(position.z, 0.0f, count.z);
    ray->voxel.x = (int)lesser(ray->position.x, count.x - 1.0f);
    ray->voxel.y = (int)lesser(ray->position.y, count.y - 1.0f);
    ray->voxel.z = (int)lesser(ray->position.z, count.z - 1.0f);
    ray->inside = true;
    *distance = near;
    return true;
}

inline float first_face(float position, int voxel, float direction, float per_voxel)
{
    if (direction == 0.0f)
        return INFINITY;
    const float to_face = direction > 0.0f ? (float)(voxel + 1) - position : position - (float)voxel;
    return greater(to_face, 0.0f) * per_voxel;
}

inline VoxelWalk walk_begin(const __constant Scene *scene, const Ray *ray)
{
    const float3 direction = ray->direction, position = ray->position;
    const int3 voxel = ray->voxel;
    const bool east = direction.x > 0.0f, north = direction.y > 0.0f, up = direction.z > 0.0f;
    const int layers = scene->shape[2], rows = scene->shape[1];
    VoxelWalk walk;
    walk.distance = 0.0f;
    walk.per_voxel_x = scene->spacing[0] / magnitude(direction.x);
    walk.per_voxel_y = scene->spacing[1] / magnitude(direction.y);
    walk.per_voxel_z = scene->spacing[2] / magnitude(direction.z);
    walk.next_x = first_face(position.x, voxel.x, direction.x, walk.per_voxel_x);
    walk.next_y = first_face(position.y, voxel.y, direction.y, walk.per_voxel_y);
    walk.next_z = first_face(position.z, voxel.z, direction.z, walk.per_voxel_z);
    walk.stride_x = east ? rows * layers : -rows * layers;
    walk.stride_y = north ? layers : -layers;
    walk.stride_z = up ? 1 : -1;
    walk.ahead_x = east ? scene->shape[0] - 1 - voxel.x : voxel.x;
    walk.ahead_y = north ? rows - 1 - voxel.y : voxel.y;
    walk.ahead_z = up ? layers - 1 - voxel.z : voxel.z;
    walk.index = voxel_index(scene, voxel);
    return walk;
}

/* The number of the walk's voxel along an axis, with `ahead` more voxels before it. */
inline int voxel_of(int ahead, int stride, int count) { return stride > 0 ? count - 1 - ahead : ahead; }

/* The voxel's number along z. */
inline int walk_layer(const RARELY_READ __constant Scene *scene, const VoxelWalk *walk)
{
    return voxel_of(walk->ahead_z, walk->stride_z, scene->shape[2]);
}

inline int3 walk_voxel(const RARELY_READ __constant Scene *scene, const VoxelWalk *walk)
{
    return (int3)(voxel_of(walk->ahead_x, walk->stride_x, scene->shape[0]),
                  voxel_of(walk->ahead_y, walk->stride_y, scene->shape[1]), walk_layer(scene, walk));
}

/* km from the ray's start to where it leaves the current voxel. */
inline float walk_exit(const VoxelWalk *walk) { return lesser(walk->next_z, lesser(walk->next_x, walk->next_y)); }

/* In a periodic domain: enters again on the opposite side. */
inline void walk_wrap(const RARELY_READ __constant Scene *scene, VoxelWalk *walk)
{
    if (walk->ahead_x < 0) {
        walk->ahead_x += scene->shape[0];
        walk->index -= walk->stride_x * scene->shape[0];
    }
    if (walk->ahead_y < 0) {
        walk->ahead_y += scene->shape[1];
        walk->index -= walk->stride_y * scene->shape[1];
    }
}

/* Goes to the next voxel; returns false if that leaves the domain. */
inline bool walk_advance(const RARELY_READ __constant Scene *scene, VoxelWalk *walk, float exit)
{
    const bool z = walk->next_z == exit;
    const bool x = !z && walk->next_x == exit;
    const bool y = !z && !x;
    walk->distance = exit;
    walk->next_x += x ? walk->per_voxel_x : 0.0f;
    walk->next_y += y ? walk->per_voxel_y : 0.0f;
    walk->next_z += z ? walk->per_voxel_z : 0.0f;
    walk->ahead_x -= x;
    walk->ahead_y -= y;
    walk->ahead_z -= z;
    walk->index += z ? walk->stride_z : x ? walk->stride_x : walk->stride_y;
    if ((walk->ahead_x | walk->ahead_y | walk->ahead_z) >= 0)
        return true;
    if (!scene->periodic || walk->ahead_z < 0)
        return false;
    walk_wrap(scene, walk);
    return true;
}

/* Skips the voxels along one axis that a ray has crossed where it is `exit` km from its start. */
inline void skip_axis(float exit, float per_voxel, int stride, int most, float *next, int *ahead, int *index)
{
    if (*next > exit)
        return;
    const int reached = (int)((exit - *next) / per_voxel) + 1;
    const int crossed = reached < most ? reached : most;
    *next += (float)crossed * per_voxel;
    *ahead -= crossed;
    *index += crossed * stride;
}

/* The index of the walk's block, which has 2^empty_shift voxels along each axis. */
inline int empty_block(const RARELY_READ __constant Scene *scene, const VoxelWalk *walk)
{
    const int shift = scene->empty_shift;
    if (shift == 0)
        return walk->index;
    const int x = voxel_of(walk->ahead_x, walk->stride_x, scene->shape[0]) >> shift;
    const int y = voxel_of(walk->ahead_y, walk->stride_y, scene->shape[1]) >> shift;
    const int z = voxel_of(walk->ahead_z, walk->stride_z, scene->shape[2]) >> shift;
    return (x * (((scene->shape[1] - 1) >> shift) + 1) + y) * (((scene->shape[2] - 1) >> shift) + 1) + z;
}

/* Number of voxels along an axis ahead of the walk's, up to the end of `blocks` blocks; its block is the first. */
inline int empty_side(const RARELY_READ __constant Scene *scene, int ahead, int stride, int count, int blocks)
{
    const int last = (1 << scene->empty_shift) - 1;
    return ((blocks - 1) << scene->empty_shift) + ((voxel_of(ahead, stride, count) & last) ^ (stride > 0 ? last : 0));
}

/* From a block with nothing within `empty` blocks (itself included, along every axis) goes to where the ray
 * leaves that cube; or the domain: then returns false. */
inline bool walk_skip(const RARELY_READ __constant Scene *scene, VoxelWalk *walk, int empty)
{
    const bool periodic = scene->periodic;
    const int side_x = empty_side(scene, walk->ahead_x, walk->stride_x, scene->shape[0], empty);
    const int side_y = empty_side(scene, walk->ahead_y, walk->stride_y, scene->shape[1], empty);
    const int side_z = empty_side(scene, walk->ahead_z, walk->stride_z, scene->shape[2], empty);
    /* A ray along an axis never meets faces across the others: this avoids 0 * infinity. */
    const bool meets_x = walk->next_x != INFINITY, meets_y = walk->next_y != INFINITY,
               meets_z = walk->next_z != INFINITY;
    const float beyond = lesser(meets_z ? walk->next_z + (float)side_z * walk->per_voxel_z : INFINITY,
                                lesser(meets_x ? walk->next_x + (float)side_x * walk->per_voxel_x : INFINITY,
                                       meets_y ? walk->next_y + (float)side_y * walk->per_voxel_y : INFINITY));
    const float leave_x = periodic || !meets_x ? INFINITY : walk->next_x + (float)walk->ahead_x * walk->per_voxel_x;
    const float leave_y = periodic || !meets_y ? INFINITY : walk->next_y + (float)walk->ahead_y * walk->per_voxel_y;
    const float leave_z = !meets_z ? INFINITY : walk->next_z + (float)walk->ahead_z * walk->per_voxel_z;
    const float leave_first = lesser(leave_z, lesser(leave_x, leave_y));
    const float exit = lesser(beyond, leave_first);
    walk->distance = exit;
    if (exit >= leave_first) {
        if (leave_z <= exit)
            walk->ahead_z = -1;
        return false;
    }
    /* Rounding must not take the walk out of the domain. It may cross a periodic side: the host has made sure that
     * `empty` blocks are no longer than the domain. */
    const int most_x = periodic ? side_x + 1 : walk->ahead_x, most_y = periodic ? side_y + 1 : walk->ahead_y;
    skip_axis(exit, walk->per_voxel_x, walk->stride_x, most_x, &walk->next_x, &walk->ahead_x, &walk->index);
    skip_axis(exit, walk->per_voxel_y, walk->stride_y, most_y, &walk->next_y, &walk->ahead_y, &walk->index);
    skip_axis(exit, walk->per_voxel_z, walk->stride_z, walk->ahead_z, &walk->next_z, &walk->ahead_z, &walk->index);
    if (periodic)
        walk_wrap(scene, walk);
    return true;
}

/* Moves the ray to `distance` km along itself, a point of the walk's current voxel. */
inline void move_to_walk(const RARELY_READ __constant Scene *scene, Ray *ray, const VoxelWalk *walk, float distance)
{
    float3 position = ray->position + distance * ray->direction / grid_spacing(scene);
    const int3 voxel = walk_voxel(scene, walk);
    const float3 corner = convert_float3(voxel);
    if (scene->periodic) {
        const float2 count = (float2)((float)scene->shape[0], (float)scene->shape[1]);
        position.xy -= count * rint((position.xy - corner.xy - 0.5f) / count);
    }
    /* Rounding may put the point slightly outside of the walk's voxel. */
    ray->position.x = within(position.x, corner.x, corner.x + 1.0f);
    ray->position.y = within(position.y, corner.y, corner.y + 1.0f);
    ray->position.z = within(position.z, corner.z, corner.z + 1.0f);
    ray->voxel = voxel;
    ray->inside = true;
}

#endif
