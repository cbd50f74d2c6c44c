"""Lens and plane from the pictures of a camera calibration run."""

from pathlib import Path

import numpy as np
import pytest

from labrig.analysis.run import analyze_run
from labrig.experiments.camera_calibration.result import CalibrationResult
from labrig.experiments.registry import find_run_experiment, load_run_result
from labrig.record.reader import Run
from labrig.vision.calibration_file import load_intrinsics, load_plane, read_camera, save_plane
from labrig.vision.gel import Gel, Layer
from labrig.vision.plane import PlaneMap
from tests.analysis.synthetic import NOW, PROVENANCE
from tests.experiments.camera_calibration.recorded import record_calibration
from tests.pages import write_page


def _analyse(run: Run, *overrides: str) -> tuple[CalibrationResult, Path]:
    experiment = find_run_experiment(run)
    result = analyze_run(run, experiment, overrides=overrides, created=NOW, provenance=PROVENANCE)
    assert isinstance(result.content, CalibrationResult)
    return result.content, result.path


@pytest.fixture(scope="session")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """Twelve views of the board and the graph paper, by the simulated camera."""
    return record_calibration(tmp_path_factory.mktemp("calibration"), views=12)


@pytest.fixture(scope="session")
def analysed(run: Run) -> tuple[CalibrationResult, Path]:
    """The result with the settings of the protocol, and its folder."""
    return _analyse(run)


def test_lens_and_plane_are_found_and_written(run: Run, analysed: tuple[CalibrationResult, Path]) -> None:
    """The simulated lens (fx 1800 px) is found within 4 sigma, and both files load together."""
    content, folder = analysed
    lens = load_intrinsics(folder / "intrinsics.json")
    assert lens.fx == pytest.approx(1800.0, abs=4.0 * (lens.sigma["fx"] or 0.0))
    assert load_plane(folder / "plane.json", lens).mm_per_px == pytest.approx(0.0646, abs=0.001)
    assert content.intrinsics is not None
    assert content.intrinsics["fx"] == lens.fx
    found = load_run_result(run)
    assert found is not None
    assert lens.board_warp is not None
    page = write_page(run, found, NOW).read_text(encoding="utf-8")
    assert f"±\u00a0{1000 * lens.board_warp.sigma_row_mm:.1f}\u00a0µm over their ends" in page
    assert "is known to <b>0.0" in page
    assert "labrig calibrate adopt" in page
    assert content.plane is not None
    assert f"the camera stands {content.plane['camera_distance_mm']:.0f}\u00a0mm away" in page
    assert content.corners.keys() == {view["image"] for view in content.intrinsics["views"] if view["used"]}
    assert {len(pixels) for pixels in content.corners.values()} == {54}
    assert read_camera(folder / "plane.json").settings == {"pixel_format": "GREY", "focus": 0}


def test_the_gel_of_the_protocol_is_corrected_and_the_assumptions_are_kept(tmp_path: Path) -> None:
    """Index, depth, wall and paper position reach the map; a pixel is longer behind 10 mm of gel than on it."""
    known = "depth_sigma_mm: 0.5, layers: [{index: acrylic, thickness_mm: 2}]"
    run = record_calibration(
        tmp_path, views=10, gel=f"{{index: 1.35, depth_mm: 10, paper_at: surface, {known}}}"
    )
    content, folder = _analyse(run)
    plane = load_plane(folder / "plane.json", load_intrinsics(folder / "intrinsics.json"))
    wall = Layer(index="acrylic", thickness_mm=2.0)
    assert plane.gel == Gel(index=1.35, depth_mm=10.0, paper_at="surface", depth_sigma_mm=0.5, layers=(wall,))
    assert len(plane.map_by_variants([(0.0, 0.0)])["surface"]) == 2
    assert content.plane is not None
    assert content.plane["assumptions"] == list(plane.gel.assumptions())
    assert plane.mm_per_px > 1.02 * np.ptp(plane.at_paper().to_mm([(320.0, 200.0), (321.0, 200.0)])[:, 1])


def test_a_scale_five_times_that_of_the_rig_is_refused(tmp_path: Path) -> None:
    """Where no distance is stated the rig's last map tells the scale; what contradicts it is the reason."""
    last = tmp_path / "last.json"
    save_plane(last, PlaneMap.from_scale(77.4, (320.0, 200.0), "right", (1280, 720)), {})
    run = record_calibration(tmp_path, views=6, last=last, distance_mm=None)
    refused, _ = _analyse(run)
    assert not refused.accepted
    assert any("px apart" in reason for reason in refused.reasons)
    told, _ = _analyse(run, "plane.distance_mm=116")
    assert told.accepted, told.reasons


@pytest.mark.parametrize(("views", "why"), [(0, "no picture of the board"), (1, "in any of 1 picture")])
def test_photographs_without_a_board_are_refused(tmp_path: Path, views: int, why: str) -> None:
    """Without a board there is no lens, and so no plane; the reason says what is missing, and no map is written."""
    content, folder = _analyse(record_calibration(tmp_path, views=views, hold_board=False))
    assert (content.accepted, content.intrinsics, content.plane) == (False, None, None)
    assert why in content.reasons[0]
    assert sorted(file.name for file in folder.iterdir()) == ["SHA256SUMS", "result.json", "tables.json"]
