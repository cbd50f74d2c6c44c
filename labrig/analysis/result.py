"""What an analysis says, how it is stored in `RUN/analysis/NNN/`, and how it is read back.

`result.json` is written last: a folder without one is no result. `centre_lines.npz` holds the arrays (no
pickle), so that pages are drawn without measuring again. The two CSV files say the same as the JSON, for
spreadsheets.
"""

import csv
import io
import math
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, TypeAdapter, ValidationError

from labrig.errors import InputError, RecordError
from labrig.protocol.model import Model
from labrig.record.durable import write_atomically
from labrig.record.json_lines import encode_document
from labrig.record.reader import Run

RESULT_FILE = "result.json"
LINES_FILE = "centre_lines.npz"

Point = tuple[float, float]
FloatArray = NDArray[np.float64]
_NONE: Mapping[str, str] = {}


class PictureResult(Model):
    """One picture: where it belongs, and what was measured in it; None where that is unknown or refused.

    `origin_mm` and `origin_heading_rad` are those of its trial, found from the sheath; `tip_from_origin_mm` is the
    needle's tip told from them, (aside, along). Everything else is told in the plane's frame.
    """

    frame: int
    image: str
    role: str
    trial: int | None
    specimen: str | None
    gelatin_percent: float | None
    hole: int | None
    needle_id: str | None
    insertion_mm: float | None
    found: bool
    accepted: bool
    reason: str | None
    radius_mm: float | None = None
    radius_ci95_mm: Point | None = None
    sigma_radius_mm: float | None = None
    sigma_calibration_mm: float | None = None
    centre_mm: Point | None = None
    bend: str | None = None
    tip_mm: Point | None = None
    tip_px: Point | None = None
    sheath_tip_mm: Point | None = None
    sheath_heading_rad: float | None = None
    entry_mm: Point | None = None
    origin_mm: Point | None = None
    origin_heading_rad: float | None = None
    tip_from_origin_mm: Point | None = None
    arc_length_mm: float | None = None
    residual_rms_mm: float | None = None


class SpecimenResult(Model):
    """One needle in one gel: `n` radii of final pictures, their mean, sample SD and its 95 % interval."""

    name: str
    needle_id: str
    gelatin_percent: float
    trials: int
    n: int
    mean_radius_mm: float | None
    sd_radius_mm: float | None
    ci95_mm: Point | None
    refused: int
    refused_reasons: tuple[str, ...]
    without_final_picture: int


class SpecimenTruth(Model):
    """What was drawn for one needle in one gel, and how far the measurement is from it."""

    name: str
    needle_id: str
    n_drawn: int
    drawn_mean_radius_mm: float
    drawn_sd_radius_mm: float | None
    error_of_mean_mm: float | None
    worst_error_mm: float | None


class TruthComparison(Model):
    """Measured beside drawn, on simulated rigs.

    `intervals_holding_truth` counts the accepted pictures whose 95 % interval holds the radius drawn for
    them.
    """

    specimens: tuple[SpecimenTruth, ...]
    mean_radius_mm: float
    worst_error_of_mean_mm: float | None
    pictures: int
    worst_error_mm: float | None
    intervals_holding_truth: int


class _Common(Model):
    """What every result carries: which it is, what it was made from and by what.

    `damage` says what of the record was missing or changed when the result was made, `where: what` each.
    """

    schema_version: Literal[1] = 1
    parent: int | None
    created: str
    settings: dict[str, Any]
    overrides: tuple[str, ...]
    inputs: dict[str, str]
    provenance: dict[str, Any]
    damage: tuple[str, ...] = ()


@dataclass(frozen=True)
class Stamp:
    """What is known of a result before anything is measured: after which one, when, from what, by what.

    `damage` is that of the record as far as it is seen before pictures are read: where, what.
    """

    parent: int | None
    created: str
    overrides: tuple[str, ...]
    inputs: Mapping[str, str]
    provenance: Mapping[str, Any]
    damage: Mapping[str, str]

    def fields(self, settings: Mapping[str, Any], pictures: Mapping[str, str] = _NONE) -> dict[str, Any]:
        """Return the members that every result carries.

        Parameters
        ----------
        settings : Mapping
            How it was measured.
        pictures : Mapping
            Pictures that turned out to be missing or changed when they were read: file, what is wrong.
        """
        # A missing picture was seen before it was read; it is named once.
        damage = {**self.damage, **pictures, **self.damage}
        said = tuple(f"{where}: {what}" for where, what in damage.items())
        return {**vars(self), "settings": dict(settings), "damage": said}


