"""Energy audits: where the weight of the paths of five scenes has gone."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

from benchmarks.scenes import generated, scene_c

import cloudtomo_cl as ct
from gpu.rows import Row, failed

_PART = "audits"
# Of the scenes of tests/kernels/scenes.py: absorption, layers of air, a surface, endless sides, a phase table.
_SCENES = ("absorbing", "air, ground, periodic", "air outside, open", "phase table")
_LARGEST_IMBALANCE = 1e-5


def small_scenes() -> dict[str, tuple[ct.Scene, list[ct.PerspectiveView], object]]:
    """Those of the kernels' tests, with two views and an extinction in km^-1."""
    folder = str(Path(__file__).resolve().parents[2] / "tests" / "kernels")
    sys.path.insert(0, folder)
    try:
        import scenes
    finally:
        sys.path.remove(folder)
    return {name: (scenes.SCENES[name], [scenes.ABOVE, scenes.CAMERA], scenes.extinction_of(scenes.SCENES[name]))
            for name in scenes.SCENES}  # fmt: skip


def rows(quick: bool) -> Iterator[Row]:
    samples = 20_000 if quick else 200_000
    every = small_scenes()
    for name in _SCENES:
        scene, views, extinction = every[name]
        yield audited(name, ct.RadianceOperator(scene, views), extinction, samples)
    try:
        case, samples = scene_c(), 64 if quick else 4096
    except FileNotFoundError:
        case, samples = generated(64), 64 if quick else 1024
    yield audited(case.name, ct.RadianceOperator(case.scene, (case.view,)), case.extinction, samples)


def audited(name: str, operator: ct.RadianceOperator, extinction: object, samples: int) -> Row:
    """An audit's balance."""
    try:
        audit = operator.render(extinction, samples, seed=1).audit
    except ct.CloudtomoError as error:
        return failed(_PART, f"{name}: {error}")
    note = f"{audit.launched:.3g} paths; roulettes took {audit.killed:.1e} +- {audit.killed_standard_error:.1e}"
    return Row(_PART, f"{name}: shares less 1", audit.balance, "", note, abs(audit.balance) < _LARGEST_IMBALANCE)
