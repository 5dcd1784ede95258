/* Derivatives by the radiance table: without collisions and without 1 / extinction.
 *
 * A little more extinction of droplets at a point weakens the light that passes there, and scatters light from other
 * directions into its direction. So along every flight of a path of throughput w, a crossing of l km in direction d
 * adds w l (source(d) - radiance(d)) to the pixel's derivative, with the source function of droplets there; and the
 * shadow ray to the sun adds -l times the local estimate. Source and radiance come from the table, which photons from
 * the sun have filled (photons.cl). So each path uses the mean of all light along its way, which has little noise; the
 * size of the table's cells is the source of bias (docs/explanation/derivatives.md).
 *
 * The including file defines, before it includes this, the struct `Tally` with at least the members of
 * walk/radiance.h and
 *
 *   float total;          the whole path's radiance, sr^-1
 *   RadianceTable table;
 *
 * and a function that takes a derivative of the path's radiance (sr^-1 km) by a voxel, given by its index and its
 * column of the table:
 *
 *   void tally_derivative(int index, int column, float derivative, Tally *tally)
 */
#ifndef CLOUDTOMO_DERIVATIVES_H
#define CLOUDTOMO_DERIVATIVES_H

#include "radiance_table.h"
#include "walk/accumulate.h"
#include "walk/estimate.h"
#include "walk/replayed.h"

/* The quantities of a flight that its deposits need. */
typedef struct {
    float throughput;  /* factor of the flight's radiance in the pixel: path's throughput times flight's share */
    float sun_density; /* density of scattering by droplets from the sun into the flight, sr^-1 */
    int bin;           /* bin of the flight's direction */
} Payload;

/* Source function minus radiance along a flight in a cell, direct sunlight included, sr^-1. */
inline float cell_source(const RadianceTable *table, uint cell, float sunlight, Payload payload)
{
    return scattered_less_radiance(table, cell, payload.bin) + payload.sun_density * sunlight * table->sunlight[cell];
}

inline void deposit_crossing(const __constant Scene *scene, const Ray *ray, const VoxelWalk *walk, float length,
                             float droplets, Payload payload, Tally *tally)
{
    const RadianceTable *table = &tally->table;
    const int index = walk->index, column = table->column[index];
    if (column < 0)
        return;
    const uint4 cells = table->cells[column];
    const SunlightWalk sun = walk_sunlight(scene, ray, walk->distance, length, droplets);
    float sources = 0.0f; /* sum over cells of source minus radiance, times length */
    if (is_whole(cells)) {
        sources = length * cell_source(table, cells.x, mean_sunlight(&sun, 0.0f, length), payload);
    } else {
        CellWalk part = walk_cells(scene, cells, ray, walk->distance, length);
        while (part.from < length) {
            const uint cell = part.cell;
            const float from = part.from, crossed = leave_cell(&part, length);
            sources += crossed * cell_source(table, cell, mean_sunlight(&sun, from, crossed), payload);
        }
    }
    tally_derivative(index, column, payload.throughput * sources, tally);
}

#define TRAVERSAL fly_and_deposit
#define TRAVERSAL_CONTEXT , Payload payload, Tally *tally
#define CROSSES(index, length) deposit_crossing(scene, ray, &walk, length, droplets, payload, tally)
#include "walk/traversal.h"

/* Deposits the derivative of a local estimate by a voxel that its shadow ray crosses. */
inline void deposit_shadow(int index, float length, float radiance, Tally *tally)
{
    const int column = tally->table.column[index];
    if (column >= 0)
        tally_derivative(index, column, length * -radiance, tally);
}

#define TRAVERSAL fly_to_sun
#define TRAVERSAL_CONTEXT , float radiance, Tally *tally
#define CROSSES(index, length) deposit_shadow(index, length, radiance, tally)
#include "walk/traversal.h"

inline Payload payload_of(const Medium *medium, const Segment *segment, float share)
{
    Payload payload;
    payload.throughput = share * segment->throughput;
    payload.sun_density = sun_density(medium, segment->start.direction);
    payload.bin = direction_bin(segment->start.direction);
    return payload;
}

inline Flight tally_fly(const Medium *medium, Ray *ray, const Segment *segment, Tally *tally)
{
    if (segment->event == 1u) /* camera_rays.h */
        return fly(medium, ray, segment->optical_depth);
    return fly_and_deposit(medium, ray, segment->optical_depth, payload_of(medium, segment, tally->own_share), tally);
}

inline void tally_segment(const Medium *medium, const Segment *segment, const Flight *flight, Particle end, float share,
                          float local_radiance, Tally *tally)
{
}

inline void tally_side_flight(const Medium *medium, const Segment *segment, const Flight *flight, Particle end,
                              float share, float local_radiance, Tally *tally)
{
    Ray ray = segment->start;
    fly_and_deposit(medium, &ray, segment->optical_depth, payload_of(medium, segment, share), tally);
}

inline void tally_shadow_ray(const Medium *medium, const Ray *from, const LocalEstimate *estimate, Tally *tally)
{
    if (!depends_on_shadow_ray(medium, estimate))
        return;
    Ray ray = shadow_ray(medium, from);
    fly_to_sun(medium, &ray, INFINITY, estimate->radiance, tally);
}

inline void tally_new_branch(uint number, Tally *tally) {}
inline void tally_next_branch(uint number, Tally *tally) {}

#include "walk/unbudgeted.h"
#include "walk/radiance.h"

#endif
