/* A free flight: from a point along a ray to a collision, or out of all that scatters. */
#ifndef CLOUDTOMO_FLIGHT_H
#define CLOUDTOMO_FLIGHT_H

#include "walk/medium.h"

/* Largest number of voxel faces that a flight may cross before it is given up as lost: only a
 * nearly horizontal ray in an empty layer of a periodic domain gets there. */
#define CROSSINGS_LIMIT (1 << 18)

/* How a flight ended. */
typedef struct {
    bool collided;
    bool met_grid;     /* it has been inside the grid */
    bool through_side; /* it left the grid through a side */
    bool lost;         /* it was given up */
    float depth;       /* optical depth of the way flown */
    float droplets;    /* extinction of droplets where it collided, km^-1 */
    float air;         /* extinction of molecules where it collided, km^-1 */
    int index;         /* voxel where it collided; -1 outside of the grid */
} Flight;

#ifdef CLOUDTOMO_ATMOSPHERE
/* Flies through the layers of air beside, above and below the grid, at most `limit` km. Moves the ray to a
 * collision and returns true; or, if the limit is infinite, to where it leaves the atmosphere. */
inline bool fly_outside(const Medium *medium, Ray *ray, float optical_depth, float limit, Flight *flight)
{
    const __constant Scene *scene = medium->scene;
    const int layers = scene->air_layers;
    const float3 spacing = grid_spacing(scene);
    const float height = ray->position.z * spacing.z; /* km above the grid's lowest face */
    const float vertical = ray->direction.z;
    const float top = medium->level[layers];
    float distance = 0.0f;
    if (height > top) {
        if (vertical >= 0.0f)
            return false;
        distance = (top - height) / vertical;
    }
    const float start = lesser(height, top);
    int k = interval(medium->level, layers + 1, start);
    if (vertical < 0.0f && start <= medium->level[k])
        --k;
    for (; k >= 0 && k < layers; k += vertical > 0.0f ? 1 : -1) {
        const float face = medium->level[vertical > 0.0f ? k + 1 : k];
        const float exit = vertical == 0.0f ? INFINITY : (face - height) / vertical;
        const float end = lesser(exit, limit);
        const float air = medium->layer[k];
        const float depth = flight->depth + (air > 0.0f ? air * greater(end - distance, 0.0f) : 0.0f);
        if (depth >= optical_depth) {
            distance = lesser(distance + (optical_depth - flight->depth) / air, end);
            ray->position = wrapped(scene, ray->position + distance * ray->direction / spacing);
            ray->inside = false;
            flight->collided = true;
            flight->depth = optical_depth;
            flight->air = air;
            return true;
        }
        flight->depth = depth;
        if (end >= limit || isinf(end))
            break;
        distance = end;
    }
    if (isinf(limit))
        ray->position = wrapped(scene, ray->position + distance * ray->direction / spacing);
    return false;
}
#else
/* There is no air outside of the grid. */
inline bool fly_outside(const Medium *medium, Ray *ray, float optical_depth, float limit, Flight *flight)
{
    return false;
}
#endif

/* Flies along the ray up to the optical depth `optical_depth` (a collision), or until it has left everything
 * that scatters, and moves the ray there. Nothing is done on the way. */
#define TRAVERSAL fly
#define TRAVERSAL_CONTEXT
#define CROSSES(index, length)
#include "walk/traversal.h"

#endif
