"""What is computed in each environment and compared: `python -m tests.processors.probes FILE` writes it as JSON.

A probe returns cases. To compare more, write another and add it to `PROBES`.
"""

import json
import math
import os
import shutil
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from labrig.analysis.run import analyze_run
from labrig.campaign.tasks import compute_task
from labrig.experiments.hinge_design.protocol import DesignTolerances
from labrig.experiments.registry import find_run_experiment, load_run_protocol
from labrig.record.provenance import describe_processor
from labrig.record.reader import open_run
from labrig.runner.replay import replay_run
from tests.analysis.synthetic import NOW, PROVENANCE
from tests.campaign.campaigns import RIGS, load, write_campaign

RECORDS = Path(__file__).parents[1] / "records"
Document = Mapping[str, Any]
Numbers = Mapping[str, Sequence[tuple[float, float]]]
"""Quantity -> values, each with the sigma that is stated of it."""


@dataclass(frozen=True)
class Case:
    """Something that was computed: what was decided in it, in words, and its numbers.

    Numbers are compared where the same was decided.
    """

    name: str
    decided: str
    numbers: Numbers


def measure_kept_records() -> Iterator[Case]:
    """Measure each kept record once more."""
    with tempfile.TemporaryDirectory() as folder:
        for record in sorted(path for path in RECORDS.iterdir() if path.is_dir()):
            run = open_run(Path(shutil.copytree(record, Path(folder) / record.name)))
            result = analyze_run(run, find_run_experiment(run), created=NOW, provenance=PROVENANCE).document
            yield _READERS[result["kind"]](f"record {record.name}", result)


def _read_calibration(name: str, result: Document) -> Case:
    lens, plane = result["intrinsics"], result["plane"]
    sigma, crossing_mm = lens["sigma"], plane["rms_mm"]
    numbers = {
        "focal length [px]": [(lens[key], sigma[key]) for key in ("fx", "fy")],
        "centre [px]": [(lens[key], sigma[key]) for key in ("cx", "cy")],
        "distortion": [
            (value, sigma[key])
            for key, value in zip(("k1", "k2", "p1", "p2", "k3"), lens["distortion"], strict=True)
        ],
        "corner [px]": [
            (value, lens["rms_px"])
            for corners in result["corners"].values()
            for corner in corners
            for value in corner
        ],
        "plane [mm]": [(value, crossing_mm) for value in _map_corners(plane)],
        "flatness of paper [mm]": [(plane["flatness_mm"], crossing_mm)],
    }
    decided = [(view["image"], view["used"], view["reason"]) for view in lens["views"]]
    return Case(name, str((result["accepted"], result["reasons"], decided, plane["points"])), numbers)


def _map_corners(plane: Document) -> Iterator[float]:
    """Yield where the homography puts the corners of the picture [mm]."""
    width_px, height_px = plane["image_size"]
    for u, v in ((0, 0), (width_px, 0), (0, height_px), (width_px, height_px)):
        y, z, scale = (row[0] * u + row[1] * v + row[2] for row in plane["homography"])
        yield from (y / scale, z / scale)


def _read_roll_zero(name: str, result: Document) -> Case:
    fit = result["fit"]
    residual_mm = fit["residual_rms_mm"]
    numbers = {
        "roll zero [rad]": [(fit["zero_rad"], fit["sd_rad"])],
        "deflection [mm]": [(value, residual_mm) for value in (*result["deflections_mm"], fit["bend_mm"])],
    }
    return Case(name, str((result["accepted"], result["reasons"])), numbers)


def _read_curvature(name: str, result: Document) -> Case:
    rows = result["measurements"]
    measured = [row for row in rows if row["accepted"]]
    numbers = {
        "radius [mm]": [(row["radius_mm"], row["sigma_radius_mm"]) for row in measured],
        "end of shaft [mm]": [
            (value, math.hypot(*(part for part in row["tip_budget_mm"].values() if part)))
            for row in measured
            for value in (*row["tip_mm"], row["arc_length_mm"])
        ],
    }
    return Case(name, str([(row["frame"], row["accepted"], row["reason"]) for row in rows]), numbers)