class TrialOrigin(Model):
    """Where the sheath's tip stood in a trial, found in the picture taken once it was in; None where that is unknown.

    `tip_mm` and `heading_rad` are the origin and the direction of the trial. `expected_mm` is where command and linear
    encoder put the tip; `along_mm` and `across_mm` is how far beyond that, and to the side of +y, it was found, and
    `disagreement_mm` how far at all; where the protocol does not say what to expect, how far from where the encoder
    and the other trials put it, which is `from_others_mm`.
    """

    trial: int
    frame: int
    tip_mm: Point | None = None
    tip_px: Point | None = None
    heading_rad: float | None = None
    linear_mm: float | None = None
    expected_mm: Point | None = None
    along_mm: float | None = None
    across_mm: float | None = None
    disagreement_mm: float | None = None
    from_others_mm: float | None = None
    accepted: bool
    reason: str | None = None

    @property
    def heading_deg(self) -> float | None:
        """The heading as people read it."""
        return None if self.heading_rad is None else math.degrees(self.heading_rad)


class Sentinel(Model):
    """What the grid pictures before and after a run say; None where that is unknown.

    `drift` is the largest relative change of scale, which is in the error bar of every length; `bending_mm` by how much
    the grid lost its shape. A run whose sentinel is not accepted states none.
    """

    drift: float | None = None
    bending_mm: float | None = None
    scale_before: float | None = None
    scale_after: float | None = None
    accepted: bool
    reason: str | None = None

    @property
    def drift_percent(self) -> float | None:
        """The drift as people read it."""
        return None if self.drift is None else 100.0 * self.drift


class CurvatureResult(_Common):
    """Of steerability runs and imported pictures."""

    kind: Literal["curvature"] = "curvature"
    specimens: tuple[SpecimenResult, ...]
    mean_radius_mm: float | None
    measurements: tuple[PictureResult, ...]
    truth: TruthComparison | None
    origins: tuple[TrialOrigin, ...] = ()
    sentinel: Sentinel | None = None


class CalibrationResult(_Common):
    """Of camera calibration runs; `intrinsics` and `plane` are what was found, None where nothing was.

    `corners` holds the pixels (u, v) of the board's corners in each picture that was used, for the map of
    coverage.
    """

    kind: Literal["calibration"] = "calibration"
    accepted: bool
    reasons: tuple[str, ...]
    intrinsics: dict[str, Any] | None
    plane: dict[str, Any] | None

    corners: dict[str, tuple[Point, ...]]


class HingeCell(Model):
    """One point of the searched grid: clearance, inclination, and what both hinges allow."""

    clearance_mm: float
    beta_cut_deg: float
    beta_a_deg: float
    beta_b_deg: float


class DesignResult(_Common):
    """Of design runs: the document that `labrig design --json` prints too, and the searched grid.

    `beta_cut_deg` and `tolerance` are those of equation (3); `search` holds what our own contour says, or the reason
    why it cannot give the radius. `accepted`: there is something to cut, by the one or, for a tube that equation (3)
    does not speak of, by the other.
    """

    kind: Literal["design"] = "design"
    accepted: bool = True
    beta_cut_deg: float
    beta_rot_deg: float
    radius_mm: float
    clearance_mm: float
    tube: dict[str, float]
    equation_3: dict[str, Any]
    tolerance: dict[str, Any]
    table_1: dict[str, float] | None
    links: int | None
    measured: dict[str, Any] | None
    search: dict[str, Any]
    cells: tuple[HingeCell, ...]


