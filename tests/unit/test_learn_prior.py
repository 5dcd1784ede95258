"""The script that makes the patch prior's file."""

import importlib.util
import sys
from pathlib import Path

import numpy as np
import pytest
from threadpoolctl import threadpool_limits

import cloudtomo_cl as ct
from cloudtomo_cl.inversion.mixture import read_mixtures

SCRIPT = Path(__file__).parents[2] / "scripts/learn_prior.py"
SMALL = "--count 4 --patches 1500 --components 3 --rounds 2".split()


@pytest.fixture
def learn(monkeypatch):
    spec = importlib.util.spec_from_file_location("learn_prior", SCRIPT)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)

    def run(*arguments):
        monkeypatch.setattr(sys, "argv", [str(SCRIPT), *map(str, arguments)])
        return module.main()

    return run


def test_the_same_seed_gives_the_same_bits_whatever_threads(learn, tmp_path):
    for threads in (1, 2):
        with threadpool_limits(limits=threads, user_api="blas"):
            assert learn(*SMALL, "--aspects", 2, "--output", tmp_path / f"{threads}.npz") == 0
    first, second = ((tmp_path / f"{threads}.npz").read_bytes() for threads in (1, 2))
    assert first == second


def test_another_seed_gives_another_mixture(learn, tmp_path):
    for seed in (1, 2):
        learn(*SMALL, "--aspects", 2, "--seed", seed, "--output", tmp_path / f"{seed}.npz")
    means = [read_mixtures(tmp_path / f"{seed}.npz").mixtures[0].means for seed in (1, 2)]
    assert not np.array_equal(*means)


def test_given_clouds_are_learnt_from_for_the_shape_of_their_voxels(learn, tmp_path):
    for seed in (1, 2):
        grid = ct.Grid((16, 16, 12), (0.02, 0.02, 0.03))
        ct.write_extinction(tmp_path / f"cloud-{seed}.nc", grid, ct.cumulus(grid, seed))
    clouds = [tmp_path / f"cloud-{seed}.nc" for seed in (1, 2)]
    assert learn(*clouds, *SMALL, "--output", tmp_path / "prior.npz") == 0
    found = read_mixtures(tmp_path / "prior.npz")
    assert found.aspects == pytest.approx((1.5,)) and len(found.mixtures[0]) == 1 + 3
    ct.PatchPrior(file=tmp_path / "prior.npz")


def test_clouds_of_different_voxels_are_refused(learn, tmp_path, capsys):
    for height in (0.02, 0.04):
        grid = ct.Grid((12, 12, 12), (0.02, 0.02, height))
        ct.write_extinction(tmp_path / f"{height}.nc", grid, ct.cumulus(grid, 1))
    clouds = [tmp_path / f"{height}.nc" for height in (0.02, 0.04)]
    assert learn(*clouds, *SMALL, "--output", tmp_path / "prior.npz") == 2
    assert "different heights over widths" in capsys.readouterr().err
    assert not (tmp_path / "prior.npz").exists()
