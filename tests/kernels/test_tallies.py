"""What the walk tells a tally of a path: a small one, written here, that adds pieces up."""

import numpy as np
import pyopencl as cl
import pyopencl.array
import pytest
from scenes import CAMERA, SCENES, extinction_of

from cloudtomo_cl.opencl.parameters import PATHS, Kernel, macro
from cloudtomo_cl.transport.radiance import RadianceOperator

SAMPLES, SEED = 8, 3
SUMS = ("path", "local estimates", "side estimates", "crossed", "flown", "first flights", "first throughput", "shadow")
PARAMETERS = (*PATHS, "__global float *sums")
SOURCE = """
#include "walk/estimate.h"

typedef struct {
    float radiance, own_share;
    float collected, from_side, crossed, flown, first, throughput, shadow;
} Tally;

#define TRAVERSAL fly_and_measure
#define TRAVERSAL_CONTEXT , float *crossed
#define CROSSES(index, length) *crossed += (length) * medium->extinction[index]
#include "walk/traversal.h"

/* Droplets' optical depth on a flight that is flown again, and as it should be without air. */
inline void measure(const Medium *medium, const Segment *segment, const Flight *flight, Tally *tally)
{
    Ray again = segment->start;
    fly_and_measure(medium, &again, segment->optical_depth, &tally->crossed);
    tally->flown += flight->depth;
}

inline Flight tally_fly(const Medium *medium, Ray *ray, const Segment *segment, Tally *tally)
{
    tally->first += segment->event == 1u;
    tally->throughput += segment->event == 1u ? segment->throughput : 0.0f;
    return fly(medium, ray, segment->optical_depth);
}

inline void tally_segment(const Medium *medium, const Segment *segment, const Flight *flight, Particle end, float share,
                          float local_radiance, Tally *tally)
{
    measure(medium, segment, flight, tally);
    tally->collected += local_radiance;
}

inline void tally_side_flight(const Medium *medium, const Segment *segment, const Flight *flight, Particle end,
                              float share, float local_radiance, Tally *tally)
{
    measure(medium, segment, flight, tally);
    tally->from_side += local_radiance;
}

inline void tally_shadow_ray(const Medium *medium, const Ray *from, const LocalEstimate *estimate, Tally *tally)
{
    tally->shadow += estimate->radiance;
}

#include "walk/unbudgeted.h"
#include "walk/radiance.h"

__kernel void sum_pieces(SUM_PIECES_PARAMETERS)
{
    KEPT_FOR_ITEM(SampleKey, key);
    KEPT_FOR_ITEM(Interaction, at);
    const size_t path = get_global_id(0);
    if (path >= path_count)
        return;
    const uint2 pixel = pixels[path % pixel_count];
    const SampleKey own = {seed, stream, pixel.y, pixel.x, first_sample + (uint)(path / pixel_count)};
    keep_key(key, &own);
    const Medium medium = make_medium(MEDIUM_ARGUMENTS);
    Tally t = {0.0f, 1.0f, 0.0f, 0.0f, 0.0f, 0.0f, 0.0f, 0.0f, 0.0f};
    walk_path(&medium, at, camera_ray(scene, views + pixel.x, rays, &own), key, &t);
    const float8 found = {t.radiance, t.collected, t.from_side, t.crossed, t.flown, t.first, t.throughput, t.shadow};
    vstore8(found, path, sums);
}
"""


@pytest.fixture(scope="module", params=["plain", "side-flights"])
def pieces(request, device):
    """Each path's sums by name, and the rendering of the same paths."""
    scene = SCENES["ground"]
    operator = RadianceOperator(scene, [CAMERA], device, estimator=request.param)
    rendering = operator.render(extinction_of(scene).astype(np.float32), SAMPLES, SEED, store_paths=True)
    program = device.build(f"{macro('sum_pieces', PARAMETERS)}\n{SOURCE}")
    kernel = Kernel(cl.Kernel(program, "sum_pieces"), "sum_pieces", PARAMETERS)
    count = SAMPLES * len(operator.pixels)
    sums = pyopencl.array.zeros(device.queue, (count, len(SUMS)), np.float32)
    device.launch(kernel, count, **operator._pixels.paths(rendering._medium, 0, count, SEED, 0), sums=sums)
    return dict(zip(SUMS, sums.get().T)) | {"rendered": rendering._launches[0][1].get()[0]}


def test_a_tally_of_its_own_walks_the_same_paths(pieces):
    np.testing.assert_array_equal(pieces["path"], pieces["rendered"])
    assert pieces["path"].any()


def test_local_estimates_add_up_to_the_radiance(pieces):
    np.testing.assert_allclose(pieces["local estimates"] + pieces["side estimates"], pieces["path"], rtol=1e-5)
    np.testing.assert_allclose(pieces["shadow"], pieces["path"], rtol=1e-5)


def test_a_segment_that_is_flown_again_crosses_what_was_flown_through(pieces):
    np.testing.assert_allclose(pieces["crossed"], pieces["flown"], rtol=1e-4, atol=1e-5)
    assert pieces["flown"].max() > 1


def test_a_path_has_one_first_flight_of_throughput_1(pieces):
    assert (pieces["first flights"] == 1).all() and (pieces["first throughput"] == 1).all()
