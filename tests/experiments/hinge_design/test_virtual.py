"""Virtual needles of a design."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from labrig.errors import FileFormatError, InputError
from labrig.experiments.declared import PROTOCOL_MODELS
from labrig.experiments.hinge_design.virtual import find_reach_mm, simulate
from labrig.needle.equations import EQUATION_3, radius_tolerance
from labrig.protocol.load import load_protocol

DESIGN = Path(__file__).parents[3] / "protocols" / "design.yaml"


def design(*settings: str) -> Any:
    """Return the example design with settings."""
    return load_protocol(DESIGN, PROTOCOL_MODELS, list(settings))


def test_radii_fill_the_tolerance_and_stay_within_it() -> None:
    """The radii of a thousand needles lie within the worst cases of the design, and come near both."""
    protocol = design()
    radii_mm = np.array([simulate(protocol, seed).values["radius_mm"] for seed in range(1000)])
    worst = radius_tolerance(
        EQUATION_3,
        11.459155902616466,
        protocol.tube.link_length_mm,
        clearance_tolerance_mm=protocol.tolerances.clearance_mm,
        cut_tolerance_deg=protocol.tolerances.cut_deg,
    )
    assert worst.high_mm is not None
    assert worst.low_mm <= radii_mm.min() < worst.low_mm + 0.4
    assert worst.high_mm - 0.4 < radii_mm.max() <= worst.high_mm
    assert radii_mm.mean() == pytest.approx(30.0, abs=0.15)


def test_a_seed_gives_the_same_needle_again() -> None:
    """Each seed is a needle of its own, to the last bit; without tolerances it is the one that was asked for."""
    assert simulate(design(), 3) == simulate(design(), 3) != simulate(design(), 4)
    exact = simulate(design("tolerances.clearance_mm=0", "tolerances.cut_deg=0"), 3)
    assert exact.values["radius_mm"] == pytest.approx(30.0, abs=1e-9)


def test_the_reach_is_that_of_an_arc() -> None:
    """A needle of 30 mm is 7.64 mm aside at 20 mm; a tight one reaches no further than its radius."""
    assert find_reach_mm(30.0) == pytest.approx(30.0 - np.sqrt(500.0))
    assert find_reach_mm(15.0) == 15.0


def test_what_equation_3_does_not_cover_is_refused() -> None:
    """Another tube, and a design that a run refuses, have no virtual needles."""
    with pytest.raises(InputError, match="equation \\(3\\) was fitted to a tube"):
        simulate(design("tube.outer_diameter_mm=1.5"), 1)
    with pytest.raises(FileFormatError, match="radius"):
        simulate(design("radius_mm=1"), 1)
