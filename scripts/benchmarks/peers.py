"""Rows against other programs: efficiency = 1 / (variance x CPU time), both programs in turn in one run."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache

import numpy as np

import cloudtomo_cl as ct
from benchmarks.mitsuba_peer import Missing, MitsubaScene
from benchmarks.scenes import Case, generated, scene_c
from benchmarks.timing import Disagreement, Line, require_agreement, timed
from cloudtomo_cl.transport.table_gradient import TableGradient

_CASES = {"c": scene_c, "generated": lambda: generated(128)}
_GOALS = {"forward": "100", "gradient": "250"}


@cache
def _mitsuba(name: str) -> tuple[Case, MitsubaScene]:
    case = _CASES[name]()
    return case, MitsubaScene(case)


def _missing(row: str, what: str, goal: str, reason: Exception) -> Line:
    return Line(row, what, (), goal, f"none: {reason}")


def forward(name: str, quick: bool) -> Iterator[Line]:
    """Images: variances of single paths averaged over the pixels, times the CPU seconds of a path."""
    row, what = f"forward-{name}", "efficiency over Mitsuba's volpath"
    try:
        case, peer = _mitsuba(name)
    except (Missing, FileNotFoundError) as reason:
        yield _missing(row, what, _GOALS["forward"], reason)
        return
    repeats, theirs, ours = (3, 32, 256) if quick else (5, 64, 512)
    operator = ct.RadianceOperator(case.scene, (case.view,))
    operator.render(case.extinction, 16, 1000)
    peer.sample_variance(theirs, 1000)
    peer.render(theirs, 1001)
    ratios, speeds, means = [], [], np.zeros((repeats, 2))
    errors = np.zeros((repeats, 2))
    variances = np.zeros((repeats, 2))
    times = np.zeros((repeats, 2))
    count = len(operator.pixels)
    for n in range(repeats):
        rendering, seconds = timed(lambda n=n: operator.render(case.extinction, ours, n))
        image, their_seconds = timed(lambda n=n: peer.render(theirs, 2 * n))
        _, single = peer.sample_variance(theirs, 2 * n + 1)
        times[n] = seconds / ours / count, their_seconds / theirs / count
        variances[n] = np.mean(rendering.standard_error**2) * ours, single.mean()
        means[n] = rendering.mean.mean(), image.mean()
        errors[n] = np.sqrt(variances[n] / count / (ours, theirs))
    # A forward peak's rare bright paths make single variances jump: the mean of all is taken for both.
    variance = variances.mean(axis=0)
    ratios = variance[1] * times[:, 1] / (variance[0] * times[:, 0])
    speeds = times[:, 1] / times[:, 0]
    mean, error = means.mean(axis=0), np.sqrt(np.sum(errors**2, axis=0)) / repeats
    try:
        note = require_agreement("radiance", mean[0], error[0], mean[1], error[1])
    except Disagreement as reason:
        yield _missing(row, what, _GOALS["forward"], reason)
        return
    yield Line(row, what, ratios, _GOALS["forward"], f"{case.name}; {note}")
    yield Line(row, "... of that, paths per CPU second", speeds, "", f"us a path: {_microseconds(times)}")
    jumps = variances[:, 1] / variance[0]
    yield Line(row, "... and variance of a path", jumps, "", "Mitsuba's over ours; its median understates it")


def _microseconds(times: np.ndarray) -> str:
    ours, theirs = np.median(times, axis=0) * 1e6
    return f"{ours:.2f} ours, {theirs:.1f} Mitsuba's"


def gradient(name: str, quick: bool) -> Iterator[Line]:
    """An image and the derivative of its mean with respect to all voxels that hold cloud."""
    row, what = f"gradient-{name}", "image and gradient: efficiency over prbvolpath"
    try:
        case, peer = _mitsuba(name)
    except (Missing, FileNotFoundError) as reason:
        yield _missing(row, what, _GOALS["gradient"], reason)
        return
    repeats, theirs, ours = (3, 8, 16) if quick else (7, 16, 64)
    mask = case.extinction > 0
    operator = ct.RadianceOperator(case.scene, (case.view,), mask=mask)
    adjoint = np.full((len(operator.pixels), 2), 0.5 / len(operator.pixels))
    table = TableGradient(operator)

    def replayed(seed: int) -> np.ndarray:
        rendering = operator.render(case.extinction, ours, seed, store_paths=True)
        return operator.gradient(rendering, adjoint).get()[mask]

    def by_adjoint(seed: int) -> np.ndarray:
        rendering = operator.render(case.extinction, ours, seed, store_paths=True)
        return table.gradient(rendering, adjoint)[0].get()[mask]

    def by_mitsuba(seed: int) -> np.ndarray:
        return peer.gradient(theirs, seed)[1][mask]

    programs = {"replay": replayed, "adjoint": by_adjoint, "Mitsuba": by_mitsuba}
    found: dict[str, list[np.ndarray]] = {program: [] for program in programs}
    seconds: dict[str, list[float]] = {program: [] for program in programs}
    for program in programs.values():  # kernels, and the radiance table
        program(1000)
    for n in range(repeats):
        for program, run in programs.items():
            values, time = timed(lambda run=run, n=n: run(n))
            found[program].append(values)
            seconds[program].append(time)
    variance = {program: np.var(values, axis=0, ddof=1).sum() for program, values in found.items()}
    # A sum that single bright paths do not rule, and that finite differences give as well: the derivative of
    # the mean radiance along the extinction itself.
    sums = {program: values @ case.extinction[mask] for program, values in found.items()}
    error = {program: float(np.std(values, ddof=1) / np.sqrt(repeats)) for program, values in sums.items()}
    mean = {program: float(np.mean(values)) for program, values in sums.items()}
    expected = _along_extinction(operator, case.extinction, 128 if quick else 512)
    share = {"replay": theirs / ours, "adjoint": theirs / ours}
    for program in ("replay", "adjoint"):
        times = np.divide(seconds["Mitsuba"], seconds[program])
        ratios = times * variance["Mitsuba"] / variance[program]
        label = f"{what}, {program}" + (" (the default; biased)" if program == "adjoint" else "")
        if program == "adjoint":
            note = f"{case.name}; along the extinction {mean['adjoint'] / expected[0]:.2f} of finite differences"
        else:
            differences = f"finite differences {expected[0]:.5g} +- {expected[1]:.2g}"
            try:
                note = require_agreement(
                    "along the extinction", mean["replay"], error["replay"], mean["Mitsuba"], error["Mitsuba"]
                )
                note = f"{case.name}; {note}; {differences}"
            except Disagreement as reason:
                yield _missing(row, label, _GOALS["gradient"], Disagreement(f"{reason}; {differences}"))
                continue
        yield Line(row, label, ratios, _GOALS["gradient"], note)
        yield Line(row, f"... of that, paths per CPU second, {program}", times / share[program])


def _along_extinction(operator: ct.RadianceOperator, extinction: np.ndarray, samples: int) -> tuple[float, float]:
    """The derivative of the mean radiance along the extinction, by central differences, and its standard error."""
    step, pixels = 0.1, len(operator.pixels)
    more, less = (
        operator.render((1 + sign * step) * extinction, samples, seed) for seed, sign in ((2000, 1), (2001, -1))
    )
    error = np.sqrt(sum(np.sum(rendering.standard_error**2) for rendering in (more, less))) / pixels
    return float(more.mean.mean() - less.mean.mean()) / (2 * step), float(error) / (2 * step)