class InsertionStep(Model):
    """One look at the needle on its way, estimated again from the recorded picture; points are (y, z).

    `tip_mm` is where the template found the tip, None where it did not, for the `reason`; `believed` says whether the
    estimator took it; `innovation_mm` is how far it was from the prediction, along y and z. `clearance_mm` is from the
    needle's surface at the estimated tip to the nearest obstacle's. `true_mm` and `true_heading_rad` are known of
    simulated worlds alone.
    """

    frame: int
    t_s: float
    depth_mm: float
    tip_mm: Point | None
    reason: str | None
    score: float | None
    estimate_mm: Point
    position_sd_mm: float
    heading_rad: float
    heading_sd_rad: float
    radius_mm: float | None
    believed: bool
    nis: float | None
    innovation_mm: Point | None
    clearance_mm: float | None
    true_mm: Point | None
    true_heading_rad: float | None


class InsertionCommand(Model):
    """What the step that steers says at a picture, by the settings of the result and knowing the turns that were made.

    `frame` is None of the first command, before the needle moves. How far to run, where to look next, by how much to
    turn the bevel (0: not at all), on which occasion a path was sought (None: on none), how many were found after the
    first, and why to stop; after the first stop there are no more.
    """

    frame: int | None
    depth_mm: float
    roll_rad: float
    observe_at_mm: float
    run_to_mm: float
    sought: str | None
    replans: int
    stop: str | None


class InsertionPlan(Model):
    """A path that was sought on the way: when, why, and the points (y, z) of it, none where none was found."""

    depth_mm: float
    t_s: float
    frame: int | None
    because: str
    found: bool
    reason: str | None
    arcs: int
    length_mm: float | None
    clearance_mm: float | None
    path_mm: tuple[Point, ...]


class InsertionObstacle(Model):
    """A sphere that was to be kept off, its centre (x, y, z)."""

    position_mm: tuple[float, float, float]
    radius_mm: float


class InsertionTrial(Model):
    """One insertion: how it ended, and how far from its target by the end of its shaft in the final picture.

    `reached`: it was steered there, and the shaft's end, where it could be measured, lies within the tolerance.
    `target_mm` is (x, y, z), `tip_mm` (y, z), with `shaft_mm` the needle's centre line; `unmeasured` says why there
    is no tip. `sigma_target_error_mm` holds the reading of the end, lens and plane map, and what the grid pictures say
    of drift. `template_error_mm` is the same distance by the template and the estimator, which steered: it is there
    to be compared, and is no measurement of the error. `mean_nis` is over the steps that were believed; two degrees
    of freedom, so 2 where the noise is what the protocol says. `as_recorded` says whether every estimate is the one of
    the live run to the last digit, as it is with its settings and its code; older results say neither that nor
    `commands`.
    """

    trial: int
    start_t_s: float
    outcome: str
    stop: str
    cause: str
    reached: bool
    target_mm: tuple[float, ...]
    tolerance_mm: float
    obstacles: tuple[InsertionObstacle, ...]
    final_frame: int | None
    tip_mm: Point | None
    shaft_mm: tuple[Point, ...]
    target_error_mm: float | None
    sigma_target_error_mm: float | None = None
    unmeasured: str | None
    template_error_mm: float | None
    true_target_error_mm: float | None
    true_min_clearance_mm: float | None
    true_path_mm: tuple[Point, ...]
    replans: int
    length_mm: float | None
    missed_sightings: int
    mean_nis: float | None
    steps: tuple[InsertionStep, ...]
    plans: tuple[InsertionPlan, ...]
    as_recorded: bool | None = None
    commands: tuple[InsertionCommand, ...] = ()


class InsertionResult(_Common):
    """Of insertion runs: how many of how many arrived; errors and length are the largest, clearance the smallest.

    `causes` counts why the others did not.
    """

    kind: Literal["insertion"] = "insertion"
    made: int
    arrived: int
    causes: dict[str, int]
    reached: bool
    target_error_mm: float | None
    true_target_error_mm: float | None
    true_min_clearance_mm: float | None
    replans: int
    length_mm: float | None
    insertions: tuple[InsertionTrial, ...]
    origins: tuple[TrialOrigin, ...] = ()
    sentinel: Sentinel | None = None


