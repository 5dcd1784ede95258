"""The generated cumuli have the properties that they are made for."""

import numpy as np
import pytest

from cloudtomo_cl.clouds.generate import PRESETS, Turbulence, cumulus, stratocumulus
from cloudtomo_cl.errors import DataError
from cloudtomo_cl.scene.grid import Grid, resample

GRID = Grid(shape=(38, 38, 38), spacing=(0.02, 0.02, 0.04))
SEEDS = range(4)


@pytest.mark.parametrize("seed", SEEDS)
def test_cover_and_optical_depth_are_those_of_a_trade_cumulus(seed):
    extinction = cumulus(GRID, seed)
    depth = extinction.sum(axis=2) * GRID.spacing[2]
    assert 0.2 < (depth > 0).mean() < 0.5
    assert 0.03 < (extinction > 0).mean() < 0.1
    assert 15 < depth.max() < 45


def test_the_peak_is_the_one_asked_for():
    extinction = cumulus(GRID, peak=37.5)
    assert extinction.dtype == np.float32
    assert extinction.max() == pytest.approx(37.5)
    assert extinction.min() == 0


def test_the_base_is_flat_and_the_top_near_the_one_asked_for():
    extinction = cumulus(GRID, base=0.5, top=1.1)
    cloudy = GRID.centres(2)[extinction.any(axis=(0, 1))]
    assert 0.5 < cloudy.min() <= 0.5 + GRID.spacing[2]
    assert 0.95 < cloudy.max() < 1.25


@pytest.mark.parametrize("seed", SEEDS)
def test_extinction_grows_with_height(seed):
    extinction = cumulus(GRID, seed)
    levels = np.flatnonzero(extinction.any(axis=(0, 1)))
    largest = extinction.max(axis=(0, 1))[levels[: 2 * len(levels) // 3]]
    assert np.corrcoef(np.arange(len(largest)), largest)[0, 1] > 0.8


@pytest.mark.parametrize("seed", SEEDS)
def test_extinction_falls_towards_the_edges(seed):
    extinction = cumulus(GRID, seed)
    cloudy = extinction > 0
    core = cloudy.copy()
    for axis in range(3):
        core &= np.roll(cloudy, 1, axis) & np.roll(cloudy, -1, axis)
    assert extinction[core].mean() > 1.5 * extinction[cloudy & ~core].mean()


@pytest.mark.parametrize("clouds", [1, 6])
def test_sides_and_top_of_the_domain_stay_free(clouds):
    for seed in SEEDS:
        extinction = cumulus(GRID, seed, clouds=clouds)
        assert not extinction[:2].any() and not extinction[-2:].any()
        assert not extinction[:, :2].any() and not extinction[:, -2:].any()
        assert not extinction[:, :, -2:].any()


def test_a_seed_is_one_cloud_at_every_resolution():
    fine = resample(cumulus(GRID.with_shape((64, 64, 64))), (32, 32, 32))
    coarse = cumulus(GRID.with_shape((32, 32, 32)))
    assert np.abs(coarse - fine).sum() / fine.sum() < 0.25


def test_a_seed_is_reproduced_exactly():
    np.testing.assert_array_equal(cumulus(GRID, 3), cumulus(GRID, 3))


def test_other_seeds_are_other_clouds():
    first, second = cumulus(GRID, 3), cumulus(GRID, 4)
    assert np.abs(first - second).sum() / first.sum() > 0.5


def test_a_domain_elsewhere_holds_the_same_kind_of_cloud():
    grid = Grid(shape=(30, 30, 30), spacing=(0.02, 0.02, 0.04), origin=(5.0, -3.0, 0.4))
    extinction = cumulus(grid)
    assert 0.03 < (extinction > 0).mean() < 0.1


def test_several_clouds_stand_apart():
    from scipy import ndimage

    grid = Grid(shape=(86, 86, 27), spacing=(0.02, 0.02, 0.04))
    parts, count = ndimage.label(cumulus(grid, 1, clouds=4) > 0)
    assert (np.bincount(parts.ravel())[1:] > 100).sum() >= 2


def test_turbulence_has_unit_variance_and_the_slope_of_the_inertial_range():
    points = np.arange(1024) * 0.01
    spectra, variances = [], []
    for seed in range(20):
        values = Turbulence(np.random.default_rng(seed), 1.0)(points, np.arange(4.0), np.arange(4.0))
        variances.append(values.var())
        spectra.append((np.abs(np.fft.rfft(values * np.hanning(1024)[:, None, None], axis=0)) ** 2).mean(axis=(1, 2)))
    assert np.mean(variances) == pytest.approx(1.0, rel=0.1)
    spectrum, wavenumber = np.mean(spectra, axis=0), np.fft.rfftfreq(1024, 0.01)
    inside = (wavenumber > 1.0) & (wavenumber < 4.0)
    slope = np.polyfit(np.log(wavenumber[inside]), np.log(spectrum[inside]), 1)[0]
    assert slope == pytest.approx(-5 / 3, abs=0.45)


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"clouds": 0}, "clouds is 0"),
        ({"peak": -1.0}, "peak is -1"),
        ({"peak": np.nan}, "peak is nan"),
        ({"base": 1.0, "top": 0.5}, "base is 1 km and top 0.5 km"),
        ({"top": 9.0}, "inside of the domain"),
    ],
)
def test_unfit_options_are_named(options, text):
    with pytest.raises(DataError, match=text):
        cumulus(GRID, **options)


def test_a_deck_has_the_optical_depth_asked_for_on_any_layers():
    coarse, fine = (
        stratocumulus(Grid((32, 32, count), (0.1, 0.1, 0.6 / count), (0, 0, 0.4)), seed=1, optical_depth=9.0)
        for count in (6, 60)
    )
    depths = [cloud.sum(axis=2, dtype=float) * 0.6 / cloud.shape[2] for cloud in (coarse, fine)]
    assert np.allclose(*depths, rtol=1e-4)
    # Exact in the mean over seeds; one domain of a few of the longest waves is off by its noise.
    assert depths[0].mean() == pytest.approx(9.0, rel=0.25)


def test_a_deck_is_periodic():
    depth = stratocumulus(Grid((64, 64, 4), (0.05, 0.05, 0.1)), seed=2).sum(axis=2)
    inside = np.abs(np.diff(depth, axis=0)).mean()
    assert np.abs(depth[0] - depth[-1]).mean() < 2 * inside


def test_columns_of_a_deck_grow_with_height_to_a_flat_top():
    extinction = stratocumulus(Grid((16, 16, 20), (0.1, 0.1, 0.02)), seed=3, top=0.3)
    assert (extinction[:, :, 14] > 0).all() and not extinction[:, :, 15:].any()
    assert (np.diff(extinction[:, :, :15], axis=2) >= 0).all()


@pytest.mark.parametrize("name", PRESETS)
def test_presets_make_clouds(name):
    preset = PRESETS[name]
    grid = preset.grid.with_shape([count // 2 for count in preset.grid.shape])
    depth = preset.generate(grid, 1).sum(axis=2) * grid.spacing[2]
    assert 5 < depth.max() < 150
