"""Who attends a run: is told how it goes, answers its questions, and may pause or stop it."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NoReturn, TypeAlias

from labrig.devices.opening import Opening
from labrig.devices.operator import NO_OFFER, Offer, OperatorRequest
from labrig.devices.rig import Rig, open_rig
from labrig.devices.rig_file import RigDescription
from labrig.errors import InputError
from labrig.runner.dialogue import PauseRequests
from labrig.runner.session import Progress

Interrupted: TypeAlias = Callable[[], str | None]
"""Returns the name of a signal that has arrived, if one has."""


class Attendant:
    """A program attends: nothing is shown, and a rig that asks a person is refused.

    The command line derives one for the person at the terminal.
    """

    def say(self, text: str) -> None:
        """Tell what happens."""

    @contextmanager
    def progress(self, title: str, total: float, lasts_s: float = 0.0) -> Iterator[Progress]:  # noqa: ARG002
        """Take how much of the total is done; `lasts_s` is how long it takes at a bench's pace, 0 if not known."""
        yield lambda _done, _doing: None

    @contextmanager
    def open_rig(
        self, rig: RigDescription, doing: str, seed: int, opening: Opening
    ) -> Iterator[tuple[Rig, Interrupted]]:
        """Open a rig, and give it with what tells of a signal, also after the block.

        Raises
        ------
        InputError
            When the rig asks a person.
        LabrigError
            As `labrig.devices.rig.open_rig`; nothing has moved.
        """
        if rig.asks_person:
            raise InputError(f"rig {rig.name} asks a person", "make the run at a terminal: labrig run")
        with open_rig(
            rig, seed=seed, person=_Nobody(), interrupted=_never, doing=doing, opening=opening
        ) as opened:
            yield opened, _never

    @contextmanager
    def take_requests(
        self,
        interrupted: Interrupted,  # noqa: ARG002
        run: Path,  # noqa: ARG002
    ) -> Iterator[PauseRequests]:
        """Take requests to pause the run during the block."""
        yield PauseRequests()

    @contextmanager
    def watch(self) -> Iterator[Callable[[Path], None]]:
        """Give the call that shows a run from when its record is open."""
        yield lambda _path: None


def _never() -> None:
    """No signal is noted: it is raised wherever the program is."""


class _Nobody:
    """Stands where a person would: a simulated rig answers by itself."""

    def ask(
        self,
        request: OperatorRequest,
        meanwhile: Callable[[], None],  # noqa: ARG002
        offer: Offer = NO_OFFER,  # noqa: ARG002
    ) -> NoReturn:
        """Refuse a request."""
        raise InputError(f"nobody is there to answer: {request.text}", "make the run at a terminal")
