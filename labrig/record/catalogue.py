"""Lists the runs of a folder."""

from dataclasses import dataclass
from pathlib import Path

from labrig.errors import InputError, RecordError
from labrig.record.json_lines import read_lines
from labrig.record.layout import EVENT_LINES, MANIFEST, inside
from labrig.record.manifest import is_newer, read_document, read_manifest


@dataclass(frozen=True)
class RunSummary:
    """One run in a list; what a damaged run does not tell is None.

    Attributes
    ----------
    run : Path
        Its folder.
    protocol : str
        Which experiment: `steerability`, `camera-calibration`, `import` ...
    exit_status : str
        `success`, `aborted`, `failed`, `incomplete`; `newer`, where a newer labrig wrote the run; or `damaged`,
        where the manifest or the events cannot be read.
    started : str
        When, ISO 8601 in UTC.
    trials_done, trials_planned : int
        Trials that came to their end, and those that the protocol asks for; where the first is unknown, so is the
        second.
    """

    run: Path
    protocol: str | None
    exit_status: str
    started: str | None
    trials_done: int | None
    trials_planned: int | None


def list_runs(runs_dir: Path) -> list[RunSummary]:
    """List the runs of a folder, newest first; damaged ones at the end, other folders and links not at all.

    Parameters
    ----------
    runs_dir : Path
        Folder of runs. One that does not exist yet has none.

    Raises
    ------
    InputError
        When it is a file, or cannot be read.
    """
    try:
        folders = [
            folder
            for folder in runs_dir.iterdir()
            if not folder.is_symlink() and (folder / MANIFEST).is_file()
        ]
    except FileNotFoundError:
        return []
    except OSError as error:
        raise InputError(f"cannot list {runs_dir}: {error.strerror}", "give a folder of runs") from error
    return sorted(map(_summary, sorted(folders)), key=lambda summary: summary.started or "", reverse=True)


def _summary(run: Path) -> RunSummary:
    try:
        document = read_document(run)
        if is_newer(document):
            # Its other members may mean something else by now.
            return RunSummary(run, _text(document.get("experiment")), "newer", None, None, None)
        return _intact_summary(run, read_manifest(run))
    except RecordError:
        return RunSummary(run, None, "damaged", None, None, None)


def _intact_summary(run: Path, manifest: dict[str, object]) -> RunSummary:
    exit_status = str(manifest.get("exit_status"))
    done = _trials_done(run) if exit_status == "incomplete" else _whole(manifest.get("trials_done"))
    planned = _whole(manifest.get("trials_planned"))
    return RunSummary(
        run=run,
        protocol=_text(manifest.get("experiment")),
        exit_status=exit_status,
        started=_text(manifest.get("started")),
        trials_done=done,
        trials_planned=None if done is None else planned,
    )


def _trials_done(run: Path) -> int:
    """Count the trials of a run whose manifest was not brought up to date."""
    events = read_lines(inside(run, EVENT_LINES))
    return sum(
        event.get("kind") == "trial_stop" and event.get("exit_status") == "success" for event in events
    )


def _text(value: object) -> str | None:
    return value if isinstance(value, str) else None


def _whole(value: object) -> int | None:
    return value if isinstance(value, int) else None
