"""The energy audit, and truncation."""

from dataclasses import replace

import numpy as np
import pytest
from scenes import ABOVE, CAMERA, SCENES, extinction_of

from cloudtomo_cl.errors import AuditError, TransportError
from cloudtomo_cl.transport.audit import Audit, combined
from cloudtomo_cl.transport.jacobian_average import JacobianAverage
from cloudtomo_cl.transport.radiance import RadianceOperator
from cloudtomo_cl.transport.table_gradient import TableGradient

SOUND = Audit(
    launched=1000, top=0.5, bottom=0.1, sides=0.1, missed=0.0, absorbed=0.2, surface=0.1, killed=0.0,
    killed_standard_error=0.001, lost=0.0,
)  # fmt: skip


@pytest.mark.parametrize("scene", SCENES.values(), ids=SCENES)
def test_every_rendering_balances(device, scene):
    operator = RadianceOperator(scene, [ABOVE, CAMERA], device)
    audit = operator.render(extinction_of(scene), 100).audit
    assert audit.launched == 100 * len(operator.pixels)
    assert abs(audit.balance) < 1e-5


def test_a_sound_audit_passes():
    SOUND.check(1000)


@pytest.mark.parametrize(
    "change, message",
    [
        ({"launched": 999}, "999 of 1000 paths"),
        ({"top": 0.6}, "add up to 1.1"),
        ({"top": float("nan")}, "add up to nan"),
        ({"top": 0.4, "killed": 0.1}, "roulettes and branches took 0.1"),
        ({"top": 0.49, "lost": 0.01}, "tilt the views"),
    ],
)
def test_what_does_not_add_up_is_an_error(change, message):
    with pytest.raises(AuditError, match=message):
        replace(SOUND, **change).check(1000)


def test_few_paths_may_end_otherwise_than_their_own_spread_tells():
    """What branches take is rare and large: of six paths hardly any shows how much it may be."""
    few = replace(SOUND, launched=6, top=-0.226, killed=0.726, killed_standard_error=0.1)
    few.check(6)
    with pytest.raises(AuditError, match="roulettes and branches took 0.726"):
        replace(few, launched=600).check(600)


def test_audits_combine_by_their_paths():
    both = combined([SOUND, replace(SOUND, launched=3000, top=0.7, absorbed=0.0)])
    assert both.launched == 4000
    assert both.top == pytest.approx(0.65) and both.absorbed == pytest.approx(0.05)


def test_a_kernel_that_loses_weight_is_caught(device, monkeypatch):
    """The host takes the kernels' unit of weight for another: as if every path lost a thousandth."""
    monkeypatch.setattr("cloudtomo_cl.transport.audit.WEIGHT_UNIT", 2.0**24 * 1.001)
    scene = SCENES["forward peak"]
    with pytest.raises(AuditError, match="add up|paths came to an end"):
        RadianceOperator(scene, [ABOVE], device).render(extinction_of(scene), 100)


@pytest.mark.parametrize("walk", ["replay", "table", "jacobian"])
def test_paths_that_bring_something_else_when_walked_again_are_caught(device, walk):
    """As on a device that ends loops before their time: here the kept radiances are others."""
    scene = SCENES["forward peak"]
    operator = RadianceOperator(scene, [ABOVE], device, mask=np.ones(scene.grid.shape, bool))
    rendering = operator.render(extinction_of(scene), 100, store_paths=True)
    walks = {
        "replay": lambda: operator.gradient(rendering, np.ones((9, 2))),
        "table": lambda: TableGradient(operator).gradient(rendering, np.ones((9, 2))),
        "jacobian": lambda: JacobianAverage(operator).add(rendering, 1.0),
    }
    walks[walk]()
    for _, paths in rendering._launches:
        paths *= np.float32(1.01)
    with pytest.raises(AuditError, match="paths brought another radiance"):
        walks[walk]()


def test_a_gradient_that_overflows_is_an_error(device, monkeypatch):
    monkeypatch.setattr("cloudtomo_cl.transport.gradient.FIXED_POINT_SCALE", 2.0**68)
    scene = SCENES["forward peak"]
    operator = RadianceOperator(scene, [ABOVE], device)
    rendering = operator.render(extinction_of(scene), 100, store_paths=True)
    with pytest.raises(TransportError, match=r"the gradient .* at voxel \(\d, \d, \d\)"):
        operator.gradient(rendering, np.ones((9, 2)))


def test_truncation_removes_and_says_how_much(device):
    scene = SCENES["forward peak"]
    extinction = extinction_of(scene)
    whole = RadianceOperator(scene, [ABOVE, CAMERA], device).render(extinction, 2000, seed=1)
    cut = RadianceOperator(scene, [ABOVE, CAMERA], device, truncation=0.05).render(extinction, 2000, seed=1)
    missing = 1 - cut.mean.sum() / whole.mean.sum()
    assert whole.audit.truncated == 0 and missing > 0.01
    # The same paths: what is missing is what was removed.
    assert cut.audit.truncated == pytest.approx(missing, rel=1e-3)
