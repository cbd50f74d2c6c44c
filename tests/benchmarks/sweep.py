"""The sweep of 72 insertions: time, memory, accuracy against the drawn truth, and identity of two short ones."""

import hashlib
import json
import math
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from tests.benchmarks.table import FinishedCommand, measure, print_rows

ROOT = Path(__file__).parents[2]


def print_table() -> None:
    """Run the sweep and print its figures, and whether two of an insertion a gel have the same bytes."""
    with tempfile.TemporaryDirectory() as folder:
        measured, document = _sweep(Path(folder) / "whole")
        short = [_sweep(Path(folder) / name, "--set", "insertions_per_specimen=1")[1] for name in ("a", "b")]
        truth = pd.read_json(Path(document["run"]) / "truth.jsonl", lines=True).set_index("trial")
        rows = [
            ["wall time, s", f"{measured.wall_s:.1f}", "60"],
            ["peak memory, MB (pss, all processes)", f"{measured.peak_mb:.0f}", "600"],
            *_list_accuracy(document["result"], truth),
        ]
        print_rows(("figure", "measured", "limit"), rows)
        print_rows(
            ("gel", "n", "mean mm", "drawn mean mm", "difference mm", "limit"),
            _list_means(document["result"], truth),
        )
        same = len({_digest(Path(each["run"])) for each in short}) == 1
        print(f"an insertion a gel, same seed: frames, states and events {'identical' if same else 'DIFFER'}")


def _sweep(runs_dir: Path, *settings: str) -> tuple[FinishedCommand, dict[str, Any]]:
    protocol, rig = ROOT / "protocols" / "steerability.yaml", ROOT / "calibration" / "rig-simulated.yaml"
    files = [str(protocol), "--rig", str(rig), "--runs-dir", str(runs_dir)]
    measured = measure([sys.executable, "-m", "labrig", "run", *files, *settings, "--json"], memory=True)
    return measured, json.loads(measured.out)


def _list_accuracy(result: dict[str, Any], truth: pd.DataFrame) -> list[list[str]]:
    """Return the errors of radii and of sheaths, and how many are refused."""
    finals = [line for line in result["measurements"] if line["role"] == "final"]
    accepted = [line for line in finals if line["accepted"]]
    true_mm = truth["radius_mm"].loc[[line["trial"] for line in accepted]].to_numpy()
    errors = np.array([line["radius_mm"] for line in accepted]) - true_mm
    low_mm, high_mm = np.transpose([line["radius_ci95_mm"] for line in accepted])
    held = ((low_mm <= true_mm) & (true_mm <= high_mm)).sum()
    origins = result["origins"]
    off_mm = [math.dist(line["tip_mm"], truth["sheath_tip_mm"][line["trial"]]) for line in origins]
    return [
        ["worst error of a picture, mm", f"{np.abs(errors).max():.3f}", "0.25"],
        ["mean error of the pictures, mm", f"{errors.mean():+.4f}", "-"],
        [f"refused, of {len(finals)}", str(len(finals) - len(accepted)), "1"],
        [f"95 % intervals that hold the truth, of {len(errors)}", str(held), "-"],
        ["sheath's tip found, worst error mm", f"{max(off_mm):.3f}", "0.05"],
        [f"sheaths refused, of {len(origins)}", str(sum(not line["accepted"] for line in origins)), "0"],
    ]


def _list_means(result: dict[str, Any], truth: pd.DataFrame) -> list[list[str]]:
    drawn_mm, rows = truth.groupby("specimen")["radius_mm"].mean(), []
    for specimen in result["specimens"]:
        mean_mm, true_mm = specimen["mean_radius_mm"], drawn_mm[specimen["name"]]
        found = (f"{mean_mm:.3f}", f"{true_mm:.3f}", f"{mean_mm - true_mm:+.4f}")
        rows.append([specimen["name"], str(specimen["n"]), *found, "0.05"])
    return rows


def _digest(run: Path) -> str:
    digest = hashlib.sha256()
    for path in [*sorted((run / "frames").iterdir()), run / "states.jsonl", run / "events.jsonl"]:
        digest.update(path.name.encode() + path.read_bytes())
    return digest.hexdigest()
