"""How a recovery goes wrong with what it is told of the scene: droplets, surface, sun, air and radiometry.

    python scripts/wrong_optics.py --output runs/wrong-optics

One generated cumulus, nine views, one set of noisy images; a recovery that is told the truth, the same with other
random numbers (the spread that is no effect), and recoveries that are told something else. The mask is the same in
all: what carving leaves of the domain with the truth. Without it the table would show mostly what a wrong surface
does to carving; "carved" is the share of the voxels that it would leave by what is told, and "lost" the share of the
cloud's optical mass that it would rule out. The images of the last two rows have air in front of them (a standard
atmosphere at 672 nm), the others have none. Prints eps, delta, and the mean cost of the last five iterations over that
of the recovery that was told the truth: above 1 where the images themselves tell that something is wrong. Rows that
are in the output folder already are not made again.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

import cloudtomo_cl as ct
from cloudtomo_cl.inversion.carving import carved_mask

# km: of the domain, its base, the cloud's base and top, the cameras' height and the radius of their ring; degrees.
_EDGE, _BASE, _CLOUD_BASE, _CLOUD_TOP = 1.0, 0.3, 0.4, 1.25
_HEIGHT, _RADIUS, _FIELD_OF_VIEW = 2.6, 1.6, 34.0
_CLOUD_SEED, _IMAGE_SEED, _PEAK = 5, 1, 60.0
# What the images are made with.
_G, _ALBEDO, _WAVELENGTH = 0.85, 0.05, 672.0
_SUN = ct.Sun(zenith=25.0, azimuth=40.0)
TRUTH, OTHER_NUMBERS, IN_AIR, NO_AIR = "the truth", "the truth, other random numbers", "the truth, in air", "no air"


@dataclass(frozen=True)
class Images:
    """What was measured, of which scene, and which voxels may hold cloud by that."""

    scene: ct.Scene
    measurements: ct.Measurements
    mask: np.ndarray
    truth: np.ndarray


def true_scene(voxels: int) -> ct.Scene:
    """What the images are made with, but for air."""
    grid = ct.Grid(shape=(voxels,) * 3, spacing=(_EDGE / voxels,) * 3, origin=(0.0, 0.0, _BASE))
    return ct.Scene(grid=grid, sun=_SUN, cloud=droplets(_G), surface=ct.Surface(albedo=_ALBEDO))


def in_air(scene: ct.Scene) -> ct.Scene:
    """The same in a standard atmosphere."""
    return replace(scene, air=ct.Air(wavelength=_WAVELENGTH))


def droplets(g: float, single_scattering_albedo: float = 1.0) -> ct.Cloud:
    """What clouds are made of."""
    return ct.Cloud(phase_function=ct.HenyeyGreenstein(g=g), single_scattering_albedo=single_scattering_albedo)


def told(scene: ct.Scene) -> dict[str, ct.Scene]:
    """What recoveries are told, by the words of the table."""
    suns = {
        "sun 2 degrees lower": replace(_SUN, zenith=_SUN.zenith + 2),
        # 4.7 degrees of azimuth are 2 degrees on the sky where it stands.
        "sun 2 degrees aside": replace(_SUN, azimuth=_SUN.azimuth + 4.7),
        "irradiance 3 % too large": replace(_SUN, irradiance=1.03),
    }
    return {
        TRUTH: scene,
        OTHER_NUMBERS: scene,
        "g 0.87": replace(scene, cloud=droplets(0.87)),
        "g 0.83": replace(scene, cloud=droplets(0.83)),
        "single-scattering albedo 0.995": replace(scene, cloud=droplets(_G, 0.995)),
        **{f"surface albedo {a:g}": replace(scene, surface=ct.Surface(albedo=a)) for a in (0.06, 0.0, 0.1, 0.15)},
        **{name: replace(scene, sun=sun) for name, sun in suns.items()},
        NO_AIR: scene,
        IN_AIR: in_air(scene),
    }


def recovered(images: Images, scene: ct.Scene, seed: int, cpu_seconds: float) -> dict[str, float]:
    """Errors, the last cost, and what carving would leave by what is told."""
    device = ct.choose_device()
    carved = carved_mask(scene, images.measurements, device)
    start = time.process_time()
    result = ct.reconstruct(
        scene,
        images.measurements,
        mask=images.mask,
        device=device,
        seed=seed,
        uncertainty=0,
        stop=lambda: time.process_time() - start > cpu_seconds,
    )
    last = [record.cost for record in result.history if record.stage == result.history[-1].stage][-5:]
    return {
        "eps": float(ct.epsilon(result.extinction, images.truth)),
        "delta": float(ct.delta(result.extinction, images.truth)),
        "cost": sum(last) / len(last),
        "carved": float(carved.mean()),
        "lost": float(images.truth[~carved].sum(dtype=float) / images.truth.sum(dtype=float)),
        "stages": result.history[-1].stage + 1,
        "iterations": len(result.history),
        "cpu_seconds": time.process_time() - start,
    }


def simulated(voxels: int, pixels: int, paths: int) -> tuple[Images, Images]:
    """The same cloud without and with air; the mask is that of the former for both."""
    scene = true_scene(voxels)
    truth = ct.cumulus(scene.grid, seed=_CLOUD_SEED, peak=_PEAK, base=_CLOUD_BASE, top=_CLOUD_TOP)
    ring = ct.RingOfViews(scene.grid.centre, _HEIGHT, _RADIUS, _FIELD_OF_VIEW, (pixels, pixels))
    measured = []
    for one in (scene, in_air(scene)):
        operator = ct.RadianceOperator(one, ring.views())
        measured.append(ct.Measurements.rendered(operator, operator.render(truth, paths, _IMAGE_SEED)))
    mask = carved_mask(scene, measured[0], ct.choose_device())
    return Images(scene, measured[0], mask, truth), Images(in_air(scene), measured[1], mask, truth)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--voxels", type=int, default=18, help="along each edge (18)")
    parser.add_argument("--pixels", type=int, default=28, help="width of the images (28)")
    parser.add_argument("--paths", type=int, default=1024, help="of the images, per pixel (1024)")
    parser.add_argument("--seed", type=int, default=2, help="of recoveries (2)")
    parser.add_argument("--cpu-seconds", type=float, default=30.0, help="of each recovery (30)")
    parser.add_argument("--output", type=Path, required=True)
    arguments = parser.parse_args()
    arguments.output.mkdir(parents=True, exist_ok=True)
    file = arguments.output / "numbers.json"
    rows = json.loads(file.read_text()) if file.exists() else {}
    clear, hazy = simulated(arguments.voxels, arguments.pixels, arguments.paths)
    print(f"| {'told':34} | eps | delta | cost | carved | lost |\n|---|---|---|---|---|---|")
    for name, scene in told(clear.scene).items():
        images = hazy if name in (IN_AIR, NO_AIR) else clear
        if name not in rows:
            seed = arguments.seed + (name == OTHER_NUMBERS)
            rows[name] = recovered(images, scene, seed, arguments.cpu_seconds)
            file.write_text(json.dumps(rows, indent=1) + "\n")
        row = rows[name]
        cost = row["cost"] / rows[TRUTH]["cost"]
        errors = f"{row['eps']:.3f} | {row['delta']:+.1%} | {cost:.2f}"
        print(f"| {name:34} | {errors} | {row['carved']:.0%} | {row['lost']:.1%} |", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
