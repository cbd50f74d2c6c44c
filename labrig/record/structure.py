"""Check that the lines of a record fit together: numbers in order, a clock that advances, valid references."""

import math
from collections.abc import Iterator, Sequence
from pathlib import Path

from labrig.errors import Problem
from labrig.record.layout import (
    EVENT_LINES,
    FRAME_LINES,
    RAW_PICTURES,
    SKIP,
    TRIAL_START,
    TRIAL_STOP,
    TRUTH_LINES,
    picture_file,
)
from labrig.record.pictures import locate_picture

Lines = Sequence[tuple[int, dict[str, object]]]
"""The lines of a file with their numbers."""

_HINT = "take the file from a copy of the run; a record does not become like this by being interrupted"


def find_clock_problems(name: str, lines: Lines) -> Iterator[Problem]:
    """Yield the lines whose rig time is invalid or earlier than that of the line before."""
    before_s = -math.inf
    for number, line in lines:
        t_s = line.get("t_s")
        if isinstance(t_s, bool) or not isinstance(t_s, int | float) or not math.isfinite(t_s):
            yield Problem(f"{name}:{number}", f"t_s is {t_s!r}, expected a time [s]", _HINT)
        elif t_s < before_s:
            message = f"the clock goes backwards: t_s is {t_s:g} s after {before_s:g} s"
            yield Problem(f"{name}:{number}", message, _HINT)
        else:
            before_s = t_s


def find_frame_problems(frames: Lines) -> Iterator[Problem]:
    """Yield the pictures whose number is duplicate, out of order or skips some, or whose file is not theirs."""
    expected = 0
    listed: set[int] = set()
    for number, line in frames:
        where, frame = f"{FRAME_LINES}:{number}", line.get("frame")
        if isinstance(frame, bool) or not isinstance(frame, int):
            yield Problem(where, f"frame is {frame!r}, expected {expected}", _HINT)
        elif frame in listed:
            yield Problem(where, f"frame {frame} is there twice", _HINT)
        else:
            if frame != expected:
                message = f"frame is {frame}, expected {expected}: {_describe_gap(expected, frame)}"
                yield Problem(where, message, _HINT)
            if locate_picture(Path(), line) is None:
                expected_file = f"{picture_file(frame)!r}, or {RAW_PICTURES!r} with offset and shape"
                yield Problem(where, f"file is {line.get('file')!r}, expected {expected_file}", _HINT)
            listed.add(frame)
            expected = frame + 1


def _describe_gap(expected: int, frame: int) -> str:
    if frame < expected:
        return "it is out of order"
    missing = frame - expected
    return f"frame {expected} is missing" if missing == 1 else f"frames {expected} to {frame - 1} are missing"


def find_trial_problems(events: Lines) -> Iterator[Problem]:
    """Yield the trials that begin twice, end twice, or end without having begun."""
    begun: set[object] = set()
    ended: set[object] = set()
    for number, event in events:
        where, kind, trial = f"{EVENT_LINES}:{number}", event.get("kind"), _read_trial(event)
        if kind == TRIAL_START:
            if trial in begun:
                yield Problem(where, f"trial {trial} begins a second time", _HINT)
            begun.add(trial)
        elif kind == TRIAL_STOP:
            if trial not in begun or trial in ended:
                how = "a second time" if trial in ended else "without having begun"
                yield Problem(where, f"trial {trial} ends {how}", _HINT)
            ended.add(trial)


def find_reference_problems(events: Lines, frames: Lines, truth: Lines) -> Iterator[Problem]:
    """Yield events whose picture is missing or of another trial, and pictures and truths of trials that never began.

    A picture may be taken for the next trial, and the run end, or a person skip it, before that begins. Any event may
    name a picture without a trial: a search for the roll zero numbers its holes as trials. Only the final picture must
    belong to its trial.
    """
    trial_of = {str(line.get("frame")): _read_trial(line) for _, line in frames}
    begun = {_read_trial(event) for _, event in events if event.get("kind") in {TRIAL_START, SKIP}}
    for number, event in events:
        for key in ("frame", "final_frame"):
            if (frame := event.get(key)) is not None:
                yield from _check_frame_reference(f"{EVENT_LINES}:{number}", key, frame, event, trial_of)
    ahead = begun | {None, 1 + max((trial for trial in begun if isinstance(trial, int)), default=-1)}
    for name, lines, trials in ((FRAME_LINES, frames, ahead), (TRUTH_LINES, truth, begun | {None})):
        for number, line in lines:
            if (trial := _read_trial(line)) not in trials:
                yield Problem(f"{name}:{number}", f"it is of trial {trial}, which never began", _HINT)


def _check_frame_reference(
    where: str, key: str, frame: object, event: dict[str, object], trial_of: dict[str, int | str | None]
) -> Iterator[Problem]:
    if str(frame) not in trial_of:
        yield Problem(where, f"{key} is {frame!r}, which is not in {FRAME_LINES}", _HINT)
        return
    trial = trial_of[str(frame)]
    of_any_trial = trial is None and key == "frame"
    if "trial" in event and not of_any_trial and trial != _read_trial(event):
        yield Problem(
            where, f"{key} {frame} is of trial {trial}, the event of trial {_read_trial(event)}", _HINT
        )


def _read_trial(line: dict[str, object]) -> int | str | None:
    """Return the trial of a line in a form that can be compared, whatever the line holds."""
    trial = line.get("trial")
    return trial if trial is None or isinstance(trial, int) else str(trial)