class RollZeroResult(_Common):
    """Of roll zero runs: the deflections by roll, and the cosine fitted to them, None where that was refused.

    `offset_mm` is where the sheath stands aside, the constant of that fit; None in results of earlier versions.
    """

    kind: Literal["roll-zero"] = "roll-zero"
    accepted: bool
    reasons: tuple[str, ...]
    needle_id: str
    rolls_rad: tuple[float, ...]
    deflections_mm: tuple[float, ...]
    fit: dict[str, float] | None
    offset_mm: float | None = None
    origins: tuple[TrialOrigin, ...] = ()
    sentinel: Sentinel | None = None


AnyResult: TypeAlias = CurvatureResult | CalibrationResult | DesignResult | InsertionResult | RollZeroResult
_CONTENT: TypeAdapter[AnyResult] = TypeAdapter(Annotated[AnyResult, Field(discriminator="kind")])


@dataclass(frozen=True)
class AnalysisResult:
    """A result on disk: its folder, and what it says."""

    path: Path
    content: AnyResult

    @property
    def document(self) -> Mapping[str, Any]:
        """The content as `result.json` holds it."""
        return self.content.model_dump(mode="json")


@dataclass(frozen=True, eq=False)
class CentreLines:
    """The needle's centre line in each picture where one was found, by the number of the frame.

    `mm` holds points (N, 2), columns (y, z), from the sheath's tip on; `px` the same points in the picture,
    columns (u, v); `window` the first and one past the last point that the circle was fitted to.
    """

    mm: Mapping[int, FloatArray]
    px: Mapping[int, FloatArray]
    window: Mapping[int, tuple[int, int]]


NO_LINES = CentreLines({}, {}, {})


def write_result(path: Path, content: AnyResult, lines: CentreLines = NO_LINES) -> AnalysisResult:
    """Write a result into its folder, `result.json` last.

    Raises
    ------
    DiskError
        When it cannot be written.
    """
    result = AnalysisResult(path, content)
    if isinstance(content, CurvatureResult):
        write_atomically(path / LINES_FILE, _pack(lines))
        write_atomically(path / "measurements.csv", _csv(content.measurements, PictureResult))
        write_atomically(path / "specimens.csv", _csv(content.specimens, SpecimenResult))
    if isinstance(content, CurvatureResult | InsertionResult | RollZeroResult) and content.origins:
        write_atomically(path / "origins.csv", _csv(content.origins, TrialOrigin))
    if isinstance(content, InsertionResult):
        for one in content.insertions:
            write_atomically(path / f"steps-{one.trial}.csv", _csv(one.steps, InsertionStep))
    write_atomically(path / RESULT_FILE, encode_document(result.document))
    return result


def result_numbers(run: Run) -> tuple[int, ...]:
    """Return the numbers of the run's results, rising. Raises `RecordError` where their folder is a link."""
    folder = run.own("analysis")
    return tuple(sorted(int(file.parent.name) for file in folder.glob(f"[0-9]*/{RESULT_FILE}")))


def load_result(run: Run, number: int | None = None) -> AnalysisResult | None:
    """Return a result of a run: the one of that number, or the newest; None where it has none at all.

    Raises
    ------
    InputError
        When there is no result of that number.
    RecordError
        When the result is damaged or of a newer schema, or a file of it is a symbolic link.
    """
    numbers = result_numbers(run)
    if number is None and not numbers:
        return None
    wanted = numbers[-1] if number is None else number
    if wanted not in numbers:
        raise InputError(
            f"{run.path} has no result {wanted:03d}",
            f"it has {list(numbers)}; `labrig reanalyze` makes another",
        )
    path = run.own(f"analysis/{wanted:03d}")
    try:
        for file in path.iterdir():
            run.own(f"analysis/{wanted:03d}/{file.name}")
        content = _CONTENT.validate_json((path / RESULT_FILE).read_bytes())
    except (OSError, ValidationError) as error:
        raise RecordError(
            f"{path / RESULT_FILE} cannot be read: {_first_fault(error)}",
            "make a new result with `labrig reanalyze`",
        ) from error
    return AnalysisResult(path, content)


def load_centre_lines(result: AnalysisResult) -> CentreLines:
    """Read the centre lines of a result.

    Raises
    ------
    RecordError
        When the file is missing or damaged.
    """
    file = result.path / LINES_FILE
    try:
        with np.load(file, allow_pickle=False) as arrays:
            return _unpack({name: arrays[name] for name in arrays.files})
    except (OSError, ValueError, KeyError, zipfile.BadZipFile) as error:
        raise RecordError(
            f"{file} cannot be read: {error}", "make a new result with `labrig reanalyze`"
        ) from error