def _read_insertion(name: str, result: Document) -> Case:
    (insertion,) = result["insertions"]
    seen = [step for step in insertion["steps"] if step["tip_mm"] and step["estimate_mm"]]
    error = (insertion["target_error_mm"], insertion["sigma_target_error_mm"])
    numbers = {
        "target error [mm]": [error, *((value, error[1]) for value in insertion["tip_mm"])],
        "sighting [mm]": [(value, step["position_sd_mm"]) for step in seen for value in step["tip_mm"]],
        "estimate [mm]": [(value, step["position_sd_mm"]) for step in seen for value in step["estimate_mm"]],
        "heading [rad]": [(step["heading_rad"], step["heading_sd_rad"]) for step in seen],
    }
    decided = [
        insertion["outcome"],
        insertion["stop"],
        [(step["believed"], step["reason"]) for step in insertion["steps"]],
    ]
    return Case(name, str(decided), numbers)


def _read_design(name: str, result: Document) -> Case:
    search = result["search"]
    cut_deg = DesignTolerances().cut_deg
    numbers = {
        "angle of hinge [deg]": [
            *((cell[key], cut_deg) for cell in result["cells"] for key in ("beta_a_deg", "beta_b_deg")),
            *((search[key], cut_deg) for key in ("beta_cut_deg", "beta_rot_deg")),
        ]
    }
    return Case(name, str((result["accepted"], search["inside_grid"], search["reason"])), numbers)


_READERS: Mapping[str, Callable[[str, Document], Case]] = {
    "calibration": _read_calibration,
    "roll-zero": _read_roll_zero,
    "curvature": _read_curvature,
    "insertion": _read_insertion,
    "design": _read_design,
}


def repeat_insertions() -> Iterator[Case]:
    """Compute virtual insertions: past the obstacles of the example, and shorter ones in a world of hard gel."""
    short = {"target.position_mm": [0, 6, 60], "obstacles": []}
    with tempfile.TemporaryDirectory() as folder:
        for rig, repetitions, settings in (("rig-reference", 6, {}), ("rig-hard", 6, short)):
            file = write_campaign(Path(folder), repetitions=repetitions, depth="world", set=settings)
            loaded = load(file, RIGS / f"{rig}.yaml")
            for task in loaded.list_tasks():
                outcome = compute_task(task)
                sd_mm = task.arm.protocol.model_dump()["estimator"]["observation_sd_mm"]
                values = outcome.values
                counts = {key: value for key, value in values.items() if isinstance(value, int)}
                numbers = {
                    "virtual insertion [mm]": [
                        (value, sd_mm) for value in values.values() if isinstance(value, float)
                    ]
                }
                decided = str((outcome.exit_status, outcome.reason, counts))
                yield Case(f"insertion {task.number} on {rig}", decided, numbers)


def replay_records() -> Iterator[Case]:
    """Replay the kept records that a procedure made, and the example protocols."""
    kept = [path for path in RECORDS.iterdir() if path.is_dir() and path.name != "import"]
    for record in sorted(kept):
        yield _replay(f"replay {record.name}", record)
    for folder in sorted(Path(os.environ[EXAMPLES]).iterdir()):
        yield _replay(f"{EXAMPLE} {folder.name}", folder / "run")


def _replay(name: str, record: Path) -> Case:
    """Return by what share of its tolerance, a tenth of a sigma or more, a replay differs at most."""
    run = open_run(record)
    found = replay_run(run, find_run_experiment(run), load_run_protocol(run), lambda _done, _doing: None)
    first = found.first_difference
    share = max(found.agreement.shares.values(), default=0.0)
    decided = "agrees" if first is None else f"different: {first.path}"
    return Case(name, decided, {REPLAYED: [(share, _WHOLE)]})


EXAMPLES, EXAMPLE = "LABRIG_EXAMPLES", "example"
"""The variable that names the folder of the recorded example protocols, and how the names of their cases begin."""

REPLAYED = "replay [share of tolerance]"
_WHOLE = 100.0
"""Makes a whole tolerance one hundredth of a sigma, which is what numbers may differ by here."""

PROBES: tuple[Callable[[], Iterator[Case]], ...] = (measure_kept_records, replay_records, repeat_insertions)


def write_cases(path: Path, probes: Iterable[Callable[[], Iterator[Case]]]) -> None:
    """Write the kernels of this process, and all cases of some probes."""
    cases = [asdict(case) for probe in probes for case in probe()]
    found = {"processor": dict(describe_processor()), "cases": cases}
    path.write_text(json.dumps(found), encoding="utf-8")


if __name__ == "__main__":
    write_cases(Path(sys.argv[1]), PROBES)
