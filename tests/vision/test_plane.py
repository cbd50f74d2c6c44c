"""Pixels to mm: the frame's directions, and the map that a picture of graph paper gives."""

import re
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from labrig.errors import CalibrationRefusedError, InputError, PictureError
from labrig.vision.calibrate_plane import calibrate_plane, fit_plane
from labrig.vision.circle import fit_circle
from labrig.vision.gel import Gel
from labrig.vision.paper import find_paper
from labrig.vision.picture import read_picture
from labrig.vision.plane import PlaneMap

from .graph_paper_pictures import LINES, draw_paper, make_bench

PHOTOGRAPHS = Path(__file__).parents[2].parent / "shared" / "data" / "ruled_paper"
ORIGIN = (100.3, 200.7)
# Of the bench, and 10 % off.
PX_PER_MM = 14.0
DIRECTIONS = ("right", "left", "up", "down")
# Where a pixel to the right and a pixel below lie, (y, z), for each direction of the insertion.
FRAMES = {
    "right": ((0, 1), (-1, 0)),
    "down": ((1, 0), (0, 1)),
    "left": ((0, -1), (1, 0)),
    "up": ((-1, 0), (0, -1)),
}


@pytest.fixture(scope="module")
def bench():
    """Return a camera over a sheet."""
    return make_bench()


@pytest.fixture(scope="module")
def paper(bench):
    """Return a picture of ruled paper there."""
    return draw_paper(bench)


def calibrate(picture, lens, pitch_mm, origin, insertion, *, px_per_mm=PX_PER_MM, **how):
    """Return the plane map; the scale is stated for paper whose lines are a millimetre apart."""
    scale = px_per_mm / pitch_mm
    return calibrate_plane(picture, lens, pitch_mm, origin, insertion, px_per_mm=scale, **how)


def field(bench, count=300):
    """Return pixels all over the picture."""
    width, height = bench.intrinsics.image_size
    return np.random.default_rng(5).uniform((0.0, 0.0), (width - 1.0, height - 1.0), (count, 2))


def truth(bench, px, insertion):
    """Return the plane's points (y, z) [mm] at pixels, by the bench's own camera."""
    sheet = bench.mm(px) - bench.mm([ORIGIN])
    return sheet @ np.array(FRAMES[insertion], dtype=float)


@pytest.mark.parametrize("insertion", DIRECTIONS)
def test_scale_follows_the_conventions(insertion):
    """A stated scale puts +z along the insertion and +y where the right-handed frame has it."""
    plane = PlaneMap.from_scale(5.0, (30.0, 40.0), insertion)
    assert plane.to_mm([(30, 40), (35, 40), (30, 45)]) == pytest.approx(
        np.array([(0, 0), *FRAMES[insertion]]), abs=1e-12
    )
    assert plane.mm_per_px == pytest.approx(0.2)
    assert plane.accepted
    assert plane.rms_mm is None


@settings(max_examples=50, deadline=None)
@given(
    scale=st.floats(0.1, 100.0),
    u=st.floats(-1e3, 1e4),
    v=st.floats(-1e3, 1e4),
    insertion=st.sampled_from(DIRECTIONS),
)
def test_scale_goes_there_and_back(scale, u, v, insertion):
    """Pixels to mm to pixels is the same pixel."""
    plane = PlaneMap.from_scale(scale, (320.5, 240.25), insertion)
    assert plane.to_px(plane.to_mm([(u, v)])) == pytest.approx(np.array([(u, v)]), rel=1e-9, abs=1e-6)


@pytest.mark.parametrize(
    ("scale", "origin", "insertion", "message"),
    [
        (0.0, (0, 0), "right", "scale"),
        (-1.0, (0, 0), "right", "scale"),
        (float("inf"), (0, 0), "right", "scale"),
        (5.0, (0, float("nan")), "right", "origin"),
        (5.0, (0, 0), "sideways", "sideways"),
    ],
)
def test_refuses_impossible_scales(scale, origin, insertion, message):
    """An impossible scale, origin or direction is wrong input."""
    with pytest.raises(InputError, match=message):
        PlaneMap.from_scale(scale, origin, insertion)


def test_wants_one_row_a_point():
    """Points of another shape are wrong input."""
    plane = PlaneMap.from_scale(5.0, (0.0, 0.0), "right")
    with pytest.raises(InputError, match="shape"):
        plane.to_mm([1.0, 2.0])
    with pytest.raises(InputError, match="shape"):
        plane.to_px(np.zeros((3, 3)))


