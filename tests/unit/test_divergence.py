"""What a recovery that runs away is told to change."""

from types import SimpleNamespace

import numpy as np
import pytest

import cloudtomo_cl as ct
from cloudtomo_cl.errors import TransportError
from cloudtomo_cl.inversion.run import guard_divergence
from cloudtomo_cl.inversion.solvers.protocol import Progress

ADVICE = [
    (ct.GaussNewton(), "a larger damping"),
    (ct.Adam(), "a smaller step_size"),
    (ct.SGD(), "a smaller step_size"),
    (object(), "shorter steps"),
]


@pytest.mark.parametrize(("solver", "advice"), ADVICE)
def test_a_solver_that_diverges_is_advised_what_it_has(solver, advice):
    grid = ct.Grid(shape=(2, 1, 1), spacing=(0.1, 0.1, 0.1))
    problem = SimpleNamespace(grid=grid, mask=np.ones(grid.shape, bool))
    run, state = SimpleNamespace(stage=0, iteration=3), SimpleNamespace(extinction=np.array([1.0, 1e6]))
    with pytest.raises(TransportError, match=rf"diverged in stage 0, iteration 3: voxel \(1, 0, 0\).* {advice}"):
        guard_divergence(run, problem, state, Progress(1.0, 0.1, 0.0, 10), solver=solver)
