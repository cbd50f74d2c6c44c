"""Finds the rig that a protocol runs on, and opens it for the person at the terminal."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager

from labrig.cli.output import say
from labrig.cli.pausing import may_pause
from labrig.cli.signals import SignalNote, note_signals
from labrig.cli.terminal_operator import TerminalOperator
from labrig.devices.opening import Opening
from labrig.devices.rig import Rig, open_rig
from labrig.devices.rig_file import RigDescription


def remark_on_yes(description: RigDescription, *, yes: bool) -> None:
    """Say that `--yes` answers no question that a person is asked."""
    if yes and description.asks_person:
        say("note: --yes answers only for a simulated rig without clock: real; every question is asked")


@contextmanager
def open_rig_for_person(
    description: RigDescription,
    doing: str,
    *,
    seed: int = 0,
    opening: Opening | None = None,
    pauses: bool = False,
) -> Iterator[tuple[Rig, SignalNote]]:
    """Open a rig for the person at the terminal, who is asked the questions; a signal stops the axes first.

    Parameters
    ----------
    doing : str
        What the rig is used for; another labrig that wants the rig prints it.
    seed : int
        Seed of every random draw of a simulated world.
    opening : Opening or None
        What of the rig to open, and how; None: all of it.
    pauses : bool
        Whether the first Ctrl+C at a terminal pauses, and the bell calls the person; otherwise it stops.

    Yields
    ------
    Rig, SignalNote
        The rig, and the note of a signal that has arrived; ask the note again after the block.

    Raises
    ------
    LabrigError
        As `open_rig`; nothing has moved.
    """
    with (
        note_signals(lambda: pauses and may_pause()) as interrupted,
        open_rig(
            description,
            seed=seed,
            person=TerminalOperator(interrupted, sys.stdin, rings=pauses),
            interrupted=interrupted,
            doing=doing,
            opening=opening or Opening(),
            alert=say,
        ) as rig,
    ):
        yield rig, interrupted
