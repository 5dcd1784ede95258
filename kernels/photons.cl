/* The radiance table, filled by photons from the sun: what they bring to every cell that they cross.
 *
 * The lengths of a photon's flights through a cell, times its weight, are an estimate of the radiance there without a
 * denominator that is sampled: of N photons that stand for the power P together,
 *
 *     radiance of a bin = P / N sum of weight x length / (the cell's volume x the bin's solid angle)
 *
 * (Spanier and Gelbard 1969, "Monte Carlo principles and neutron transport problems": the track-length estimator).
 * It is unbiased wherever light goes. Flights before the first event are direct sunlight, which the table has apart.
 *
 * With open sides, surface and air go on for ever around the domain, and no photon may start everywhere. There all
 * photons end where they leave the domain, and others start where light enters it (arriving.cl). */
#include "box.h"
#include "radiance_table.h"
#include "walk/accumulate.h"
#include "walk/camera.h"
#include "walk/event.h"
#include "walk/turns.h"

typedef struct {
    const __global int *column;
    const __global uint4 *cells;
    volatile __global Accumulator *sums; /* [cell][bin], units of 1 / unit km */
    float unit;
    bool is_diffuse; /* light from the first flight on */
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
    /* The table's directions are those of paths from cameras: against the light. */
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

inline void on_scattering(const Medium *medium, const KEPT Interaction *at, const KEPT SampleKey *key, Tally *tally) {}

#include "walk/unbudgeted.h"
#include "walk/path.h"

/* Photon `sample_in_launch * pixel_count + pixel` starts in a pixel of the sun's view, as those of fluxes; or photon n
 * where light enters a box. Its weight is 1, or given. */
__kernel void fill_table(FILL_TABLE_PARAMETERS)
{
    const Medium medium = make_medium(MEDIUM_ARGUMENTS);
    TURNS(turn, photon_count);
    KEPT_FOR_ITEM(SampleKey, key);
    KEPT_FOR_ITEM(Interaction, at);
    Tally tally = {column, cells, table_sums, unit, enters_box != 0};
    for (bool walks = false;;) {
        if (!walks) {
            if (!next_turn(&turn))
                break;
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
        do
            walks = walk_event(&medium, at, key, &tally);
        while (walks && !REGENERATES);
    }
}

/* Bins whose sums are made side by side: each in its order, all in registers. */
#define TOGETHER 20
#if DIRECTION_BINS % TOGETHER
#error TOGETHER has to divide the number of bins
#endif

/* From a cell's sums to what derivatives are made of, in their place, for tables take much memory. Volatile: compilers
 * may think that numbers of two types never share a place. */
__kernel void tabulate(TABULATE_PARAMETERS)
{
    const size_t cell = get_global_id(0);
    if (cell >= count)
        return;
    volatile __global Accumulator *sums = table_sums + cell * DIRECTION_BINS;
    float into[DIRECTION_BINS]; /* what photons have brought */
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
