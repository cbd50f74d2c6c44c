"""Pixels to mm: the frame's directions, and the map that a picture of graph paper gives."""

import re
from dataclasses import replace
from functools import cache

import cv2
import numpy as np
import pytest

from labrig.errors import CalibrationRefusedError, InputError, MeasurementRefusedError, PictureError
from labrig.vision.calibrate_plane import calibrate_plane, find_bent_homographies, find_px_per_mm, fit_plane
from labrig.vision.gel import Gel
from labrig.vision.paper import find_paper
from labrig.vision.plane import PlaneMap
from tests.vision.renderer import FRAMES, Camera, Photo, Sheet

ORIGIN = (100.3, 200.7)
LENS = (-0.12, 0.03, 5e-4, -3e-4, 0.0)
CAMERA = Camera((800, 600), 880.0, (404.3, 296.9), LENS, 880.0 / 15.6, 2.44, 35.0, 1.0, aspect=1.002)
GREY = Photo(fall=0.25, blur_px=1.0, noise=4.0)
PAPER = Sheet("1/5/10", CAMERA, GREY, ink="grey", width_mm=0.1, density=0.55)
# For what asserts no accuracy.
SMALL = Sheet(
    camera=replace(CAMERA, size=(480, 320), focal_px=528.0, centre_px=(244.0, 156.0), distance_mm=66.0),
    photo=GREY,
)


@cache
def picture_of(sheet):
    """Return the picture of a sheet."""
    return sheet.draw()


def calibrate(
    sheet, insertion="right", picture=None, lens=True, origin=ORIGIN, pitch_mm=None, off=0.9, **how
):
    """Return the plane map of a sheet's picture whose scale is stated that many times too large."""
    image, pitch_mm = picture_of(sheet) if picture is None else picture, pitch_mm or sheet.pitch_mm
    lens = sheet.camera.intrinsics if lens is True else lens
    px_per_mm = off * sheet.camera.px_per_mm
    return calibrate_plane(image, lens, pitch_mm, origin, insertion, px_per_mm=px_per_mm, **how)


def field(sheet, count=300):
    """Return pixels all over the picture."""
    return np.random.default_rng(5).uniform((0.0, 0.0), np.array(sheet.camera.size) - 1.0, (count, 2))


def furthest_off(plane, sheet, insertion="right"):
    """Return how far a place is from where it is by the camera, at most, all over the picture [mm]."""
    px = field(sheet)
    true = (sheet.camera.to_mm(px) - sheet.camera.to_mm([ORIGIN])) @ np.array(FRAMES[insertion]).T
    return np.linalg.norm(plane.to_mm(px) - true, axis=1).max()


@pytest.mark.parametrize("insertion", FRAMES)
def test_scale_follows_the_conventions(insertion):
    """A stated scale puts +z along the insertion and +y where the right-handed frame has it, and so does paper."""
    plane = PlaneMap.from_scale(5.0, (30.0, 40.0), insertion)
    assert plane.to_mm([(30, 40), (35, 40), (30, 45)]) == pytest.approx(
        np.vstack(((0, 0), np.transpose(FRAMES[insertion]))), abs=1e-12
    )
    assert plane.to_px(plane.to_mm([(-7.0, 1e4)])) == pytest.approx(np.array([(-7.0, 1e4)]))
    assert plane.mm_per_px == pytest.approx(0.2)
    assert (plane.accepted, plane.rms_mm) == (True, None)
    assert furthest_off(calibrate(SMALL, insertion), SMALL, insertion) < 0.02


@pytest.mark.processors
def test_paper_gives_the_plane_to_a_fiftieth_of_a_millimetre():
    """Lens, tilt and turn are undone all over the picture, far inside 0.02 mm."""
    plane = calibrate(PAPER)
    px = field(PAPER)
    assert plane.accepted, plane.reasons
    assert furthest_off(plane, PAPER) < 0.005
    assert plane.to_mm([ORIGIN]) == pytest.approx(np.zeros((1, 2)), abs=1e-9)
    assert plane.to_px(plane.to_mm(px)) == pytest.approx(px, abs=1e-6)
    assert plane.mm_per_px == pytest.approx(1 / 15.6, rel=0.05)
    assert plane.rms_mm < 0.02
    assert plane.holdout_rms_mm == pytest.approx(plane.rms_mm, rel=0.2)


