"""Renderings to a wanted noise: paths go where the noise is."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from cloudtomo_cl.audit import combined
from cloudtomo_cl.errors import DataError
from cloudtomo_cl.transport import RadianceOperator, Rendering, pooled

# Paths per pixel of an image's pilot. At first the least; then, if many paths will be needed, this share of them, at
# most the largest number.
_PILOT_LEAST, _PILOT_SHARE, _PILOT_MOST = 8, 0.025, 64
# All pixels together have at least so many: a few rays need longer pilots.
_PILOT_PATHS = 1024
# Paths of the second image have numbers from here on.
_SECOND_IMAGE = 1 << 31
_LEAST_SAMPLES = 2
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
    most_photons: float = 1e10,
    progress: Callable[[float], None] | None = None,
) -> Rendering:
    """Renders until every view's `relative_error` is at most a target, with as few paths as that takes.

    Pilots tell each pixel's noise; then pixels get paths in proportion to it, which is what lowers the
    noise of the whole most (Neyman 1934). An image whose number of paths follows from these paths
    themselves would be biased (Kirk and Arvo 1991). So there are two images and their mean: each has the
    paths that the other's pilot asks for, and its own pilot. What paths cost is left aside: nearly all
    go into cloud, where one takes several times as long as the average of an image with much clear air.

    Parameters
    ----------
    operator : what to render
    extinction : as in `RadianceOperator.render`
    target_error : for instance 0.01 for 1 %
    seed : of the random numbers
    most_photons : after which it ends as it is
    progress : called with the share that is done, 0 to 1

    Returns
    -------
    rendering : its `samples` is an array, paths of each pixel; `audit.launched` counts all photons

    Raises
    ------
    DataError : target_error is not above 0; the rest as `RadianceOperator.render`
    """
    if not target_error > 0:
        raise DataError(f"target_error is {target_error}: it must be above 0, for instance 0.01 for 1 %")
    extinction = operator.field(extinction)
    pilots = _pilots(operator, extinction, target_error / _MARGIN, seed, most_photons)
    plans = [_samples(operator, pilot, target_error / _MARGIN) / 2 for pilot in pilots]
    first = pilots[0].samples + pilots[1].samples
    images = [
        _Image(operator, extinction, pilots[0], plans[1], first),
        _Image(operator, extinction, pilots[1], plans[0], _SECOND_IMAGE),
    ]
    budget, factor = most_photons - first * len(operator.pixels), 1.0
    while True:
        photons = sum(image.photons(factor) for image in images)
        if photons > budget:
            factor *= budget / photons
            photons = sum(image.photons(factor) for image in images)
        finished = 0
        for image in images:
            for done in image.extend(factor):
                finished += done
                if progress:
                    progress(finished / photons)
        budget -= photons
        rendering = _mean(images[0].rendering, images[1].rendering)
        missing = float((relative_error(operator, rendering) / target_error).max())
        if missing <= 1 or budget < len(operator.pixels) * 4:
            return rendering
        # All pixels get more by one factor: what they have is independent of how much more that is.
        so_far = rendering.audit.launched / photons * factor
        factor = so_far * max(min(_MARGIN * missing**2, 4.0) - 1.0, 0.05)


class _Image:
    """An image whose pilot counts, with more paths where another's pilot saw noise.

    Parameters
    ----------
    operator, extinction : what to render
    pilot : of this image
    wanted : paths of each pixel, with the pilot's, shape (pixels,)
    first : number of the first path after the pilot's
    """

    def __init__(
        self, operator: RadianceOperator, extinction: Any, pilot: Rendering, wanted: np.ndarray, first: int
    ) -> None:
        more = np.maximum((wanted - pilot.samples) / _LEAST_SAMPLES, 1.0)
        levels = np.ceil(np.log(more) / np.log(_LEVEL) - 1e-9).astype(int)
        self._extinction = extinction
        used = np.unique(levels)
        self._planned = [_LEAST_SAMPLES * _LEVEL**level for level in used]
        self._chosen = [np.flatnonzero(levels == level) for level in used]
        self._parts = [operator.of_pixels(operator.pixels[chosen]) for chosen in self._chosen]
        self._first = [first] * len(used)
        self.rendering = pilot

    def _counts(self, factor: float) -> list[int]:
        return [max(2, 2 * round(count * factor / 2)) for count in self._planned]

    def photons(self, factor: float) -> int:
        """Of `extend`."""
        return sum(count * len(part.pixels) for count, part in zip(self._counts(factor), self._parts))

    def extend(self, factor: float) -> Iterator[int]:
        """Adds as many paths as were wanted, times a factor; yields the photons of one launch after the other."""
        found, seed = [], self.rendering.seed
        for index, (part, count) in enumerate(zip(self._parts, self._counts(factor))):
            found.append(part.render(self._extinction, count, seed, first_sample=self._first[index]))
            self._first[index] += count
            yield count * len(part.pixels)
        self.rendering = pooled(self.rendering, _assembled(self._chosen, found))


def _pilots(
    operator: RadianceOperator, extinction: Any, target: float, seed: int, most_photons: float
) -> list[Rendering]:
    """The first paths of every pixel, of both images."""
    count, most = len(operator.pixels), most_photons / len(operator.pixels)
    least = max(_PILOT_LEAST, 2 * int(min(_PILOT_PATHS / count, most / 4) / 2))
    begun = [operator.render(extinction, least, seed, first_sample=n * least) for n in range(2)]
    # How many paths a pixel will get, in the mean; how many more paths a pilot has must not depend on its own.
    planned = [min(_samples(operator, pilot, target).mean(), most) for pilot in begun]
    pilots, first = [], 2 * least
    for pilot, wanted in zip(begun, reversed(planned)):
        more = 2 * int(min(_PILOT_SHARE * wanted, _PILOT_MOST) / 2) - least
        if more > 0:
            pilot = pooled(pilot, operator.render(extinction, more, seed, first_sample=first))
            first += more
        pilots.append(pilot)
    return pilots


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


def _assembled(chosen: list[np.ndarray], parts: list[Rendering]) -> Rendering:
    """One rendering of all pixels out of those of groups."""
    order = np.argsort(np.concatenate(chosen))

    def values(name: str) -> np.ndarray:
        return np.concatenate([getattr(part, name) for part in parts])[order]

    return replace(
        parts[0],
        mean=values("mean"),
        standard_error=values("standard_error"),
        halves=values("halves"),
        samples=np.concatenate([np.full(len(part.mean), part.samples) for part in parts])[order],
        audit=combined([part.audit for part in parts]),
    )


def _mean(first: Rendering, second: Rendering) -> Rendering:
    """Of two independent renderings, each of the same weight: weights by paths would follow the pilots."""
    return replace(
        first,
        mean=(first.mean + second.mean) / 2,
        standard_error=np.hypot(first.standard_error, second.standard_error) / 2,
        halves=(first.halves + second.halves) / 2,
        samples=first.samples + second.samples,
        audit=combined([first.audit, second.audit]),
    )
