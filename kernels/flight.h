/* A free flight: from a point along a ray to a collision, or out of all that scatters. */
#ifndef CLOUDTOMO_FLIGHT_H
#define CLOUDTOMO_FLIGHT_H

#include "grid.h"
#include "medium.h"
#include "record.h"

/* A voxel's faces that one flight may cross before the path is given up as lost: only a ray
 * that is horizontal, or all but, in a periodic and empty layer gets there. */
#define CROSSINGS_LIMIT (1 << 18)

/* How a flight ended. */
typedef struct {
    bool collided;
    bool met_grid;     /* it has been inside the grid */
    bool through_side; /* it left the grid through a side */
    float depth;       /* optical depth flown through */
    float droplets;    /* extinction where it collided, km^-1 */
    float air;
    int index;         /* voxel where it collided; -1 outside of the grid */
} Flight;

#ifdef CLOUDTOMO_ATMOSPHERE
/* Flies through the layers of air beside, above and below the grid, up to `limit` km. Moves the
 * ray to a collision (true), or if nothing limits it to where it leaves the atmosphere. */
inline bool fly_outside(const Medium *medium, Ray *ray, float reach, float limit, Flight *flight)
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
        if (depth >= reach) {
            distance = lesser(distance + (reach - flight->depth) / air, end);
            ray->position = wrapped(scene, ray->position + distance * ray->direction / spacing);
            ray->inside = false;
            flight->collided = true;
            flight->depth = reach;
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
#endif

/* Flies along the ray until it has crossed the optical depth `reach` (a collision) or left all
 * that scatters; moves the ray there. `carried` is what its crossings deposit. */
static Flight fly(const Medium *medium, Ray *ray, float reach, Carried carried, Record *record)
{
    const __constant Scene *scene = medium->scene;
    Flight flight = {false, false, false, 0.0f, 0.0f, 0.0f, -1};
    bool beside_clear = false; /* skipping may begin here: the voxel before, or what is around the grid, is clear */
    if (!ray->inside) {
        Ray entered = *ray;
        float distance;
        flight.met_grid = enter_domain(scene, &entered, &distance);
#ifdef CLOUDTOMO_ATMOSPHERE
        if (fly_outside(medium, ray, reach, flight.met_grid ? distance : INFINITY, &flight))
            return flight;
#endif
        if (!flight.met_grid)
            return flight;
        *ray = entered;
        beside_clear = scene->skips_clear;
    }
    flight.met_grid = true;
    VoxelWalk walk = walk_begin(scene, ray);
    for (int crossing = 0; crossing < CROSSINGS_LIMIT; ++crossing) {
        count_crossing(record);
        bool goes_on;
        const int clear = beside_clear ? medium->clear[clear_block(scene, &walk)] : 0;
        if (clear > (scene->clear_shift == 0)) {
            goes_on = walk_skip(scene, &walk, clear);
        } else {
            const float exit = walk_exit(&walk);
            const float length = exit - walk.distance;
            const float droplets = medium->extinction[walk.index];
            const float air = medium->air[walk_layer(scene, &walk)];
            const float extinction = droplets + air;
            const float depth = flight.depth + extinction * length;
            if (depth >= reach) {
                const float part = lesser((reach - flight.depth) / extinction, length);
                deposit_crossing(record, walk.index, part, carried);
                move_to_walk(scene, ray, &walk, walk.distance + part);
                flight.collided = true;
                flight.depth = reach;
                flight.droplets = droplets;
                flight.air = air;
                flight.index = walk.index;
                return flight;
            }
            deposit_crossing(record, walk.index, length, carried);
            flight.depth = depth;
            beside_clear = extinction == 0.0f && scene->skips_clear;
            goes_on = walk_advance(scene, &walk, exit);
        }
        if (!goes_on) {
            ray->position += walk.distance * ray->direction / grid_spacing(scene);
            ray->inside = false;
            flight.through_side = walk.ahead_z >= 0;
#ifdef CLOUDTOMO_ATMOSPHERE
            fly_outside(medium, ray, reach, INFINITY, &flight);
#endif
            return flight;
        }
    }
    record->lost = true;
    ray->inside = false;
    return flight;
}

#endif
