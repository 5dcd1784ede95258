/* Derivatives along the first flights of paths from cameras, by the source function along their rays.
 *
 * All light of a pixel comes along its ray, and the table's radiance in the single bin of this direction is noisy. Its
 * source function is not, since droplets scatter from many bins. So along rays from cameras the radiance is integrated
 * from the source function ahead, and the table's radiance is taken only where the ray is left:
 *
 *     R = sum over the cells of c_k S_k (exp(-t_{k-1}) - exp(-t_k)) + exp(-t_n) radiance,
 *
 * with t the optical depth of droplets and air from the camera to a cell's end, and c the droplets' share of it. A
 * little more extinction of droplets in cell k, l km long, changes R by l (S_k exp(-t_k) - R_{>k}), where R_{>k} comes
 * from behind the cell. The table has no source function of air and ground. Their light is in the sample's path: if its
 * first flight ends in them, its radiance comes from there, and counts for the cells before.
 *
 * A first traversal sums up R, a second one deposits derivatives. Up to EXPECTED_DEPTH everything counts in full;
 * beyond it flights end at random as those of paths do, and those that go on also count for those that ended.
 *
 * The including file defines what derivatives.h says. */
#ifndef CLOUDTOMO_CAMERA_RAYS_H
#define CLOUDTOMO_CAMERA_RAYS_H

#include "radiance_table.h"
#include "walk/path.h"

/* Optical depths: flights do not end before the first; light is followed up to the second behind a flight's end. */
#define EXPECTED_DEPTH 2.0f
#define DEPTH_BEHIND 2.0f

typedef struct {
    const RadianceTable *table;
    float sun_density;   /* density of scattering by droplets from the sun into the ray, sr^-1 */
    int bin;             /* bin of the ray's direction */
    float transmittance; /* from the camera to the present point */
    float radiance;      /* part of R from the cells so far */
    float total;         /* R without the light from air and ground */
    float u_particle;    /* uniform number that chooses the path's first particle */
    float reach;         /* optical depth at which the path's first flight ends */
    float from_others;   /* radiance from there if the path meets no droplet there */
    uint last;           /* last cell of the table that was crossed */
    bool any;            /* whether a cell was crossed */
    bool meets_droplet;  /* whether the path's first particle is a droplet */
} CameraRay;

inline float ray_source(const CameraRay *own, uint cell, float sunlight)
{
    return diffuse_source(own->table, cell, own->bin) + own->sun_density * sunlight * own->table->sunlight[cell];
}

/* Cells are crossed in steps of at most this optical depth of droplets, since sunlight changes within a cell. */
#define STEP_DEPTH 0.3f
#define MOST_STEPS 8.0f
inline float steps_of(float depth) { return within(ceil(depth / STEP_DEPTH), 1.0f, MOST_STEPS); }

/* Crosses `length` km of a cell. */
inline void cross_part(float length, float source, float extinction, CameraRay *own)
{
    const float left = own->transmittance * exponential(-extinction * length);
    own->radiance += source * (own->transmittance - left);
    own->transmittance = left;
}

/* About the mean of exp(greater(t - EXPECTED_DEPTH, 0)) for depths t from a to b: one over the share of flights that
 * get there. */
inline float all_flights(float a, float b)
{
    const float from = greater(a - EXPECTED_DEPTH, 0.0f), until = greater(b - EXPECTED_DEPTH, 0.0f);
    return growth(0.5f * (from + until));
}

/* Crosses a cell; returns the derivative to be deposited there. */
inline float cross_cell(uint cell, float from, float length, const SunlightWalk *sun, float droplets, float extinction,
                        float depth, CameraRay *own)
{
    const float steps = sun->rate == 0.0f ? 1.0f : steps_of(droplets * length), step = length / steps;
    const float share = extinction > 0.0f ? droplets / extinction : 0.0f;
    float sum = 0.0f;
    for (float n = 0.0f; n < steps; n += 1.0f) {
        const float source = ray_source(own, cell, mean_sunlight(sun, from + n * step, step));
        cross_part(step, share * source, extinction, own);
        const float next = depth + extinction * step;
        const float change = source * own->transmittance - (own->total - own->radiance);
        const float from_others =
            own->reach > next ? own->from_others : 0.0f; /* only if the path's flight gets that far */
        sum += step * (change * all_flights(depth, next) - from_others);
        depth = next;
    }
    own->last = cell;
    own->any = true;
    return sum;
}