@pytest.mark.processors
@pytest.mark.parametrize("insertion", DIRECTIONS)
def test_paper_gives_the_plane_to_a_fiftieth_of_a_millimetre(insertion, bench, paper):
    """Lens, tilt and turn are undone all over the picture, in the stated frame, far inside 0.02 mm."""
    plane = calibrate(paper, bench.intrinsics, 1.0, ORIGIN, insertion)
    px = field(bench)
    error = np.linalg.norm(plane.to_mm(px) - truth(bench, px, insertion), axis=1)
    assert plane.accepted, plane.reasons
    assert error.max() < 0.005
    assert plane.to_mm([ORIGIN]) == pytest.approx(np.zeros((1, 2)), abs=1e-9)
    assert plane.to_px(plane.to_mm(px)) == pytest.approx(px, abs=1e-6)
    assert plane.mm_per_px == pytest.approx(1 / 15.6, rel=0.05)
    assert plane.rms_mm < 0.02
    assert plane.holdout_rms_mm == pytest.approx(plane.rms_mm, rel=0.2)


@pytest.mark.parametrize(
    ("how", "drawn"),
    [
        ({"tilt_deg": 20.0}, {}),
        ({"px_per_mm": 30.0}, {}),
        ({}, {"noise": 12.0}),
        ({}, {"blur_px": 2.5}),
        ({"distortion": (-0.3, 0.1, 0.0, 0.0, 0.0)}, {}),
    ],
)
def test_paper_is_found_under_hard_conditions(how, drawn):
    """Tilt, scale, noise, blur and a strong lens leave the map inside 0.02 mm."""
    bench = make_bench(**how)
    scale = 0.9 * how.get("px_per_mm", 15.6)
    plane = calibrate(draw_paper(bench, **drawn), bench.intrinsics, 1.0, ORIGIN, "right", px_per_mm=scale)
    px = field(bench)
    assert plane.accepted, plane.reasons
    assert np.linalg.norm(plane.to_mm(px) - truth(bench, px, "right"), axis=1).max() < 0.02