def _first_fault(error: OSError | ValidationError) -> str:
    if isinstance(error, OSError):
        return error.strerror or str(error)
    first = error.errors()[0]
    place = ".".join(str(part) for part in first["loc"])
    return f"{place}: {first['msg']}" if place else first["msg"]


def _pack(lines: CentreLines) -> bytes:
    """Put all lines end to end: a thousand small arrays would take a second to load.

    Single precision is a hundred times finer than any picture; these lines are drawn, and never fitted again.
    """
    frames = sorted(lines.mm)
    lengths = [len(lines.mm[frame]) for frame in frames]
    empty = np.empty((0, 2))
    buffer = io.BytesIO()
    np.savez_compressed(
        buffer,
        frames=np.array(frames, dtype=np.int64),
        starts=np.concatenate(([0], np.cumsum(lengths, dtype=np.int64))).astype(np.int64),
        windows=np.array([lines.window[frame] for frame in frames], dtype=np.int64).reshape(-1, 2),
        mm=np.concatenate([empty, *(lines.mm[frame] for frame in frames)]).astype(np.float32),
        px=np.concatenate([empty, *(lines.px[frame] for frame in frames)]).astype(np.float32),
    )
    return buffer.getvalue()


def _unpack(arrays: Mapping[str, NDArray[Any]]) -> CentreLines:
    frames = [int(frame) for frame in arrays["frames"]]
    inner = arrays["starts"][1:-1]
    mm = np.split(arrays["mm"].astype(np.float64), inner) if frames else []
    px = np.split(arrays["px"].astype(np.float64), inner) if frames else []
    windows = [(int(first), int(last)) for first, last in arrays["windows"]]
    return CentreLines(
        dict(zip(frames, mm, strict=True)),
        dict(zip(frames, px, strict=True)),
        dict(zip(frames, windows, strict=True)),
    )


# A pair of numbers becomes two columns.
_PAIRS = {
    "radius_ci95_mm": ("radius_ci95_low_mm", "radius_ci95_high_mm"),
    "ci95_mm": ("ci95_low_mm", "ci95_high_mm"),
    "centre_mm": ("centre_y_mm", "centre_z_mm"),
    "tip_mm": ("tip_y_mm", "tip_z_mm"),
    "tip_px": ("tip_u_px", "tip_v_px"),
    "estimate_mm": ("estimate_y_mm", "estimate_z_mm"),
    "innovation_mm": ("innovation_y_mm", "innovation_z_mm"),
    "true_mm": ("true_y_mm", "true_z_mm"),
    "sheath_tip_mm": ("sheath_tip_y_mm", "sheath_tip_z_mm"),
    "entry_mm": ("entry_y_mm", "entry_z_mm"),
    "origin_mm": ("origin_y_mm", "origin_z_mm"),
    "tip_from_origin_mm": ("tip_aside_of_origin_mm", "tip_along_from_origin_mm"),
    "expected_mm": ("expected_y_mm", "expected_z_mm"),
}
# Spreadsheets take "+y" for a formula, and the centre says the same.
_LEFT_OUT = {"bend"}
# What a spreadsheet would take for the start of a formula.
_FORMULA_STARTS = ("=", "+", "-", "@", "\t", "\r")


def _csv(rows: Sequence[Model], model: type[Model]) -> bytes:
    """Return the table of the rows, one column a field, units in the names; what is unknown is empty."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    names = [name for name in model.model_fields if name not in _LEFT_OUT]
    writer.writerow([column for name in names for column in _PAIRS.get(name, (name,))])
    for row in rows:
        writer.writerow([cell for name in names for cell in _cells(name, getattr(row, name))])
    return text.getvalue().encode("utf-8")


def _cells(name: str, value: object) -> Sequence[object]:
    if name in _PAIRS:
        return value if isinstance(value, tuple) else (None, None)
    if isinstance(value, tuple):
        value = "; ".join(str(item) for item in value)
    if isinstance(value, str) and value.startswith(_FORMULA_STARTS):
        return (f"'{value}",)
    return (value,)
