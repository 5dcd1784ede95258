"""Renderings to a wanted noise: paths go where the noise is."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from cloudtomo_cl.arguments import CALLABLE, NUMBER, a, require_kinds
from cloudtomo_cl.errors import DataError
from cloudtomo_cl.transport.audit import Audit, combined
from cloudtomo_cl.transport.radiance import RadianceOperator
from cloudtomo_cl.transport.rendering import Rendering, pooled

# Paths per pixel of the pilot, which tells the noise and is then left out: images that share their
# paths with the choice of how many there are would be biased (Kirk and Arvo 1991). At first the least; then, if many
# paths will be needed, this share of them, at most the largest number.
_PILOT_LEAST, _PILOT_SHARE, _PILOT_MOST = 16, 0.05, 128
# All pixels' pilots together have at least so many: a few rays need longer ones.
_PILOT_PATHS = 2048
_LEAST_SAMPLES = 8
# Its noise is smoothed over so many pixels each way: less follows the pilot's own noise, more blurs the clouds' edges.
_WINDOW = 7
# A pixel's noise is taken for no smaller than this share of its view's: pilots miss rare bright paths.
_LEAST_NOISE = 0.05
# Numbers of paths are multiples of _LEAST_SAMPLES by powers of this: pixels alike go together.
_LEVEL = 2.0
_MARGIN = 1.05


def relative_error(operator: RadianceOperator, rendering: Rendering) -> np.ndarray:
    """Each view's noise: the root mean square of its pixels' standard errors over their mean radiance.

    Returns an array (views,); 0 for a view that is dark or has no pixels.
    """
    view, views = operator.pixels[:, 0], len(operator.views)
    counts = np.maximum(np.bincount(view, minlength=views), 1)
    variance = np.bincount(view, rendering.standard_error**2, views) / counts
    mean = np.bincount(view, rendering.mean, views) / counts
    return np.sqrt(variance) / np.where(mean > 0, mean, np.inf)


def render_to_error(
    operator: RadianceOperator,
    extinction: Any,
    target_error: float,
    seed: int = 0,
    most_paths: float = 1e10,
    progress: Callable[[float], None] | None = None,
) -> Rendering:
    """Renders until every view's `relative_error` is at most a target, with as few paths as that takes.

    A pilot tells each pixel's noise; then pixels get paths in proportion to it, which is what
    lowers the noise of the whole most (Neyman 1934). The pilot's own paths are left out. What
    paths cost is left aside: nearly all go into cloud, where one takes several times as long as
    the average of an image with much clear air. A view in which the pilot sees nothing counts as
    reached.

    Parameters
    ----------
    operator : what to render
    extinction : as in `RadianceOperator.render`
    target_error : for instance 0.01 for 1 %
    seed : of the random numbers
    most_paths : after which it ends as it is
    progress : called with the share that is done, 0 to 1

    Returns
    -------
    rendering : its `samples` is an array, paths of each pixel; `audit.launched` counts all paths

    Raises
    ------
    DataError : target_error is not above 0; the rest as `RadianceOperator.render`
    """
    require_kinds(
        "render_to_error",
        operator=(operator, a(RadianceOperator)),
        target_error=(target_error, NUMBER),
        most_paths=(most_paths, NUMBER),
        progress=(progress, CALLABLE.or_none()),
    )
    if not target_error > 0:
        raise DataError(f"target_error is {target_error}: it must be above 0, for instance 0.01 for 1 %")
    extinction = operator.ranks.together(lambda: operator.on_device(extinction))
    pilot, audits = _pilot(operator, extinction, target_error / _MARGIN, seed, most_paths)
    wanted = _samples(operator, pilot, target_error / _MARGIN)
    levels = np.ceil(np.log(np.maximum(wanted / _LEAST_SAMPLES, 1.0)) / np.log(_LEVEL) - 1e-9).astype(int)
    groups = [(level, np.flatnonzero(levels == level)) for level in np.unique(levels)]
    parts = operator.ranks.together(lambda: [operator.of_pixels(operator.pixels[chosen]) for _, chosen in groups])
    done: list[Rendering | None] = [None] * len(groups)
    budget, factor = most_paths - sum(audit.launched for audit in audits), 1.0
    while True:
        planned = [2 * round(_LEAST_SAMPLES * _LEVEL**level * factor / 2) for level, _ in groups]
        paths = sum(count * len(chosen) for count, (_, chosen) in zip(planned, groups))
        planned = [max(2, 2 * int(count * min(1.0, budget / paths) / 2)) for count in planned]
        total, finished = sum(count * len(chosen) for count, (_, chosen) in zip(planned, groups)), 0
        for index, (part, count) in enumerate(zip(parts, planned)):
            before = done[index]
            first = pilot.samples + (0 if before is None else before.samples)
            more = part.render(extinction, count, seed, first_sample=first)
            audits.append(more.audit)
            done[index] = more if before is None else pooled(before, more)
            finished += count * len(part.pixels)
            if progress is not None:
                operator.ranks.together(partial(progress, finished / total))
        budget -= total
        rendering = _assembled(
            [(chosen, part) for (_, chosen), part in zip(groups, done) if part is not None], audits, operator
        )
        missing = float((relative_error(operator, rendering) / target_error).max())
        if missing <= 1 or budget < len(operator.pixels) * 2:
            return rendering
        # All pixels get more by one factor: what they have is independent of how much more that is.
        so_far = rendering.samples.sum() / sum(_LEAST_SAMPLES * _LEVEL**level * len(chosen) for level, chosen in groups)
        factor = so_far * max(min(_MARGIN * missing**2, 4.0) - 1.0, 0.05)


def _pilot(
    operator: RadianceOperator, extinction: Any, target: float, seed: int, most_paths: float
) -> tuple[Rendering, list[Audit]]:
    """The first paths of every pixel, and what became of them."""
    most = most_paths / len(operator.pixels)
    least = max(_PILOT_LEAST, 2 * int(min(_PILOT_PATHS / len(operator.pixels), most / 2) / 2))
    pilot = operator.render(extinction, least, seed)
    # How many paths a pixel will get, in the mean.
    planned = min(_samples(operator, pilot, target).mean(), most)
    more = 2 * int(min(_PILOT_SHARE * planned, _PILOT_MOST) / 2) - least
    if more <= 0:
        return pilot, [pilot.audit]
    second = operator.render(extinction, more, seed, first_sample=least)
    return pooled(pilot, second), [pilot.audit, second.audit]


def _noise(operator: RadianceOperator, pilot: Rendering) -> np.ndarray:
    """Standard deviation of a path by pixel, smoothed over _WINDOW x _WINDOW pixels, shape (pixels,)."""
    from scipy.ndimage import uniform_filter

    variance = pilot.standard_error**2 * pilot.samples
    smooth = np.empty_like(variance)
    for index, image in enumerate(operator.images(variance)):
        chosen = operator.pixels[:, 0] == index
        if not chosen.any():
            continue
        known = np.isfinite(image)
        weight = uniform_filter(known.astype(float), _WINDOW, mode="constant")
        mean = uniform_filter(np.where(known, image, 0.0), _WINDOW, mode="constant") / np.where(known, weight, 1.0)
        least = _LEAST_NOISE**2 * variance[chosen].mean()
        smooth[chosen] = np.maximum(mean.ravel()[operator.pixels[chosen, 1]], least)
    return np.sqrt(smooth)


def _samples(operator: RadianceOperator, pilot: Rendering, target: float) -> np.ndarray:
    """Paths by pixel, in proportion to the noise, that bring each view to the target."""
    noise = _noise(operator, pilot)
    samples = np.zeros(len(noise))
    for index in range(len(operator.views)):
        chosen = operator.pixels[:, 0] == index
        if not chosen.any() or not noise[chosen].any() or not pilot.mean[chosen].mean() > 0:
            continue
        # With n = k noise the mean of noise^2 / n is mean(noise) / k, to be (target x mean radiance)^2.
        factor = noise[chosen].mean() / (target * pilot.mean[chosen].mean()) ** 2
        samples[chosen] = factor * noise[chosen]
    return samples


def _assembled(parts: list[tuple[np.ndarray, Rendering]], audits: list, operator: RadianceOperator) -> Rendering:
    """One rendering of all pixels out of those of the groups."""
    order = np.argsort(np.concatenate([chosen for chosen, _ in parts]))

    def values(name: str) -> np.ndarray:
        return np.concatenate([getattr(part, name) for _, part in parts])[order]

    samples = np.concatenate([np.full(len(chosen), part.samples) for chosen, part in parts])[order]
    return replace(
        parts[0][1],
        mean=values("mean"),
        standard_error=values("standard_error"),
        halves=values("halves"),
        samples=samples,
        audit=combined(audits),
        _operator=operator,
    )
