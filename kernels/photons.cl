/* The radiance table, filled by photons from the sun, which add to every cell that they cross.
 *
 * The lengths of photons' flights through a cell, times their weights, estimate the radiance there without a random
 * denominator: for N photons with the total power P,
 *
 *     radiance of a bin = P / N sum of weight x length / (the cell's volume x the bin's solid angle)
 *
 * (Spanier and Gelbard 1969, "Monte Carlo principles and neutron transport problems": the track-length estimator).
 * It is unbiased wherever light goes. Flights before the first event are direct sunlight, a separate part of the table.
 *
 * With open sides, surface and air go on without end around the domain, and photons cannot start everywhere. There all
 * photons end where they leave the domain, and further ones start where light enters it (arriving.cl). */
#include "box.h"
#include "radiance_table.h"
#include "walk/accumulate.h"
#include "walk/camera.h"
#include "walk/event.h"
#include "walk/turns.h"

typedef struct {
    const __global int *column;
    const __global uint4 *cells;
    volatile __global Accumulator *sums; /* [cell][bin]: weight x length */
    float unit;                          /* units of the sums per km */
    bool is_diffuse;                     /* whether the first flight is diffuse light already */
} Tally;

inline void deposit_light(const __constant Scene *scene, const Ray *ray, const VoxelWalk *walk, float length, int bin,
                          float weight, Tally *tally)
{
    const int column = tally->column[walk->index];
    if (column < 0)
        return;
    const uint4 cells = tally->cells[column];
    volatile __global Accumulator *sums = tally->sums + bin;
    if (is_whole(cells)) {
        accumulate(sums + cells.x * DIRECTION_BINS, weight * length);
        return;
    }
    CellWalk part = walk_cells(scene, cells, ray, walk->distance, length);
    while (part.from < length) {
        const uint cell = part.cell;
        accumulate(sums + cell * DIRECTION_BINS, weight * leave_cell(&part, length));
    }
}

#define TRAVERSAL fly_and_deposit
#define TRAVERSAL_CONTEXT , int bin, float weight, Tally *tally
#define CROSSES(index, length) deposit_light(scene, ray, &walk, length, bin, weight, tally)
#include "walk/traversal.h"

inline Flight on_flight(const Medium *medium, Ray *ray, const Segment *segment, Tally *tally)
{
    if (segment->event == 1u && !tally->is_diffuse)
        return fly(medium, ray, segment->optical_depth);
    /* The table's directions are those of paths from cameras, against the light. */
    const int bin = direction_bin(-ray->direction);
    return fly_and_deposit(medium, ray, segment->optical_depth, bin, tally->unit * segment->throughput, tally);
}

inline void on_leaving(const Medium *medium, const Segment *segment, const Flight *flight, const Ray *ray,
                       Termination termination, bool ends, Tally *tally)
{
}

inline void on_interaction(const Medium *medium, const Segment *segment, const Flight *flight,
                           const KEPT Interaction *at, Tally *tally)
{
}

inline void on_scattering(const Medium *medium, KEPT Interaction *at, const KEPT SampleKey *key, Tally *tally) {}

#include "walk/unbudgeted.h"
#include "walk/path.h"

/* Photon number `sample_in_launch * pixel_count + pixel` starts in a pixel of the sun's view, as for fluxes; or photon
 * n starts where light enters a box. Its weight is 1, or given. */
__kernel void fill_table(FILL_TABLE_PARAMETERS)
{
    const Medium medium = make_medium(MEDIUM_ARGUMENTS);
    TURNS(turn, photon_count);
    KEPT_FOR_ITEM(SampleKey, key);
    KEPT_FOR_ITEM(Interaction, at);
    Tally tally = {column, cells, table_sums, unit, enters_box != 0};
    for (bool walks = false; walks || next_turn(&turn);) {
        if (!walks) {
            const float weight = weighted ? weights[turn.item] : 1.0f;
            if (weight == 0.0f)
                continue;
            SampleKey own;
            Ray ray;
            if (enters_box) {
                own = sample_key(seed, stream, (uint2)(ARRIVING_VIEW, 0u), first_sample + turn.item);
                ray = ray_into_box(scene, box, &own);
                own.view = ARRIVED_VIEW;
            } else {
                const uint sample = first_sample + turn.item / pixel_count;
                own = sample_key(seed, stream, (uint2)(TABLE_PHOTONS_VIEW, turn.item % pixel_count), sample);
                ray = camera_ray(scene, sun_view, 0, &own);
            }
            keep_key(key, &own);
            start_path(at, ray);
            at->throughput = weight;
        }
        walks = walk_turn(&medium, at, key, &tally);
    }
}

/* Number of bins whose sums are made at the same time, in registers; the order in each sum is fixed. */
#define TOGETHER 20
#if DIRECTION_BINS % TOGETHER
#error TOGETHER has to divide the number of bins
#endif

/* Replaces a cell's sums by source minus radiance, and source, in the same memory, since tables are large. Volatile:
 * compilers may assume that numbers of two types never share memory. */
__kernel void tabulate(TABULATE_PARAMETERS)
{
    const size_t cell = get_global_id(0);
    if (cell >= count)
        return;
    volatile __global Accumulator *sums = table_sums + cell * DIRECTION_BINS;
    float into[DIRECTION_BINS]; /* sums of weight x length in each bin */
    for (int bin = 0; bin < DIRECTION_BINS; ++bin) {
        if (has_overflowed(sums[bin]))
            atomic_inc(overflown);
        into[bin] = (float)sums[bin];
    }
    const uint3 parts = cells[cell_column[cell]].yzw;
    const float radiance = unit * (float)(parts.x * parts.y * parts.z);
    volatile __global float *diffuse = (volatile __global float *)sums;
    for (int first = 0; first < DIRECTION_BINS; first += TOGETHER) {
        float sums_of[TOGETHER] = {0.0f};
        for (int from = 0; from < DIRECTION_BINS; ++from)
#pragma unroll
            for (int n = 0; n < TOGETHER; ++n)
                sums_of[n] += into[from] * scattering[from * DIRECTION_BINS + first + n];
#pragma unroll
        for (int n = 0; n < TOGETHER; ++n) {
            const int bin = first + n;
            diffuse[bin] = radiance * (sums_of[n] - into[bin] / solid_angle[bin]);
            diffuse[DIRECTION_BINS + bin] = radiance * sums_of[n];
        }
    }
}
