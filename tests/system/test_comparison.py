"""The report's standard errors hold: of a perfect recovery few pixels differ by more than two of them."""

import numpy as np

import cloudtomo_cl as ct
from cloudtomo_cl.report.comparison import in_standard_errors, per_cent

# As of `modelled.FEWEST_SAMPLES`, which conftest.py makes smaller.
SAMPLES = 256


def test_of_a_perfect_recovery_noise_explains_the_differences(device):
    """In the brightest fifth of the pixels, where rare bright paths make errors that do not hold."""
    grid = ct.Grid(shape=(16, 16, 16), spacing=(0.06, 0.06, 0.06))
    extinction = ct.cumulus(grid, seed=3, peak=40.0)
    scene = ct.Scene(grid=grid, sun=ct.Sun(zenith=30.0), surface=ct.Surface(albedo=0.05))
    angles = ((0, 0), (45, 0), (45, 180))
    views = [ct.OrthographicView(zenith=z, azimuth=a, width=1.4, pixels=(32, 32)) for z, a in angles]
    operator = ct.RadianceOperator(scene, views, device)
    scores, shares = [], []
    for seed in range(2):
        measured, modelled = (
            ct.Measurements.rendered(operator, operator.render(extinction, SAMPLES, seed, stream)) for stream in (0, 99)
        )
        # By both: those that are bright by chance in one of them are darker in the other.
        image = np.concatenate([(one + other).ravel() for one, other in zip(measured.images, modelled.images)])
        score = np.concatenate([score.ravel() for score in in_standard_errors(measured, modelled)])
        scores.append(score[image > np.quantile(image, 0.8)])
        shares += [share.mean() for share in per_cent(measured, modelled)]
    score = np.concatenate(scores)
    # With 16 paths and each pixel's own error the mean was -0.98, the mean square 2.7, and 26 % lay below -2.
    assert abs(score.mean()) < 0.25 and 0.7 < np.mean(score**2) < 1.3
    assert np.mean(np.abs(score) > 2) < 0.08
    assert np.abs(shares).max() < 1.5
