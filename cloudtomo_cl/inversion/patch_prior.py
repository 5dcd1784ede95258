"""The prior on what clouds look like in the small: every patch comes from a mixture of Gaussians."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from cloudtomo_cl.inversion.bound_prior import NoiseUnits
from cloudtomo_cl.inversion.mixture import AT_ONCE, Mixture
from cloudtomo_cl.inversion.patches import Patches

# Noise of a stage's first step, and how it falls from step to step.
_FIRST_NOISE, _NOISE_SHARE = 0.2, 0.7
# Share of the prior's pull on a cloud's mass that a step takes back where nobody finds it (`mass`), and the extinction,
# in units of s, at which a voxel takes half of its part in that (docs/decisions/patch-prior.md).
_RETURNED, _HALF_PRESENT = 0.3, 0.1
# Of a cloud of so many voxels a step's patches with cloud count half: those that were learnt from are of more.
_FEW_VOXELS = 200.0


class BoundPatches:
    """Minus the log likelihood of the patches of u = b / s, averaged over the patches that hold a voxel, s given.

    R(u) = strength / values sum_i min_k [ 1/2 (P_i u - m_k)^T S_k (P_i u - m_k) - 1/2 log det S_k - log w_k ]
    with S_k = (C_k + noise^2)^-1, less what a patch without cloud has, so that a clear sky costs nothing. Source: the
    expected patch log likelihood (Zoran and Weiss 2011), each patch with its likeliest component, and their
    half-quadratic splitting's auxiliary patches eliminated: min_z (x - z)^2 / (2 noise^2) + 1/2 (z - m)^T C^-1 (z - m)
    is the form above.

    Parameters
    ----------
    patches : of the voxels
    mixture : of patches of this size
    strength : weight
    noise : standard deviation that patches are known to, in units of s
    """

    def __init__(self, patches: Patches, mixture: Mixture, strength: float, noise: float) -> None:
        self._patches, self._mixture = patches, mixture
        self._weight, self._noise = strength / patches.values, noise

    def value_and_gradient(self, extinction: np.ndarray, units: NoiseUnits) -> tuple[float, np.ndarray]:
        step = FrozenPatches(self._patches, self._mixture, self._weight, self._noise, extinction)
        return step.value_and_gradient(extinction, units)

    def frozen(self, extinction: np.ndarray, iteration: int) -> FrozenPatches:
        """With the components that are the likeliest at this extinction, and the noise of this iteration.

        Patches of a cloud of few voxels, as on the grids of the first stages, are rougher than those of most clouds
        that were learnt from: they count less. Patches without cloud are alike everywhere.

        The most likely cloud is thinner than likely ones: as many Gaussians as there are patches all pull towards
        their means. A step takes a share of that pull on the cloud's mass back, by a constant slope where there is
        cloud.
        """
        noise = max(_FIRST_NOISE * _NOISE_SHARE**iteration, self._noise)
        count = voxels_of_cloud(extinction)
        share = count / (count + _FEW_VOXELS) if count else 1.0
        step = FrozenPatches(self._patches, self._mixture, self._weight, noise, extinction, share)
        step.give_back(extinction, _RETURNED)
        return step


def voxels_of_cloud(extinction: np.ndarray) -> float:
    """(sum b)^2 / sum b^2: how many voxels a cloud has, if they all were alike; 0 of none."""
    squares = float(np.sum(np.square(extinction)))
    return float(np.sum(extinction)) ** 2 / squares if squares > 0 else 0.0


class FrozenPatches:
    """`BoundPatches` with the components that patches have at one extinction: a quadratic function.

    Parameters
    ----------
    patches, mixture : as of `BoundPatches`
    weight : strength over a patch's values
    noise : standard deviation in units of s
    extinction : where components are chosen, in units of s, shape (voxels,)
    share : by which patches with cloud count
    """

    def __init__(
        self,
        patches: Patches,
        mixture: Mixture,
        weight: float,
        noise: float,
        extinction: np.ndarray,
        share: float = 1.0,
    ) -> None:
        self._patches, self._weight = patches, share * weight
        padded = patches.padded(extinction)
        cloudy = _cloudy(patches, padded)
        components = np.zeros(len(patches), np.int32)
        for part in _parts(cloudy):
            components[part] = mixture.likeliest(patches.gather(padded, part), noise)
        # Patches in the order of their components; those without cloud, of the first one, apart.
        order = np.argsort(components, kind="stable")
        counts = np.bincount(components, minlength=len(mixture))
        clear, self._cloudy = order[: counts[0]], order[counts[0] :]
        self._components = components[self._cloudy]
        self._means = mixture.means.astype(np.float32)
        precisions = mixture.precisions(noise)
        self._precisions = precisions.astype(np.float32)
        constants = mixture.constants(noise)
        self._constant = float(counts @ (constants - constants[0]))
        # Patches without cloud have the mean 0 and independent values: what they add is diagonal.
        sums = patches.zeros()
        patches.add(sums, clear, np.ones((1, 1)))
        self._clear = patches.on_voxels(sums) * (precisions[0, 0, 0] / share)
        sums, diagonals = patches.zeros(), np.diagonal(precisions, axis1=1, axis2=2)
        for part, slices in self._parts_by_component():
            patches.add(sums, part, np.concatenate([np.tile(diagonals[k], (s.stop - s.start, 1)) for k, s in slices]))
        self._diagonal = self._clear + patches.on_voxels(sums)
        self._slope, self._slope_start = np.zeros(len(extinction)), extinction

    def give_back(self, extinction: np.ndarray, share: float) -> None:
        """Adds a slope where there is cloud, so that this share of the slope along the extinction itself is gone."""
        presence = extinction / (extinction + _HALF_PRESENT)
        along = float(presence @ extinction)
        if along > 0:
            pull = float(self._quadratic(extinction)[1] @ extinction)
            self._slope, self._slope_start = -share * pull / along * presence, extinction

    def value_and_gradient(self, extinction: np.ndarray, units: NoiseUnits) -> tuple[float, np.ndarray]:
        value, gradient = self._quadratic(extinction)
        value += float(self._slope @ (extinction - self._slope_start))
        factor = units.weighted * self._weight
        return factor * value, factor * (gradient + self._slope)

    def _quadratic(self, extinction: np.ndarray) -> tuple[float, np.ndarray]:
        padded, sums = self._patches.padded(extinction), self._patches.zeros()
        value = self._constant + 0.5 * float(self._clear @ np.square(extinction))
        for part, slices in self._parts_by_component():
            away = self._patches.gather(padded, part)
            slope = np.empty_like(away)
            for component, own in slices:
                away[own] -= self._means[component]
                slope[own] = away[own] @ self._precisions[component]
            value += 0.5 * float(np.sum(away * slope, dtype=np.float64))
            self._patches.add(sums, part, slope)
        return value, self._clear * extinction + self._patches.on_voxels(sums)

    def curvature(self, extinction: np.ndarray, units: NoiseUnits) -> np.ndarray:
        return units.weighted * self._weight * self._diagonal

    def stiffness(self, columns: np.ndarray, units: NoiseUnits) -> np.ndarray:
        return np.column_stack([self._times(column) for column in columns.T]) * (units.weighted * self._weight)

    def perturbation(self, random: np.random.Generator, units: NoiseUnits) -> np.ndarray:
        sums = self._patches.zeros()
        for part, slices in self._parts_by_component():
            draws = random.standard_normal((len(part), self._patches.values))
            for component, own in slices:
                draws[own] = draws[own] @ np.linalg.cholesky(self._precisions[component].astype(float)).T
            self._patches.add(sums, part, draws)
        of_clear = np.sqrt(self._clear) * random.standard_normal(len(self._clear))
        return np.sqrt(units.weighted * self._weight * units.both) * (of_clear + self._patches.on_voxels(sums))

    def _times(self, change: np.ndarray) -> np.ndarray:
        padded, sums = self._patches.padded(change), self._patches.zeros()
        for part, slices in self._parts_by_component():
            values = self._patches.gather(padded, part)
            for component, own in slices:
                values[own] = values[own] @ self._precisions[component]
            self._patches.add(sums, part, values)
        return self._clear * change + self._patches.on_voxels(sums)

    def _parts_by_component(self) -> Iterator[tuple[np.ndarray, list[tuple[int, slice]]]]:
        """So many patches as are worked on at a time, and which of them each component has."""
        for first in range(0, len(self._cloudy), AT_ONCE):
            components = self._components[first : first + AT_ONCE]
            numbers = np.unique(components)
            starts, stops = (np.searchsorted(components, numbers, side) for side in ("left", "right"))
            slices = [(int(k), slice(int(a), int(b))) for k, a, b in zip(numbers, starts, stops)]
            yield self._cloudy[first : first + AT_ONCE], slices


def _cloudy(patches: Patches, padded: np.ndarray) -> np.ndarray:
    """The patches with cloud in them."""
    filled = [patches.gather(padded, part).any(axis=1) for part in _parts(np.arange(len(patches)))]
    return np.flatnonzero(np.concatenate(filled))


def _parts(chosen: np.ndarray) -> Iterator[np.ndarray]:
    for first in range(0, len(chosen), AT_ONCE):
        yield chosen[first : first + AT_ONCE]
