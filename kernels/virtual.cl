/* Paths from virtual collisions, for the gradient of a cost (virtual.h). */
#include "gradient_target.h"
#include "virtual.h"

__kernel void virtual_paths(VIRTUAL_PATHS_PARAMETERS)
{
    const size_t item = get_global_id(0);
    if (item >= count)
        return;
    const __global VirtualCollision *from = virtual_collisions + item;
    const uint sample = first_sample + from->path / pixel_count;
    const uint pixel_in_list = from->path % pixel_count;
    const uint2 pixel = pixels[pixel_in_list];
    const SampleKey key = {seed, stream, pixel.y, pixel.x + VIRTUAL_PATHS_VIEW, sample};
    const Medium medium = make_medium(MEDIUM_ARGUMENTS);
    const Target target = {adjoint_of(adjoint, pixel_in_list, sample), gradient};
    int index;
    const float derivative = virtual_derivative(&medium, from, &key, virtual_extinction, &index);
    if (derivative != 0.0f)
        deposit(&target, index, derivative);
}