def draw_traces(picture):
    """Return the picture with dark pen traces across it, a zigzag half down it, and a shadow at its edge."""
    height, width = picture.shape
    drawn = picture.copy()
    u = np.arange(width)
    for level in (0.3, 0.7):
        v = level * height + 0.08 * height * np.sin(u / 9.0) * np.sin(u / 70.0)
        cv2.polylines(drawn, [np.column_stack((u, v)).astype(np.int32)], False, 30, 2)
    zigzag = np.array([(width // 2 + 12 * (-1) ** k, k * height // 24) for k in range(13)], dtype=np.int32)
    cv2.polylines(drawn, [zigzag], False, 30, 2)
    return (drawn * np.linspace(0.55, 1.0, width)).astype(np.uint8)


def cover(picture):
    """Return the picture with a tool on the paper."""
    covered = picture.copy()
    covered[150:320, 300:420] = 40
    return covered


SLANTED = replace(CAMERA, tilt_deg=14.65, distance_mm=275.0)
COARSE = replace(PAPER, ruling="5", width_mm=0.3, camera=SLANTED, photo=replace(GREY, fall=0.3))


@pytest.mark.parametrize(
    ("sheet", "spoil", "most_mm"),
    [
        (replace(PAPER, camera=replace(CAMERA, tilt_deg=24.4)), np.array, 0.02),
        (replace(PAPER, camera=replace(CAMERA, distance_mm=880.0 / 30.0)), np.array, 0.02),
        (replace(PAPER, photo=replace(GREY, noise=12.0)), np.array, 0.02),
        (replace(PAPER, photo=replace(GREY, blur_px=2.5)), np.array, 0.02),
        (replace(PAPER, camera=replace(CAMERA, distortion=(-0.3, 0.1, 0.0, 0.0, 0.0))), np.array, 0.02),
        (COARSE, draw_traces, 0.05),
        pytest.param(PAPER, cover, 0.005, marks=pytest.mark.processors),
    ],
    ids=["tilt", "large", "noise", "blur", "lens", "5 mm, slanted, under traces", "under a tool"],
)  # fmt: skip
def test_paper_is_found_under_hard_conditions(sheet, spoil, most_mm):
    """Tilt, scale, noise, blur, a strong lens, pen traces and a tool leave the map right."""
    plane = calibrate(sheet, picture=spoil(picture_of(sheet)))
    assert plane.accepted, plane.reasons
    assert furthest_off(plane, sheet) < most_mm


def test_faint_coarse_lines_are_found_beside_what_is_no_line():
    """A quarter of the usual darkness in mottled paper, few lines, a needle, and a container's edge off the grid."""
    camera = Camera(
        (370, 880), 407.0, (189.3, 436.9), (0.0,) * 5, 407.0 / 28.0, 1.22, 35.0, 1.0, aspect=1.002
    )
    sheet = Sheet(
        "1", camera, Photo(fall=0.05, blur_px=1.5, noise=0.0), ink="grey", width_mm=0.1, density=0.14
    )
    random = np.random.default_rng(3)
    clean = 0.9 * sheet.draw()
    mottled = clean + 60.0 * cv2.GaussianBlur(random.normal(0.0, 1.0, clean.shape), (0, 0), 5.0)
    picture = np.clip(mottled + random.normal(0.0, 2.0, clean.shape), 0, 255).astype(np.uint8)
    picture[:50] //= 2
    cv2.ellipse(picture, (370, 0), (300, 600), 0, 90, 180, 40, 5)
    found = find_paper(picture, 25.0)
    fit = fit_plane(found.pixels, found.lines, 0.25)
    ends = np.array([(80.0, 120.0), (290.0, 820.0)])
    assert fit.kept.sum() > 50
    ours, true = (np.linalg.norm(np.diff(to_mm(ends), axis=0)) for to_mm in (fit.paper_mm, camera.to_mm))
    assert ours == pytest.approx(true, rel=0.004)


def test_without_intrinsics_one_radial_term_is_fitted():
    """Distortion beyond the radial term shows in the residuals; the map is right to 0.1 mm and has an exact inverse.

    A lens without distortion needs no calibration: the homography is the whole map.
    """
    plane, px = calibrate(PAPER, lens=None), field(PAPER)
    assert plane.radial is not None
    assert 0.002 < furthest_off(plane, PAPER) < 0.1
    assert plane.to_px(plane.to_mm(px)) == pytest.approx(px, abs=1e-6)
    plain = replace(PAPER, camera=replace(CAMERA, distortion=(0.0,) * 5))
    plane = calibrate(plain, lens=None)
    assert plane.accepted, plane.reasons
    assert furthest_off(plane, plain) < 0.005


def test_refuses_paper_that_is_not_flat_or_lies_askew_and_a_refused_lens():
    """Wavy paper is refused with how far it is off; lines at nearly 45 degrees leave the direction to chance."""
    plane = calibrate(replace(PAPER, bulge_mm=0.12))
    assert any("off a plane" in reason and "flat" in reason for reason in plane.reasons)
    assert plane.rms_mm > 0.05
    askew = calibrate(replace(SMALL, camera=replace(SMALL.camera, roll_deg=38.0)))
    assert any(re.search(r"turned by 3[78]\.\d degrees", reason) for reason in askew.reasons)
    refused = calibrate(SMALL, lens=replace(SMALL.camera.intrinsics, accepted=False))
    assert any("itself refused" in reason for reason in refused.reasons)
    assert not any(found.accepted for found in (plane, askew, refused))


@pytest.mark.parametrize(("width_px", "enough"), [(280, False), (360, True)])
def test_refuses_a_scrap_of_paper(width_px, enough):
    """A piece over less than a quarter of the picture is refused: it does not determine the rest."""
    scrap = np.full_like(picture_of(PAPER), 200)
    scrap[100:460, 150 : 150 + width_px] = picture_of(PAPER)[100:460, 150 : 150 + width_px]
    plane = calibrate(PAPER, picture=scrap)
    assert plane.accepted == enough
    assert enough or "the printed grid covers 2" in plane.reasons[0]


@pytest.mark.parametrize("kind", ["blank", "noise", "stripes", "board", "one pixel"])
def test_refuses_pictures_without_ruled_paper(kind):
    """Blank, noisy, striped and checkered pictures show no grid of lines."""
    generator = np.random.default_rng(0)
    rows, columns = np.mgrid[0:480, 0:640]
    picture = {
        "blank": np.full((480, 640), 180), "noise": generator.integers(0, 256, (480, 640)),
        "stripes": 60 + 120 * (columns % 16 > 1), "board": 40 + 180 * ((rows // 40 + columns // 40) % 2),
        "one pixel": np.full((1, 1), 180),
    }[kind].astype(np.uint8)  # fmt: skip
    with pytest.raises(CalibrationRefusedError, match=r"no grid|px apart"):
        calibrate_plane(picture, None, 1.0, (0.0, 0.0), "right", px_per_mm=14.0)


@pytest.mark.parametrize(
    ("number", "origin", "insertion", "message"),
    [
        (0.0, ORIGIN, "right", "scale|pitch"), (-1.0, ORIGIN, "right", "scale|pitch"),
        (float("inf"), ORIGIN, "right", "scale|pitch"), (5.0, (0.0, float("nan")), "right", "origin"),
        (1.0, ORIGIN, "sideways", "sideways"),
    ],
)  # fmt: skip
def test_refuses_impossible_frames(number, origin, insertion, message):
    """A scale or pitch, an origin or a direction that cannot be is wrong input, before any search."""
    with pytest.raises(InputError, match=message):
        PlaneMap.from_scale(number, origin, insertion)
    with pytest.raises(InputError, match=message):
        calibrate(SMALL, insertion, origin=origin, pitch_mm=number or -1.0)


def test_refuses_what_does_not_fit_the_picture():
    """An origin outside of it, a lens for pictures of another size, and points of another shape."""
    for origin in ((480.0, 10.0), (-1.0, 10.0)):
        with pytest.raises(InputError, match="outside the picture of 480 x 320"):
            calibrate(SMALL, origin=origin)
    with pytest.raises(PictureError, match="240 x 160 pixels, the lens's calibration is for 480 x 320"):
        calibrate(SMALL, picture=cv2.resize(picture_of(SMALL), (240, 160)), origin=(50.0, 50.0))
    plane = PlaneMap.from_scale(5.0, (0.0, 0.0), "right")
    for read, points in ((plane.to_mm, [1.0, 2.0]), (plane.to_px, np.zeros((3, 3)))):
        with pytest.raises(InputError, match="shape"):
            read(points)


CLOSER = Camera((480, 320), 760.0, (244.0, 156.0), (-0.1, 0.02, 0.0, 0.0, 0.0), 95.0, 9.0, 50.0, 14.0)
COLOURED = Sheet(camera=CLOSER)


def sheet_of(ruling="1/5/10", px_per_mm=8.0, tilt_deg=9.0, roll_deg=14.0, photo=COLOURED.photo, **how):
    """Return a sheet before the closer camera, tilted and rolled."""
    camera = replace(CLOSER, distance_mm=760.0 / px_per_mm, tilt_deg=tilt_deg, roll_deg=roll_deg)
    return Sheet(ruling, camera, photo, **how)


@pytest.mark.parametrize(
    ("sheet", "off"),
    [
        (sheet_of("1", 3.2, roll_deg=5.0), 0.87),
        (sheet_of("1/5", 6.0, tilt_deg=24.0), 1.15),
        (sheet_of("1/10", 4.6, photo=Photo(0.36, 0.54, 0.23, blur_px=0.9)), 1.0),
        (sheet_of("1/5/10", 6.1, width_mm=0.1, density=0.4), 0.9),
        (sheet_of("1/5/10", 12.0, roll_deg=-20.0), 1.1),
        (sheet_of("2", 7.0, ink="orange", paper="cream"), 1.0),
        (sheet_of("5", 4.0, photo=replace(COLOURED.photo, noise=5.0), ink="green"), 1.1),
        (sheet_of("1/5", 5.0, extent_mm=(-38.0, -25.0, 30.0, 40.0), behind=15.0), 0.9),
        (sheet_of("5", 4.0, photo=replace(COLOURED.photo, grey=True), extent_mm=(-48.0, -30.0, 41.0, 33.0)), 1.0),
    ],
)  # fmt: skip
def test_ordinary_sheets_are_accepted_and_right(sheet, off):
    """Any ruling and ink, tilted, blurred, lit from one side, on a dark bench: lengths are right to a thousandth."""
    plane = calibrate(sheet, off=off)
    assert plane.accepted, plane.reasons
    assert sheet.length_error(plane) < 1e-3


@pytest.mark.parametrize(
    ("sheet", "off", "pitch_mm", "words"),
    [
        *((COLOURED, off, None, r"px apart|too close") for off in (5.0, 2.0, 1.4, 0.7, 0.5, 0.2)),
        *((sheet_of("1"), off, None, r"px apart|too close") for off in (5.0, 0.1)),
        (COLOURED, 1.0, 5.0, r"(7\.9|8\.\d) px apart in the picture, .* would be (39|40)\.\d px"),
    ],
)
def test_a_scale_or_a_pitch_that_the_sheet_contradicts_is_refused(sheet, off, pitch_mm, words):
    """The sentence has both distances between lines; the hint says what to measure. Five is typed for a 1 mm sheet."""
    with pytest.raises(CalibrationRefusedError, match=words) as caught:
        calibrate(sheet, off=off, pitch_mm=pitch_mm)
    assert "measure" in caught.value.hint or "come closer" in caught.value.hint


@pytest.mark.parametrize("turn_deg", [20.0, 45.0])
def test_a_second_sheet_is_refused(turn_deg):
    """Two sheets in one picture, of which one is turned; and a picture that is white everywhere."""
    first, second = (
        picture_of(sheet_of(roll_deg=roll, photo=replace(COLOURED.photo, seed=number)))
        for number, roll in enumerate((0.0, turn_deg))
    )
    both = np.concatenate((first[:, :260], second[:, 260:]), axis=1)
    with pytest.raises(MeasurementRefusedError, match="two sheets") as caught:
        find_paper(both, 8.0)
    assert "take one" in caught.value.hint
    with pytest.raises(MeasurementRefusedError, match="overexposed"):
        find_paper(np.full_like(both, 255), 8.0)


def test_what_covers_the_paper_from_side_to_side_makes_no_second_sheet():
    """A ruler across the sheet hides its lines, and the larger part is used."""
    covered = picture_of(COLOURED).copy()
    covered[100:130] = 240
    assert COLOURED.length_error(calibrate(COLOURED, picture=covered)) < 1e-3


def test_a_lens_through_which_the_grid_is_no_square_is_refused():
    """The calibration of another camera shows in the shape of the cells."""
    plane = calibrate(COLOURED, lens=replace(CLOSER.intrinsics, fy=1.06 * 760.0))
    assert not plane.accepted
    assert any("no square grid through the lens" in reason for reason in plane.reasons)


def test_a_map_says_what_its_scale_implies():
    """The picture's width in mm and the camera's distance, which a person checks with a ruler, and which tells it."""
    plane = calibrate(COLOURED)
    assert plane.picture_mm == pytest.approx(CLOSER.picture_size_mm(), rel=0.005)
    assert plane.camera_distance_mm == pytest.approx(95.0, rel=0.005)
    assert "mm wide" in plane.view_sentence()
    assert plane.to_json()["camera_distance_mm"] == plane.camera_distance_mm
    assert find_px_per_mm(CLOSER.intrinsics, 95.0) == pytest.approx(8.0)


def test_a_sheet_the_size_of_a_phone_s_picture_is_read_as_well():
    """Lines a hundred pixels apart are followed in a smaller picture, and located in the whole one."""
    camera = replace(CLOSER, size=(1600, 1200), focal_px=2500.0, centre_px=(800.0, 600.0), distance_mm=125.0)
    sheet = Sheet("5", camera, replace(COLOURED.photo, blur_px=1.8), samples=2)
    assert find_paper(sheet.draw(), 110.0).spacing_px == pytest.approx(100.0, rel=0.05)


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
def test_refraction_is_snell_s(paper_at, surface_mm):
    """Every pixel goes where a ray ends up that is traced through the surface by vectors, and comes back."""
    bare = calibrate(SMALL)
    plane = calibrate(SMALL, gel=Gel(index=1.35, depth_mm=12.0, paper_at=paper_at))
    px = field(SMALL)
    ends = [trace_ray(bare.camera_mm(), mm, 1.35, 12.0, surface_mm) for mm in bare.to_mm([ORIGIN, *px])]
    assert plane.to_mm(px) == pytest.approx(np.array(ends[1:]) - ends[0], abs=2e-6)
    assert plane.to_mm([ORIGIN]) == pytest.approx(np.zeros((1, 2)), abs=1e-9)
    assert plane.to_px(plane.to_mm(px)) == pytest.approx(px, abs=1e-6)
    assert len(plane.to_json()["assumptions"]) == 3


def test_refuses_a_gel_that_reaches_the_camera_and_one_before_an_unknown_camera():
    """A depth in another unit is refused, because the camera's height is known; without a lens it is not."""
    with pytest.raises(
        CalibrationRefusedError, match=r"depth is 900 mm, and the camera is only 6\d mm above the paper"
    ):
        calibrate(SMALL, gel=Gel(index=1.35, depth_mm=900.0))
    with pytest.raises(InputError, match="need the camera's intrinsics"):
        calibrate(SMALL, lens=None, gel=Gel(index=1.35, depth_mm=5.0))


def test_stated_uncertainty_is_the_observed_one():
    """Over sheets whose crossings are off together in blocks, a length varies as the fit states."""
    random = np.random.default_rng(1)
    cells = np.array([(row, column) for row in range(30) for column in range(40)])
    blocks = cells[:, 0] // 5 * 8 + cells[:, 1] // 5
    ends = np.array([(120.0, 120.0), (680.0, 480.0)])

    def length(homography):
        return np.linalg.norm(np.subtract(*cv2.perspectiveTransform(ends[None], homography)[0]))

    lengths, stated = [], []
    for _ in range(30):
        off = random.normal(0.0, 0.1, (48, 2))[blocks] + random.normal(0.0, 0.1, cells.shape)
        fit = fit_plane(20.0 * cells + off, cells.astype(float), 0.25)
        lengths.append(length(fit.homography))
        others, _ = fit.leave_out(blocks[fit.kept])
        stated.append(np.linalg.norm([length(other) - lengths[-1] for other in others]))
    assert 0.7 < np.std(lengths, ddof=1) / np.mean(stated) < 1.4
    quarters = blocks[fit.kept] // 12
    kept = [quarters != number for number in range(4)]
    without = [cv2.findHomography(fit.ideal[rest], fit.places_mm[rest])[0] for rest in kept]
    both = (fit.leave_out(quarters)[0], without)
    stated, moved = (np.sum((np.array(others) - fit.homography) ** 2, axis=0) for others in both)
    assert stated == pytest.approx(0.75 * moved, rel=1e-6)


DISTANCE_MM = 120.0
FOOT_MM = np.array([36.0, 24.0])
PINHOLE = np.array([[1800.0, 0.0, 640.0], [0.0, 1800.0, 360.0], [0.0, 0.0, 1.0]])
GRID_MM = np.stack(np.meshgrid(np.arange(2.0, 72.0), np.arange(2.0, 46.0)), axis=-1).reshape(-1, 2)


def project(places_mm, heights_mm, noise=0.05, seed=0):
    """Return the pixels (N, 2) at which a camera over `FOOT_MM` sees points of that height over the plane."""
    px = PINHOLE[0, 0] * (places_mm - FOOT_MM) / (DISTANCE_MM - heights_mm)[:, None] + PINHOLE[:2, 2]
    return px + np.random.default_rng(seed).normal(0.0, noise, px.shape)


def bent_sheet(height_mm, angle_rad):
    """Return the heights (N,) of a sheet that is bent about a line of this direction, their mean zero."""
    along = (GRID_MM - GRID_MM.mean(axis=0)) @ [np.cos(angle_rad), np.sin(angle_rad)]
    roof = height_mm * (1.0 - (along / np.abs(along).max()) ** 2)
    return roof - roof.mean()


def apply_homography(homography, px):
    """Return where a homography puts pixels (N, 2)."""
    return cv2.perspectiveTransform(px[None], homography)[0]


@pytest.mark.parametrize("seed", range(2))
def test_flat_paper_leaves_nothing_uncertain(seed):
    """Noise alone is not a bend."""
    assert find_bent_homographies(project(GRID_MM, np.zeros(len(GRID_MM)), seed=seed), GRID_MM, FOOT_MM) == []


@pytest.mark.parametrize("angle_deg", [0.0, 140.0])
@pytest.mark.parametrize("height_mm", [0.4, -0.8])
def test_map_without_the_bend_and_with_it_are_as_far_apart_as_the_map_is_wrong(height_mm, angle_deg):
    """The other homographies predict the error of the plane's own points to a fifth."""
    px = project(GRID_MM, bent_sheet(height_mm, np.deg2rad(angle_deg)))
    fitted = cv2.findHomography(px, GRID_MM)[0]
    plane_px = project(GRID_MM, np.zeros(len(GRID_MM)), noise=0.0)
    wrong = apply_homography(fitted, plane_px) - GRID_MM
    bent, raised = find_bent_homographies(px, GRID_MM, FOOT_MM)
    predicted = apply_homography(fitted, plane_px) - apply_homography(bent, plane_px)
    assert np.sqrt(np.mean(wrong**2)) > 0.005
    assert np.sqrt(np.mean((predicted - wrong) ** 2)) < 0.2 * np.sqrt(np.mean(wrong**2))
    moved = apply_homography(raised, plane_px) - apply_homography(fitted, plane_px)
    share = np.std(bent_sheet(height_mm, np.deg2rad(angle_deg))) / DISTANCE_MM
    risen = share * np.sqrt(np.mean(np.sum((GRID_MM - FOOT_MM) ** 2, axis=1)))
    assert np.sqrt(np.mean(np.sum(moved**2, axis=1))) == pytest.approx(risen, rel=0.3)
