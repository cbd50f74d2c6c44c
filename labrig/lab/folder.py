"""Finds the lab folder, and in it the folders that commands read and write."""

import os
from dataclasses import dataclass
from pathlib import Path

MARKER = ".labrig"
PROTOCOLS = Path("protocols")
CALIBRATION = Path("calibration")
RUNS = Path("data/runs")
SPECIMENS = Path("data/specimens")
COMPARISONS = Path("data/comparisons")
CAMPAIGNS = Path("data/campaigns")
PROTOCOL_SCHEMA = PROTOCOLS / "protocol.schema.json"
CAMPAIGN_SCHEMA = PROTOCOLS / "campaign.schema.json"
RIG_SCHEMA = CALIBRATION / "rig.schema.json"
SPECIMEN_SCHEMA = SPECIMENS / "specimen.schema.json"
RUNS_DIR_VARIABLE = "LABRIG_RUNS_DIR"


def is_lab_folder(folder: Path) -> bool:
    """Return whether a folder is that of a lab: marked as one, or with both schemas where labrig keeps them."""
    return _is_file(folder / MARKER) or all(
        _is_file(folder / schema) for schema in (PROTOCOL_SCHEMA, RIG_SCHEMA)
    )


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except OSError:  # a folder above that this account may not read
        return False


def find_lab_folder(start: Path = Path()) -> Path | None:
    """Return the nearest lab folder that is or holds `start`, relative to the working folder; None if there is none."""
    try:
        here = start.resolve()
        found = next((folder for folder in (here, *here.parents) if is_lab_folder(folder)), None)
        return None if found is None else Path(os.path.relpath(found))
    except FileNotFoundError:  # the working folder has been deleted
        return None


def find_in_lab(path: Path) -> Path:
    """Return a path that is relative to the lab folder; without a lab folder, relative to the working folder."""
    lab = find_lab_folder()
    return path if lab is None else lab / path


@dataclass(frozen=True)
class RunsDir:
    """The folder of the runs, and what decided that: the end of a sentence, for people."""

    path: Path
    reason: str


def choose_runs_dir(given: Path | None = None) -> RunsDir:
    """Return the folder of the runs.

    Parameters
    ----------
    given : Path or None
        The folder that `--runs-dir` names, if it does.
    """
    if given is not None:
        return RunsDir(given, "as --runs-dir says")
    named = os.environ.get(RUNS_DIR_VARIABLE)
    if named:
        return RunsDir(Path(named), f"as {RUNS_DIR_VARIABLE} says")
    lab = find_lab_folder()
    if lab is None:
        return RunsDir(RUNS, "below the working folder, as no lab folder is here or above")
    return RunsDir(lab / RUNS, f"in the lab folder {lab.resolve()}")
