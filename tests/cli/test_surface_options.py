"""The options of `labrig calibrate plane` for gel, walls and a telecentric lens, and the journey through its files."""

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from labrig.cli.surface import SurfaceOptions, read_layer
from labrig.errors import InputError
from labrig.vision.calibration_file import load_plane, save_intrinsics, save_plane
from labrig.vision.refraction import Gel, Layer
from labrig.vision.surface import anchor_origin, find_surface_variations
from tests.cli.conftest import Labrig
from tests.vision.graph_paper_pictures import SunkenBench, TelecentricBench, draw_paper, make_bench
from tests.vision.rendering import RenderedBench, RenderedGel, RenderedLens, RenderedNeedle

FRAME = ("--origin-px", "100.3", "200.7", "--insertion", "right")


def test_gel_takes_index_depth_and_a_calibrated_camera() -> None:
    """All three make a gel; a part of them is wrong input that names the rest."""
    assert SurfaceOptions(1.35, 10.0, "surface").make_gel(camera_known=True) == Gel(1.35, 10.0, "surface")
    assert SurfaceOptions().make_gel(camera_known=False) is None
    with pytest.raises(InputError, match="belong together"):
        SurfaceOptions(1.35).make_gel(camera_known=True)
    with pytest.raises(InputError, match="needs the camera's intrinsics"):
        SurfaceOptions(1.35, 10.0).make_gel(camera_known=False)


def test_layers_tilt_and_deviations_reach_the_gel() -> None:
    """They are taken over as they are typed, angles in degrees."""
    typed = SurfaceOptions(1.35, 10.0, "gel", 0.01, 0.5, ("glass:3:0.1", "air:1"), (2.0, -1.0), 0.5)
    tilt = (math.radians(2.0), math.radians(-1.0))
    layers = (Layer(1.52, 3.0, 0.005, 0.1), Layer(1.0, 1.0, 0.0))
    assert typed.make_gel(camera_known=True) == Gel(
        1.35, 10.0, "gel", 0.01, 0.5, layers, tilt, math.radians(0.5)
    )
    assert read_layer("1.6:2:0.1") == Layer(1.6, 2.0, None, 0.1)


@pytest.mark.parametrize(
    "text", ["glass", "glass:", "wood:3", "glass:3:0.1:1", "nan:3", "glass:inf", ":3", ""]
)
def test_refuses_a_layer_that_says_nothing(text: str) -> None:
    """A layer without material, thickness or sense is wrong input, with an example."""
    with pytest.raises(InputError) as caught:
        read_layer(text)
    assert "glass" in caught.value.hint


@pytest.mark.parametrize(
    "options",
    [
        {"layers": ("glass:3",)},
        {"tilt_sigma_deg": 1.0},
        {"paper_at": "gel"},
        {"through": Path("p.png")},
        {"through": Path("p.png"), "index": 1.35, "depth_mm": 10.0},
        {"through": Path("p.png"), "index": 1.35, "depth_sigma_mm": 1.0},
        {"through": Path("p.png"), "index": 1.35, "tilt_deg": (1.0, 0.0)},
    ],
)
def test_refuses_options_without_their_partner_or_beside_what_measures_them(options: dict[str, Any]) -> None:
    """A wall without a gel is no gel; a picture through the gel gives what may not be stated as well."""
    with pytest.raises(InputError) as caught:
        SurfaceOptions(**options).make_gel(camera_known=True)
    assert "--gel-index" in caught.value.hint


def test_a_wall_of_known_glass_goes_through_file_and_measurement(labrig: Labrig, tmp_path: Path) -> None:
    """The deviations that were given move the map that is read back; the others are named by command and file."""
    bench = make_bench()
    picture, lens, out = tmp_path / "paper.png", tmp_path / "lens.json", tmp_path / "plane.json"
    cv2.imwrite(str(picture), draw_paper(bench))
    save_intrinsics(lens, bench.intrinsics, {})
    known = (
        "--gel-index 1.35 --gel-index-sigma 0.01 --gel-depth-mm 5 --layer glass:3:0.1 --paper-sigma-mm 0.5"
    )
    done = labrig("calibrate", "plane", picture, "--intrinsics", lens, *FRAME, *known.split(), "--out", out)
    assert done.exit_code == 0
    assert "not in the interval: lens, the gel's depth, the tilt of the gel's surface" in done.out
    plane = load_plane(out, bench.intrinsics)
    assert plane.gel == Gel(1.35, 5.0, "needle", 0.01, None, (Layer(1.52, 3.0, 0.005, 0.1),))
    ends = [(100.3, 200.7), (700.0, 300.0)]
    moves = [np.linalg.norm(np.diff(other.to_mm(ends), axis=0)) for other in plane.variants("surface")]
    assert len(moves) == 3
    assert len(set(np.round(moves, 6))) == 3


