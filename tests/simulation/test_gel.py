"""The random draws for a specimen and its holes."""

import json

import numpy as np
import pytest

from labrig.errors import InputError
from labrig.simulation.description import (
    DesignDescription,
    NeedleDescription,
    WorldDescription,
)
from labrig.simulation.gel import GelBlock, draw_needle_scale, make_hole
from labrig.simulation.world import World
from tests.simulation.benches import QUIET, bench


@pytest.mark.parametrize(("gelatin_percent", "mean", "sd"), [(10.0, 28.34, 0.247), (19.0, 27.13, 0.473)])
def test_radii_have_the_paper_s_mean_and_spread(gelatin_percent: float, mean: float, sd: float) -> None:
    """Over 1000 seeds mean and SD agree with section V-B within four standard errors."""
    block = GelBlock("A", gelatin_percent, 0, 0)
    drawn = np.array([make_hole(QUIET, seed, block, (3, 65.0), "N1").radius_mm for seed in range(1000)])
    assert abs(drawn.mean() - mean) < 4 * sd / np.sqrt(1000)
    assert abs(drawn.std(ddof=1) - sd) < 4 * sd / np.sqrt(2 * 1000)


@pytest.mark.parametrize("gelatin_percent", [9.9, 19.1])
def test_a_gel_beyond_the_known_ones_is_refused(gelatin_percent: float) -> None:
    """A gelatin content outside the known range is refused with value and limits."""
    with pytest.raises(InputError, match=rf"{gelatin_percent:g} % .* 10 to 19 %"):
        World(QUIET, 1).place_specimen("A", gelatin_percent)


def test_the_draw_of_a_hole_does_not_depend_on_earlier_holes() -> None:
    """Hole 3 has the same radius and play whether or not other holes were visited before."""
    direct = bench(hole=3, position_mm=65.0)
    after_others = bench(hole=0, position_mm=35.0)
    after_others.shift_to_hole("A", 1, 45.0)
    after_others.shift_to_hole("A", 3, 65.0)
    assert direct.truth() == after_others.truth()


def test_hole_specimen_needle_and_seed_each_change_the_draw() -> None:
    """Five holes that differ in one thing each have five radii."""
    worlds = [bench(), bench(hole=1), bench(seed=6)]
    for needle, name in (("N2", "A"), ("N1", "B")):
        worlds.append(world := World(QUIET, 5))
        world.mount_needle(needle)
        world.place_specimen(name, 13.0)
        world.shift_to_hole(name, 0, 35.0)
    assert len({world.truth()["radius_mm"] for world in worlds}) == 5


def make_world(low_mm: float, high_mm: float) -> WorldDescription:
    """Return a quiet world whose needle was designed for a radius in between."""
    design = DesignDescription(radius_low_mm=low_mm, radius_high_mm=high_mm)
    return QUIET.model_copy(update={"needle": NeedleDescription(design=design)})


def test_a_design_scales_the_radii_of_the_gels() -> None:
    """A needle designed for 45 mm steers half as tight again as the paper's, designed for 30, in the same hole."""
    paper, wide = bench().truth()["radius_mm"], bench(make_world(45.0, 45.0)).truth()["radius_mm"]
    assert isinstance(paper, float)
    assert wide == pytest.approx(1.5 * paper)
    assert bench(make_world(30.0, 30.0)).truth() == bench().truth()


def test_each_needle_draws_its_own_radius_within_the_tolerance() -> None:
    """One draw a needle and seed, the same in every hole, spread over the whole tolerance."""
    world = make_world(27.0, 33.0)
    scales = [draw_needle_scale(world, 5, f"N{number}") for number in range(200)]
    assert 27.0 / 30 < min(scales) < 27.3 / 30
    assert 32.7 / 30 < max(scales) < 33.0 / 30
    assert draw_needle_scale(world, 5, "N1") == scales[1] != draw_needle_scale(world, 6, "N1")
    assert draw_needle_scale(QUIET, 5, "N1") == 1.0


GEL = {"gelatin_percent": 13, "radius_mean_mm": 27.0, "radius_sd_mm": 0.2}


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"gels": [GEL, GEL]}, "13 % follows 13 %"),
        ({"needle": {"diameter_mm": 2.2}}, r"2\.2 mm; must be below sheath.diameter_mm, 2 mm"),
        (
            {"layers": [{"until_mm": 30, "radius_scale": 1}, {"until_mm": 20, "radius_scale": 1}]},
            "20 mm follows 30 mm",
        ),
        ({"disturbances": {"cavity_mm": [9.0, 4.0]}}, "must have the lower one first"),
    ],
)
def test_a_world_that_cannot_be_is_refused(changes: dict[str, object], words: str) -> None:
    """What does not fit is named with its limit."""
    with pytest.raises(ValueError, match=words):
        WorldDescription.model_validate_json(json.dumps(changes))
