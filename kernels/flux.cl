/* Fluxes: every work item follows one photon from the sun. */
#define CLOUDTOMO_FLUX
#include "path.h"

/* Photon `sample_in_launch * pixel_count + pixel` starts in a pixel of the sun's view of the
 * domain: on its top, or that of the atmosphere. */
__kernel void trace_photons(__constant Scene *scene, const __global View *sun_view,
                            const __global float *extinction, const __global float *table_row,
                            const __global uchar *clear, const __global float *profiles,
                            const uint pixel_count, const uint first_sample, const uint photon_count,
                            const uint seed,
                            volatile __global Accumulator *columns, /* weights, [Flux][x][y] */
                            volatile __global Accumulator *account)
{
    const size_t photon = get_global_id(0);
    if (photon >= photon_count)
        return;
    const SampleKey key = {seed, 0u, (uint)(photon % pixel_count), SUN_VIEW, first_sample + (uint)(photon / pixel_count)};
    const Medium medium = make_medium(scene, extinction, table_row, clear, profiles);
    Record record;
    record_begin(&record);
    record.account = account;
    record.columns = columns;
    trace_path(&medium, camera_ray(scene, sun_view, 0, &key), &key, &record);
}