def test_a_picture_through_the_gel_gives_its_depth_and_tilt(labrig: Labrig, tmp_path: Path) -> None:
    """The command says what it measured, and the file holds it with its standard deviation and both pictures."""
    bench = make_bench((480, 360), px_per_mm=12.0)
    sunken = SunkenBench(bench.intrinsics, bench.mm_to_ideal, depth_mm=5.0)
    bare, through, lens, out = (
        tmp_path / name for name in ("bare.png", "gel.png", "lens.json", "plane.json")
    )
    cv2.imwrite(str(bare), draw_paper(bench))
    cv2.imwrite(str(through), draw_paper(sunken, seed=1))
    save_intrinsics(lens, bench.intrinsics, {})
    known = (
        "--intrinsics",
        lens,
        "--gel-index",
        "1.35",
        "--gel-index-sigma",
        "0.01",
        "--through-gel",
        through,
    )
    done = labrig("calibrate", "plane", bare, *FRAME, *known, "--out", out)
    assert done.exit_code == 0, done.err
    assert "crossings seen through it the gel is" in done.out
    gel = load_plane(out, bench.intrinsics).gel
    assert gel is not None
    assert gel.depth_mm == pytest.approx(5.0, abs=0.2)
    # The index's standard deviation, 0.01, is one of depth / (n (n - 1)) times as much.
    assert gel.depth_sigma_mm == pytest.approx(0.106, rel=0.1)
    assert gel.tilt_rad == pytest.approx((0.0, 0.0), abs=0.005)
    assert gel.tilt_sigma_rad is not None
    assert set(json.loads(out.read_text(encoding="utf-8"))["provenance"]["pictures"]) == {
        "bare.png",
        "gel.png",
    }


def test_a_telecentric_lens_goes_through_file_and_measurement(labrig: Labrig, tmp_path: Path) -> None:
    """A map without perspective is written, read without intrinsics and measures; intrinsics beside it are refused."""
    bench = TelecentricBench(make_bench().intrinsics, np.eye(3), px_per_mm=15.6, turn_deg=2.0)
    picture, out = tmp_path / "paper.png", tmp_path / "plane.json"
    cv2.imwrite(str(picture), draw_paper(bench))
    done = labrig("calibrate", "plane", picture, *FRAME, "--telecentric", "--out", out)
    assert done.exit_code == 0, done.err
    assert "the lens is telecentric, so the scale holds at any distance" in done.out
    ends = np.array([(100.3, 200.7), (700.0, 300.0)])
    plane = load_plane(out, None)
    length_mm = np.linalg.norm(np.diff(plane.to_mm(ends), axis=0))
    assert length_mm == pytest.approx(np.linalg.norm(np.diff(ends, axis=0)) / 15.6, rel=1e-4)
    with pytest.raises(InputError, match="a telecentric lens has no distance"):
        plane.camera_mm()
    save_intrinsics(tmp_path / "lens.json", bench.intrinsics, {})
    refused = labrig(
        "calibrate", "plane", picture, *FRAME, "--telecentric", "--intrinsics", tmp_path / "lens.json"
    )
    assert refused.exit_code == 2
    assert "intrinsics describe a lens with perspective" in refused.err


def test_a_measurement_names_what_of_the_surface_is_not_in_its_interval(
    labrig: Labrig, tmp_path: Path
) -> None:
    """The gel's known deviations are a part of the radius' error budget; the others are named with the table."""
    bench = RenderedBench(RenderedLens())
    picture, lens, plane = tmp_path / "needle.png", tmp_path / "lens.json", tmp_path / "plane.json"
    cv2.imwrite(str(picture), bench.picture(RenderedNeedle(), RenderedGel(), 1))
    level = bench.lens.plane_map()
    assert level.intrinsics is not None
    placed = anchor_origin(replace(level, gel=Gel(1.35, 5.0, depth_sigma_mm=2.0)))
    moved = find_surface_variations(placed, None, np.empty((0, 2)))
    save_intrinsics(lens, level.intrinsics, {})
    save_plane(plane, replace(placed, variations=moved), {})
    files = ("--intrinsics", lens, "--plane", plane, "--sheath-diameter-mm", "2")
    (row,) = labrig("measure", "curvature", picture, *files, "--json").json()
    assert row["radius_budget_mm"]["surface"] > 0.001 * row["radius_mm"]
    said = labrig("measure", "curvature", picture, *files).err
    assert "the gel's refractive index, the tilt of the gel's surface." in said