/* Crosses a voxel. `depth`: optical depth where the crossing begins; `extinction`: of droplets and air together. */
inline float cross_voxel(const __constant Scene *scene, const Ray *ray, const VoxelWalk *walk, float length,
                         float droplets, float extinction, float depth, CameraRay *own)
{
    if (own->reach > depth && own->reach <= depth + extinction * length)
        own->meets_droplet = own->u_particle * extinction < droplets;
    const int column = own->table->column[walk->index];
    if (column < 0)
        return 0.0f;
    own->transmittance = exponential(-depth);
    const uint4 cells = own->table->cells[column];
    const SunlightWalk sun = walk_sunlight(scene, ray, walk->distance, length, droplets);
    if (is_whole(cells))
        return cross_cell(cells.x, 0.0f, length, &sun, droplets, extinction, depth, own);
    float sum = 0.0f;
    CellWalk part = walk_cells(scene, cells, ray, walk->distance, length);
    while (part.from < length) {
        const uint cell = part.cell;
        const float from = part.from, crossed = leave_cell(&part, length);
        sum += cross_cell(cell, from, crossed, &sun, droplets, extinction, depth, own);
        depth += extinction * crossed;
    }
    return sum;
}

#define TRAVERSAL fly_and_gather
#define TRAVERSAL_CONTEXT , CameraRay *own
#define CROSSES(index, length) cross_voxel(scene, ray, &walk, length, droplets, extinction, flight.depth, own)
#include "walk/traversal.h"

inline void deposit_along_ray(const __constant Scene *scene, const Ray *ray, const VoxelWalk *walk, float length,
                              float droplets, float extinction, float depth, CameraRay *own, Tally *tally)
{
    const int column = own->table->column[walk->index];
    if (column < 0)
        return;
    const float sum = cross_voxel(scene, ray, walk, length, droplets, extinction, depth, own);
    tally_derivative(walk->index, column, sum, tally);
}

#define TRAVERSAL fly_and_deposit_along
#define TRAVERSAL_CONTEXT , CameraRay *own, Tally *tally
#define CROSSES(index, length) \
    deposit_along_ray(scene, ray, &walk, length, droplets, extinction, flight.depth, own, tally)
#include "walk/traversal.h"

/* Light of droplets behind all cells, as the camera sees it. */
inline float radiance_behind(const Flight *flight, const CameraRay *own)
{
    if (!flight->collided && !flight->lost)
        return 0.0f;
    const float source = diffuse_source(own->table, own->last, own->bin);
    return own->transmittance * (source - scattered_less_radiance(own->table, own->last, own->bin));
}

/* Deposits derivatives of a pixel's radiance along a sample's ray; the sample's path has the given radiance. */
inline void deposit_camera_ray(const Medium *medium, const RadianceTable *table, const Ray *from,
                               const KEPT SampleKey *key, float path_radiance, Tally *tally)
{
    CameraRay own;
    own.table = table;
    own.sun_density = sun_density(medium, from->direction);
    own.bin = direction_bin(from->direction);
    own.transmittance = 1.0f;
    own.radiance = 0.0f;
    own.total = 0.0f;
    own.from_others = 0.0f;
    own.last = 0u;
    own.any = false;
    own.meets_droplet = false;
    const float2 u = event_uniforms(key, 1u, BLOCK_EVENT).xy; /* those of the sample's path, as in walk/path.h */
    own.reach = -logarithm(u.x);
    own.u_particle = u.y;
    Ray ray = *from;
    const Flight flight = fly_and_gather(medium, &ray, EXPECTED_DEPTH + own.reach + DEPTH_BEHIND, &own);
    if (!own.any)
        return;
    own.total = own.radiance + radiance_behind(&flight, &own);
    own.from_others = own.meets_droplet ? 0.0f : path_radiance;
    own.transmittance = 1.0f;
    own.radiance = 0.0f;
    ray = *from;
    fly_and_deposit_along(medium, &ray, EXPECTED_DEPTH + own.reach, &own, tally);
}

#endif