def draw_traces(picture):
    """Return the picture with dark pen traces across it, a zigzag half down it, and a shadow at its edge."""
    height, width = picture.shape
    drawn = picture.copy()
    u = np.arange(width)
    for level in (0.3, 0.7):
        v = level * height + 0.08 * height * np.sin(u / 9.0) * np.sin(u / 70.0)
        cv2.polylines(
            drawn, [np.column_stack((u, v)).astype(np.int32)], isClosed=False, color=30, thickness=2
        )
    zigzag = np.array([(width // 2 + 12 * (-1) ** k, k * height // 24) for k in range(13)], dtype=np.int32)
    cv2.polylines(drawn, [zigzag], isClosed=False, color=30, thickness=2)
    return (drawn * np.linspace(0.55, 1.0, width)).astype(np.uint8)


@pytest.fixture(scope="module")
def slanted():
    """Return a camera that looks at the sheet aslant."""
    return make_bench(px_per_mm=16.0, tilt_deg=12.0)


@pytest.fixture(scope="module")
def slanted_paper(slanted):
    """Return a picture of it: one weight of lines, uneven light, traces over it."""
    return draw_traces(draw_paper(slanted, lines=LINES[:1], uneven=1.0))


def test_lines_of_another_pitch_give_the_plane(slanted, slanted_paper):
    """Paper of 5 mm under perspective, uneven light and traces maps within a hundredth of its pitch."""
    plane = calibrate(slanted_paper, slanted.intrinsics, 5.0, ORIGIN, "right")
    px = field(slanted)
    error = plane.to_mm(px) - 5.0 * truth(slanted, px, "right")
    assert np.linalg.norm(error, axis=1).max() < 0.05
    assert plane.rms_mm < 0.25


def test_lines_are_numbered_across_a_fold(slanted):
    """All but 1 % of the points on either side have the right numbers; the fold is refused."""
    picture = draw_traces(draw_paper(slanted, lines=LINES[:1], uneven=1.0, fold_deg=5.0))
    found = find_paper(picture, 15.0)
    true = slanted.fold_mm(found.pixels, 5.0)
    design = np.column_stack((found.lines, np.ones(len(true))))
    numbering = np.round(np.linalg.lstsq(design, true, rcond=None)[0])
    assert np.mean(np.abs(true - design @ numbering).max(axis=1) < 0.25) > 0.99
    assert len(true) > 200
    plane = calibrate(picture, slanted.intrinsics, 1.0, ORIGIN, "right")
    assert not plane.accepted
    assert any("flat" in reason for reason in plane.reasons)


def test_faint_coarse_lines_are_found_beside_what_is_no_line():
    """A quarter of the usual darkness in mottled paper, few lines, a needle, and a container's edge off the grid."""
    bench = make_bench(size=(370, 880), px_per_mm=28.0, tilt_deg=1.0, distortion=(0.0,) * 5)
    faint = tuple((every, width, 0.2 * density) for every, width, density in ((1, 0.05, 0.3), (2, 0.08, 0.5)))
    clean = draw_paper(bench, lines=faint, noise=0.0, blur_px=1.5).astype(float)
    random = np.random.default_rng(3)
    mottled = clean + 60.0 * cv2.GaussianBlur(random.normal(0.0, 1.0, clean.shape), (0, 0), 5.0)
    picture = np.clip(mottled + random.normal(0.0, 2.0, clean.shape), 0, 255).astype(np.uint8)
    picture[:50] //= 2
    cv2.ellipse(picture, (370, 0), (300, 600), 0, 90, 180, 40, 5)
    fit_to = find_paper(picture, 25.0)
    fit = fit_plane(fit_to.pixels, fit_to.lines, 0.25)
    ends = np.array([(80.0, 120.0), (290.0, 820.0)])
    assert fit.kept.sum() > 50
    assert np.linalg.norm(np.diff(fit.paper_mm(ends), axis=0)) == pytest.approx(
        np.linalg.norm(np.diff(bench.mm(ends), axis=0)), rel=0.004
    )


def test_noise_alone_hardly_moves_the_map(bench):
    """Pictures that differ by their noise give maps that agree to a thousandth of a millimetre."""
    px, clean = field(bench, 50), draw_paper(bench, noise=0.0).astype(float)
    maps = []
    for seed in range(5):
        noise = np.random.default_rng(seed).normal(0.0, 4.0, clean.shape)
        noisy = np.clip(np.round(clean + noise), 0, 255).astype(np.uint8)
        maps.append(calibrate(noisy, bench.intrinsics, 1.0, ORIGIN, "down").to_mm(px))
    assert np.std(maps, axis=0).max() < 1e-3


def test_without_intrinsics_one_radial_term_is_fitted(bench, paper):
    """Distortion beyond the radial term shows in the residuals; the map is right to 0.1 mm and has an exact inverse."""
    plane = calibrate(paper, None, 1.0, ORIGIN, "right")
    px = field(bench)
    assert plane.radial is not None
    assert 0.002 < np.linalg.norm(plane.to_mm(px) - truth(bench, px, "right"), axis=1).max() < 0.1
    assert plane.to_px(plane.to_mm(px)) == pytest.approx(px, abs=1e-6)


def test_without_intrinsics_a_plain_lens_is_enough():
    """A lens without distortion needs no calibration: the homography is the whole map."""
    bench = make_bench(distortion=(0.0, 0.0, 0.0, 0.0, 0.0))
    plane = calibrate(draw_paper(bench), None, 1.0, ORIGIN, "right")
    px = field(bench)
    assert plane.accepted, plane.reasons
    assert np.linalg.norm(plane.to_mm(px) - truth(bench, px, "right"), axis=1).max() < 0.005


def test_refuses_paper_that_is_not_flat(bench):
    """Wavy paper is refused; the reason names how far it is off, and where."""
    plane = calibrate(draw_paper(bench, bulge_mm=0.12), bench.intrinsics, 1.0, ORIGIN, "right")
    assert not plane.accepted
    assert any("off a plane" in reason and "flat" in reason for reason in plane.reasons)
    assert plane.rms_mm > 0.05


def test_refuses_paper_laid_askew():
    """Lines at nearly 45 degrees leave the frame's direction to chance."""
    bench = make_bench(turn_deg=38.0)
    plane = calibrate(draw_paper(bench), bench.intrinsics, 1.0, ORIGIN, "right")
    assert any(re.search(r"turned by 3[78]\.\d degrees", reason) for reason in plane.reasons)


@pytest.mark.parametrize(("width_px", "enough"), [(280, False), (360, True)])
def test_refuses_a_scrap_of_paper(bench, paper, width_px, enough):
    """A piece over less than a quarter of the picture is refused: it does not determine the rest."""
    scrap = np.full_like(paper, 200)
    scrap[100:460, 150 : 150 + width_px] = paper[100:460, 150 : 150 + width_px]
    plane = calibrate(scrap, bench.intrinsics, 1.0, ORIGIN, "right")
    assert plane.accepted == enough
    assert enough or "the paper's lines cover 2" in plane.reasons[0]


@pytest.mark.processors
def test_goes_around_what_lies_on_the_paper(bench, paper):
    """A tool on the paper hides its crossings and does not move the map."""
    covered = paper.copy()
    covered[150:320, 300:420] = 40
    plane = calibrate(covered, bench.intrinsics, 1.0, ORIGIN, "right")
    px = field(bench)
    assert plane.accepted, plane.reasons
    assert np.linalg.norm(plane.to_mm(px) - truth(bench, px, "right"), axis=1).max() < 0.005


@pytest.mark.parametrize("kind", ["blank", "noise", "stripes", "board", "one pixel"])
def test_refuses_pictures_without_ruled_paper(kind):
    """Blank, noisy, striped and checkered pictures show no grid of lines."""
    generator = np.random.default_rng(0)
    rows, columns = np.mgrid[0:480, 0:640]
    picture = {
        "blank": np.full((480, 640), 180),
        "noise": generator.integers(0, 256, (480, 640)),
        "stripes": 60 + 120 * (columns % 16 > 1),
        "board": 40 + 180 * ((rows // 40 + columns // 40) % 2),
        "one pixel": np.full((1, 1), 180),
    }[kind].astype(np.uint8)
    with pytest.raises(CalibrationRefusedError, match=r"no grid|px apart"):
        calibrate(picture, None, 1.0, (0.0, 0.0), "right")


@pytest.mark.parametrize(
    ("pitch", "origin", "insertion", "message"),
    [
        (-1.0, ORIGIN, "right", "pitch"),
        (float("nan"), ORIGIN, "right", "pitch"),
        (1.0, (800.0, 10.0), "right", "outside the picture of 800 x 600"),
        (1.0, (-1.0, 10.0), "right", "outside"),
        (1.0, ORIGIN, "forwards", "forwards"),
    ],
)
def test_refuses_impossible_frames(pitch, origin, insertion, message, bench, paper):
    """An impossible pitch, origin or direction is wrong input, before any search."""
    with pytest.raises(InputError, match=message):
        calibrate(paper, bench.intrinsics, pitch, origin, insertion)


def test_refuses_intrinsics_of_another_size(bench, paper):
    """The lens was calibrated for other pictures: wrong input, naming both sizes."""
    with pytest.raises(PictureError, match="400 x 300 pixels, the lens's calibration is for 800 x 600"):
        calibrate(cv2.resize(paper, (400, 300)), bench.intrinsics, 1.0, ORIGIN, "right")


def test_does_not_rest_on_a_refused_lens(bench, paper):
    """A plane map over a refused lens is refused too."""
    refused = replace(bench.intrinsics, accepted=False)
    plane = calibrate(paper, refused, 1.0, ORIGIN, "right")
    assert any("itself refused" in reason for reason in plane.reasons)


@pytest.mark.parametrize(
    ("name", "flat", "holdout_mm"),
    [("ecg00026.jpg", True, 0.35), ("ecg00040.jpg", True, 0.2), ("ecg00031.jpg", False, 1.0)],
)
def test_hand_held_photographs_are_numbered_and_judged(name, flat, holdout_mm):
    """Under pen traces and printed dots the grid is found and numbered in millimetres; the folded sheet is not flat."""
    if not PHOTOGRAPHS.is_dir():
        pytest.skip(f"the photographs of ruled paper are not at {PHOTOGRAPHS}")
    plane = calibrate(read_picture(PHOTOGRAPHS / name), None, 1.0, (600.0, 250.0), "right", px_per_mm=5.0)
    assert plane.points > 400
    # Five millimetres are about 22 pixels in all three.
    assert plane.mm_per_px == pytest.approx(5.0 / 22.0, rel=0.1)
    assert plane.holdout_rms_mm < holdout_mm
    assert not plane.accepted
    assert any("not flat" in reason for reason in plane.reasons) != flat


def trace_ray(camera, mm, index, above_mm, surface_mm):
    """Return where the ray through a paper point (y, z) [mm] ends up, by vectors and Snell's law in three dimensions.

    The paper's plane is x = 0 in a frame whose x points away from the camera; the surface is at x = surface_mm, and the
    ray is followed to the plane x = surface_mm + above_mm.
    """
    foot, height = camera[:2], camera[2]
    start = np.array([-height, *foot])
    direction = np.array([0.0, *mm]) - start
    direction /= np.linalg.norm(direction)
    hit = start + direction * (surface_mm - start[0]) / direction[0]
    normal = np.array([-1.0, 0.0, 0.0])
    cosine = -normal @ direction
    ratio = 1.0 / index
    bent = ratio * direction + (ratio * cosine - np.sqrt(1.0 - ratio**2 * (1.0 - cosine**2))) * normal
    return (hit + bent * above_mm / bent[0])[1:]


@pytest.mark.parametrize(("paper_at", "surface_mm"), [("needle", -12.0), ("surface", 0.0)])
def test_refraction_is_snell_s(bench, paper, paper_at, surface_mm):
    """Every pixel goes where a ray ends up that is traced through the surface by vectors, and comes back."""
    gel = Gel(index=1.35, depth_mm=12.0, paper_at=paper_at)
    bare = calibrate(paper, bench.intrinsics, 1.0, ORIGIN, "right")
    plane = calibrate(paper, bench.intrinsics, 1.0, ORIGIN, "right", gel=gel)
    px = field(bench)
    ends = [trace_ray(bare.camera_mm(), mm, 1.35, 12.0, surface_mm) for mm in bare.to_mm([ORIGIN, *px])]
    assert plane.to_mm(px) == pytest.approx(np.array(ends[1:]) - ends[0], abs=1e-6)
    assert plane.to_mm([ORIGIN]) == pytest.approx(np.zeros((1, 2)), abs=1e-9)
    assert plane.to_px(plane.to_mm(px)) == pytest.approx(px, abs=1e-6)
    assert len(plane.to_json()["assumptions"]) == 3


@pytest.mark.parametrize(("paper_at", "low", "high"), [("needle", -0.55, -0.09), ("surface", 0.26, 1.57)])
def test_refraction_moves_the_radius_by_what_was_measured(bench, paper, paper_at, low, high):
    """For r = 28 mm the correction undoes +0.09 to +0.55 mm (paper at the needle), -0.26 to -1.57 mm (on the gel)."""
    plane = calibrate(paper, bench.intrinsics, 1.0, ORIGIN, "right")
    scale = 300.0 / plane.camera_mm()[2]
    gel = Gel(index=1.35, depth_mm=12.0 / scale, paper_at=paper_at)
    corrected = calibrate(paper, bench.intrinsics, 1.0, ORIGIN, "right", gel=gel)
    turn = np.linspace(0.0, 1.4, 60)
    arc = 28.0 / scale * np.column_stack((np.sin(turn) - 0.5, 1.0 - np.cos(turn) + 0.5))
    before = fit_circle(arc, robust=False).radius
    after = fit_circle(corrected.to_mm(plane.to_px(arc)), robust=False).radius
    assert low <= scale * (after - before) <= high


def test_refuses_a_gel_that_reaches_the_camera(bench, paper):
    """A depth in another unit is refused, because the camera's height above the paper is known."""
    with pytest.raises(
        CalibrationRefusedError, match=r"depth is 900 mm, and the camera is only 5\d mm above the paper"
    ):
        calibrate(paper, bench.intrinsics, 1.0, ORIGIN, "right", gel=Gel(index=1.35, depth_mm=900.0))


def test_refraction_takes_a_calibrated_camera(paper):
    """Without intrinsics the place of the camera is unknown, so a gel is refused."""
    with pytest.raises(InputError, match="need the camera's intrinsics"):
        calibrate(paper, None, 1.0, ORIGIN, "right", gel=Gel(index=1.35, depth_mm=5.0))


def test_stated_uncertainty_is_the_observed_one():
    """Over sheets whose crossings are off together in blocks, a length varies as the fit states."""
    random = np.random.default_rng(1)
    cells = np.array([(row, column) for row in range(30) for column in range(40)])
    blocks = cells[:, 0] // 5 * 8 + cells[:, 1] // 5
    ends = np.array([(120.0, 120.0), (680.0, 480.0)])
    lengths, stated = [], []
    for _ in range(40):
        off = random.normal(0.0, 0.1, (48, 2))[blocks] + random.normal(0.0, 0.1, cells.shape)
        fit = fit_plane(20.0 * cells + off, cells.astype(float), 0.25)
        lengths.append(length(fit.homography, ends))
        others, _ = fit.leave_out(blocks[fit.kept])
        stated.append(np.linalg.norm([length(other, ends) - lengths[-1] for other in others]))
    assert 0.7 < np.std(lengths, ddof=1) / np.mean(stated) < 1.4


def length(homography, ends):
    """Return the distance of two pixels through a homography [mm]."""
    points = cv2.perspectiveTransform(ends[None], homography)[0]
    return float(np.linalg.norm(points[1] - points[0]))
