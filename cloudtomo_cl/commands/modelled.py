"""Images of a recovered cloud from the measured views, for the report to compare with."""

from __future__ import annotations

import numpy as np

from cloudtomo_cl.commands import ranks, stopping
from cloudtomo_cl.commands.provenance import describe_device, source, versions
from cloudtomo_cl.commands.run_folder import RunFolder
from cloudtomo_cl.files.measurements import write_measurements
from cloudtomo_cl.opencl.device import Device
from cloudtomo_cl.scene.measurements import Measurements
from cloudtomo_cl.scene.scene import Scene
from cloudtomo_cl.settings.stored import stored_scene
from cloudtomo_cl.transport.radiance import RadianceOperator

# Some seconds on a CPU. With fewer a pixel its error does not hold: one that the few bright paths missed is too dark,
# and takes itself to be certain.
PATHS, FEWEST_SAMPLES = 3e6, 256


def write_modelled(
    folder: RunFolder,
    scene: Scene,
    measurements: Measurements,
    extinction: np.ndarray,
    device: Device,
    seed: int,
    stream: int,
) -> None:
    """Renders the cloud and writes modelled.nc.

    Parameters
    ----------
    extinction : km^-1, shape of the scene's grid
    stream : of the random numbers, one that the recovery did not use
    """
    operator = RadianceOperator(scene, measurements.views, device)
    samples = max(FEWEST_SAMPLES, 2 * round(PATHS / len(operator.pixels) / 2))
    ranks.check_together()
    rendering = operator.render(extinction, samples, seed, stream, progress=stopping.check)
    modelled = Measurements.rendered(operator, rendering)
    attributes = {
        "title": "images of a recovered cloud",
        "source": source(),
        "device": describe_device(device),
        "versions": versions(),
    }
    settings = {
        "scene": stored_scene(scene),
        "cloud_file": folder.files.reconstruction.name,
        "samples": samples,
        "seed": seed,
        "stream": stream,
    }

    def write() -> None:
        folder.claim(folder.files.modelled)
        write_measurements(folder.files.modelled, modelled, attributes, settings, (scene.grid, extinction, None))

    ranks.first_alone(write)
