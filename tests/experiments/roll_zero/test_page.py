"""The page of a roll zero run: the cosine of the roll, each insertion, and its picture."""

import math
import re
from pathlib import Path

import numpy as np
import pytest

from labrig.experiments.roll_zero.result import RollZeroResult
from labrig.record.reader import Run
from tests.analysis.synthetic import close_record, create_record, needle_picture, plane_file
from tests.report.conftest import make_page

ZERO_RAD = math.radians(20.0)


def record_roll_zero(folder: Path, zero_rad: float, without_needle: frozenset[int] = frozenset()) -> Run:
    """Record short insertions at six rolls of a needle that bends towards -y at `zero_rad`, and open the run."""
    text = """
experiment: roll-zero
title: Roll zero
seed: 1
needle: {needle_id: N1, diameter_mm: 1.2, design_radius_mm: 28}
sheath: {depth_mm: 15, speed_mm_s: 5, diameter_mm: 2.0}
insertion: {speed_mm_s: 1, withdraw_speed_mm_s: 5}
roll_zero: {specimen: {name: block, gelatin_percent: 13}, rolls: 6, length_mm: 14, max_sd_deg: 3}
"""
    recorder = create_record(folder, "roll-zero", text, plane_file(folder))
    for step in range(6):
        roll_rad = step * np.pi / 3
        picture = needle_picture(None if step in without_needle else 28.0, 14.0, step, roll_rad - zero_rad)
        place = {"insertion_mm": 14.0, "rotation_rad": roll_rad, "linear_mm": 15.0}
        recorder.frame(picture, 60.0 * step, trial=None, role="roll-zero", **place)
    return close_record(recorder)


def test_the_zero_is_drawn_and_each_insertion_has_its_line_and_its_picture(tmp_path: Path) -> None:
    """A needle bends towards −y at 20 degrees; the fourth picture shows none, and has no row."""
    page = make_page(record_roll_zero(tmp_path, ZERO_RAD, frozenset({3})))
    assert page.result is not None
    assert isinstance(page.result.content, RollZeroResult)
    assert page.result.content.fit is not None
    assert page.result.content.fit["zero_rad"] == pytest.approx(ZERO_RAD, abs=math.radians(1.0))
    told = ("Needle N1 bends towards −y", "fitted cosine", "roll zero, ±\u00a02 SD", "1 picture did not show")
    assert all(words in page.html for words in told)
    assert page.html.count("data:image/jpeg") == 6
    for roll_deg in (0, 60, 120, 240, 300):
        assert f'<td class="n">{roll_deg}.0</td>' in page.html
    residuals = re.findall(r'<td class="n">([+−]0\.\d{3})</td></tr>', page.html)
    assert len(residuals) == 5
    total = math.fsum(float(residual.replace("−", "-")) for residual in residuals)
    assert total == pytest.approx(0.0, abs=0.005)
