/* The voxel grid: rays into it, and the one walk from voxel to voxel.
 *
 * Positions inside kernels are in voxel units from the domain's lower corner, so that
 * voxel (i, j, k) is the cube [i, i+1) x [j, j+1) x [k, k+1); directions are unit vectors
 * in space; distances along a ray are in km. Arrays are [x][y][z], z fastest.
 */
#ifndef CLOUDTOMO_GRID_H
#define CLOUDTOMO_GRID_H

typedef struct {
    float3 position;  /* voxel units */
    float3 direction; /* unit vector */
    int3 voxel;       /* the voxel that holds position; valid if inside */
    bool inside;      /* the position is known to lie in the domain */
} Ray;

/* A walk along a ray. `distance` is where the current voxel begins on the ray. */
typedef struct {
    float distance;   /* km from the ray's start */
    float3 next;      /* km from the ray's start to the next face, per axis */
    float3 per_voxel; /* km between faces, per axis */
    int3 step;        /* +1 or -1, per axis */
    int3 voxel;
    int index;        /* of voxel, in an array [x][y][z] */
} VoxelWalk;

inline float3 grid_spacing(const __constant Scene *scene) /* km */
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

/* The position in the domain that a position in one of its periodic copies stands for. */
inline float3 wrapped(const __constant Scene *scene, float3 position)
{
    if (scene->periodic) {
        const float2 count = (float2)((float)scene->shape[0], (float)scene->shape[1]);
        position.xy -= count * floor(position.xy / count);
    }
    return position;
}

/* Where along one axis a ray is between two faces: [*near, *far] in km. */
inline void clip_axis(float position, float direction, float spacing, float count,
                      float *near, float *far)
{
    if (direction == 0.0f) {
        if (position < 0.0f || position > count)
            *far = -1.0f;
        return;
    }
    const float per_voxel = spacing / direction;
    const float lower = -position * per_voxel;
    const float upper = (count - position) * per_voxel;
    *near = fmax(*near, fmin(lower, upper));
    *far = fmin(*far, fmax(lower, upper));
}

/* Moves a ray that is not inside to where it enters the domain, `distance` km ahead; false if it
 * never does. */
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
    ray->position = clamp(position, (float3)(0.0f), count);
    ray->voxel = min(convert_int3(ray->position), grid_shape(scene) - 1);
    ray->inside = true;
    *distance = near;
    return true;
}

inline float first_face(float position, int voxel, float direction, float per_voxel)
{
    if (direction == 0.0f)
        return INFINITY;
    const float to_face = direction > 0.0f ? (float)(voxel + 1) - position
                                           : position - (float)voxel;
    return fmax(to_face, 0.0f) * per_voxel;
}

inline VoxelWalk walk_begin(const __constant Scene *scene, const Ray *ray)
{
    VoxelWalk walk;
    walk.distance = 0.0f;
    walk.per_voxel = grid_spacing(scene) / fabs(ray->direction);
    walk.next.x = first_face(ray->position.x, ray->voxel.x, ray->direction.x, walk.per_voxel.x);
    walk.next.y = first_face(ray->position.y, ray->voxel.y, ray->direction.y, walk.per_voxel.y);
    walk.next.z = first_face(ray->position.z, ray->voxel.z, ray->direction.z, walk.per_voxel.z);
    walk.step.x = ray->direction.x > 0.0f ? 1 : -1;
    walk.step.y = ray->direction.y > 0.0f ? 1 : -1;
    walk.step.z = ray->direction.z > 0.0f ? 1 : -1;
    walk.voxel = ray->voxel;
    walk.index = voxel_index(scene, ray->voxel);
    return walk;
}

/* km from the ray's start to where it leaves the current voxel. */
inline float walk_exit(const VoxelWalk *walk)
{
    return fmin(walk->next.z, fmin(walk->next.x, walk->next.y));
}

/* To the next voxel; false if that leaves the domain. */
inline bool walk_advance(const __constant Scene *scene, VoxelWalk *walk, float exit)
{
    walk->distance = exit;
    if (walk->next.z == exit) {
        walk->voxel.z += walk->step.z;
        walk->next.z += walk->per_voxel.z;
        walk->index += walk->step.z;
        return (uint)walk->voxel.z < (uint)scene->shape[2];
    }
    if (walk->next.x == exit) {
        walk->voxel.x += walk->step.x;
        walk->next.x += walk->per_voxel.x;
        if ((uint)walk->voxel.x >= (uint)scene->shape[0]) {
            if (!scene->periodic)
                return false;
            walk->voxel.x -= walk->step.x * scene->shape[0];
        }
    } else {
        walk->voxel.y += walk->step.y;
        walk->next.y += walk->per_voxel.y;
        if ((uint)walk->voxel.y >= (uint)scene->shape[1]) {
            if (!scene->periodic)
                return false;
            walk->voxel.y -= walk->step.y * scene->shape[1];
        }
    }
    walk->index = voxel_index(scene, walk->voxel);
    return true;
}

/* From a voxel with nothing within `clear` voxels of it (itself included, along every axis) to where
 * the ray leaves that cube, or the domain: false then. */
inline bool walk_skip(const __constant Scene *scene, VoxelWalk *walk, int clear)
{
    const float3 beyond = walk->next + (float)(clear - 1) * walk->per_voxel;
    const int3 ahead = select(walk->voxel, grid_shape(scene) - 1 - walk->voxel, walk->step > 0);
    float3 leave = walk->next + convert_float3(ahead) * walk->per_voxel;
    if (scene->periodic)
        leave.xy = (float2)(INFINITY);
    const float leave_first = fmin(leave.z, fmin(leave.x, leave.y));
    const float exit = fmin(fmin(beyond.z, fmin(beyond.x, beyond.y)), leave_first);
    walk->distance = exit;
    if (exit >= leave_first) {
        if (leave.z <= exit)
            walk->voxel.z = walk->step.z > 0 ? scene->shape[2] : -1;
        return false;
    }
    const int3 crossed = select((int3)(0), convert_int3((exit - walk->next) / walk->per_voxel) + 1, walk->next <= exit);
    walk->next += select((float3)(0.0f), convert_float3(crossed) * walk->per_voxel, crossed > 0);
    walk->voxel += crossed * walk->step;
    if (scene->periodic) { /* the host has seen to it that `clear` is no more than the domain */
        walk->voxel.x = (walk->voxel.x + scene->shape[0]) % scene->shape[0];
        walk->voxel.y = (walk->voxel.y + scene->shape[1]) % scene->shape[1];
    }
    walk->index = voxel_index(scene, walk->voxel);
    return true;
}

/* Moves the ray to `distance` km along itself, a point of the walk's current voxel. */
inline void move_to_walk(const __constant Scene *scene, Ray *ray, const VoxelWalk *walk, float distance)
{
    float3 position = ray->position + distance * ray->direction / grid_spacing(scene);
    const float3 corner = convert_float3(walk->voxel);
    if (scene->periodic) {
        const float2 count = (float2)((float)scene->shape[0], (float)scene->shape[1]);
        position.xy -= count * rint((position.xy - corner.xy - 0.5f) / count);
    }
    /* Rounding may put the point a hair outside of the voxel that the walk is in. */
    ray->position = clamp(position, corner, corner + 1.0f);
    ray->voxel = walk->voxel;
    ray->inside = true;
}

#endif
