"""The fit of the torsional lag, on deflections of known lags."""

import math

import numpy as np
import pytest

from labrig.errors import InputError, MeasurementRefusedError
from labrig.steering.torsion_fit import BendLengths, TorsionBend, fit_torsion

RADIUS_MM = 27.7
LENGTHS = BendLengths(bent_mm=12.0, turned_mm=15.0, backlash_mm=1.5)
LAG_RAD, PER_MM = math.radians(2.0), math.radians(0.15)


def make_bends(noise_mm, seed, depths_mm=(30.0, 50.0, 70.0)):
    """Return the bends of a needle with a known lag, with a parallax that depends on the depth."""
    random, bends = np.random.default_rng(seed), []
    for depth_mm in depths_mm:
        for direction in (1, -1):
            turned_rad = math.pi / 2 - direction * (LAG_RAD + PER_MM * depth_mm)
            bent_rad = LAG_RAD + PER_MM * (depth_mm - 20.0)
            bent, turned = random.normal(0.0, noise_mm, 2)
            bent -= RADIUS_MM * (1 - math.cos(12.0 / RADIUS_MM)) * math.cos(bent_rad)
            turned -= RADIUS_MM * (1 - math.cos(14.25 / RADIUS_MM)) * math.cos(turned_rad) + 0.01 * depth_mm
            bends.append(TorsionBend(depth_mm, direction, depth_mm - 20.0, bent, turned))
    return bends


def fit(bends):
    """Return the fit, with an expected radius that is not the true one."""
    return fit_torsion(bends, LENGTHS, 30.0)


@pytest.mark.processors
def test_exact_deflections_give_the_lag_exactly():
    """The lag, its growth and the radius come out; a parallax that depends on the depth alone changes nothing."""
    found = fit(make_bends(0.0, 0))
    assert found.lag.lag_rad == pytest.approx(LAG_RAD, abs=1e-6)
    assert found.lag.lag_rad_per_mm == pytest.approx(PER_MM, abs=1e-8)
    assert found.radius_mm == pytest.approx(RADIUS_MM, abs=1e-4)


def test_the_interval_covers_the_lag():
    """Of 200 fits of noisy deflections, 92.5 to 97.5 % of the 95 % intervals of lag and growth hold the true one."""
    fits = [fit(make_bends(0.05, seed)) for seed in range(200)]
    held = [abs(found.lag.lag_rad - LAG_RAD) <= 1.96 * found.lag.find_sd_rad(0.0) for found in fits]
    grown = [abs(found.lag.lag_rad_per_mm - PER_MM) <= 1.96 * found.lag.per_mm_sd_rad for found in fits]
    assert 0.925 <= np.mean(held) <= 0.975
    assert 0.925 <= np.mean(grown) <= 0.975


@pytest.mark.parametrize(
    ("bends", "radius_mm", "error", "words"),
    [
        (make_bends(0.0, 0, (30.0,)), 30.0, InputError, "1 depths"),
        (make_bends(0.0, 0)[:-1], 30.0, InputError, "each from both sides"),
        (make_bends(0.0, 0), 60.0, MeasurementRefusedError, r"radius of 27\.7 mm"),
    ],
)
def test_what_tells_no_lag_is_refused(bends, radius_mm, error, words):
    """One depth, one side only, and a needle that bends twice as much as one of this design."""
    with pytest.raises(error, match=words):
        fit_torsion(bends, LENGTHS, radius_mm)
