"""Requests from another terminal to the labrig that makes a run: pause, and continue.

The run listens on a Unix socket in its folder while it is made, and polls it without a thread. Only the account that
makes the run may connect. What a killed labrig leaves of it is replaced when the run is resumed.
"""

import json
import platform
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from labrig.errors import InputError, MachineError
from labrig.input_file import parse_json
from labrig.posix import LineSocket, Listener, connect
from labrig.record.layout import run_control, run_lock
from labrig.record.lock import read_lock_owner
from labrig.record.manifest import read_manifest

Order = Literal["pause", "continue"]

_ANSWERED_WITHIN_S = 10.0
"""Longer than the longest computation of a run on a slow computer; requests are looked for between two of them."""

_MOST_CALLERS = 8
"""Most callers that have connected but sent nothing; beyond that the oldest are dropped."""


@dataclass(frozen=True)
class _Reply:
    """The reply to a request: whether it is granted, and a sentence."""

    granted: bool
    text: str


class RunControl:
    """Takes the requests to one run; the caller holds the run's lock.

    Parameters
    ----------
    run : Path
        Its folder.

    Raises
    ------
    DiskError
        When no socket can be made there.
    """

    def __init__(self, run: Path) -> None:
        self._listener = Listener(run_control(run))
        self._callers: list[LineSocket] = []
        self.asks_for_pause = self.asks_to_continue = False

    def poll(self, when: str, *, paused: bool) -> None:
        """Take what has arrived, without waiting, and answer it; `when` says when a pause would begin."""
        self._accept_callers()
        for caller in tuple(self._callers):
            line = caller.receive(0.0)
            if line is None:
                continue
            reply = self._obey(line, when, paused=paused)
            caller.send(json.dumps({"granted": reply.granted, "text": reply.text}))
            caller.close()
            self._callers.remove(caller)

    def _obey(self, line: str, when: str, *, paused: bool) -> _Reply:
        match line:
            case "pause" if paused:
                return _Reply(granted=True, text="the run is paused already")
            case "pause":
                self.asks_for_pause = True
                return _Reply(granted=True, text=f"the run pauses {when}")
            case "continue" if paused:
                self.asks_to_continue = True
                return _Reply(granted=True, text="the run continues")
            case "continue" if self.asks_for_pause:
                self.asks_for_pause = False
                return _Reply(granted=True, text="the pause that was asked for is taken back")
        return _Reply(granted=False, text="the run is not paused")

    def _accept_callers(self) -> None:
        for _ in range(_MOST_CALLERS):
            caller = None if self._listener is None else self._listener.accept()
            if caller is None:
                return
            self._callers.append(caller)
            if len(self._callers) > _MOST_CALLERS:
                self._callers.pop(0).close()

    def meet(self) -> None:
        """Forget the requests so far."""
        self.asks_for_pause = self.asks_to_continue = False

    def close(self) -> None:
        """Stop listening."""
        for caller in self._callers:
            caller.close()
        if self._listener is not None:
            self._listener.close()


def ask_run(run: Path, order: Order) -> str:
    """Ask the labrig that makes a run to pause or to continue; return its answer as a sentence.

    Raises
    ------
    RecordError
        When the folder is no run, or the place of its socket is a link.
    InputError
        When the run is over or made on another computer, or cannot do it.
    MachineError
        When labrig does not answer.
    """
    ended = read_manifest(run).get("exit_status")
    owner = read_lock_owner(run_lock(run))
    if owner is None or ended not in {"incomplete", None}:
        how = "was interrupted" if ended in {"incomplete", None} else f"has ended: {ended}"
        raise InputError(f"{run} is not being made: it {how}", "labrig runs lists the runs that are going on")
    if owner.host != platform.node():
        raise InputError(
            f"{run} is made on {owner.host}, and this is {platform.node()}", f"ask for it on {owner.host}"
        )
    caller = connect(run_control(run))
    if caller is None:
        raise InputError(
            f"{run} takes no requests: it is made by {owner}",
            "only labrig run and resume can be paused, and only by the account that began them",
        )
    try:
        caller.send(order)
        reply = _parse_reply(caller.receive(_ANSWERED_WITHIN_S))
    finally:
        caller.close()
    if reply is None:
        raise MachineError(
            f"{run} did not answer within {_ANSWERED_WITHIN_S:g} s; it is made by {owner}",
            "ask again; in an emergency: labrig devices stop --rig FILE",
        )
    if not reply.granted:
        raise InputError(f"{run}: {reply.text}", "labrig pause RUN pauses it")
    return reply.text


def _parse_reply(line: str | None) -> _Reply | None:
    try:
        document: Any = parse_json((line or "").encode())
    except ValueError:
        return None
    if not isinstance(document, dict) or not isinstance(document.get("granted"), bool):
        return None
    return _Reply(document["granted"], str(document.get("text", "")))
