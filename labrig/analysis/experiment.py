"""The interface between the analysis engine and an experiment."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, cast

from labrig.analysis.engine import DEFAULT_WORKERS
from labrig.analysis.pictures import Progress
from labrig.analysis.result import Result
from labrig.protocol.sections import ExperimentProtocol
from labrig.vision.picture import Mask


@dataclass(frozen=True)
class AnalysisRequest:
    """How a run is to be analysed.

    Attributes
    ----------
    stamp : Result
        What every result has, before anything is measured.
    mask : Mask or None
        Pixels that are not the needle.
    workers : int
        Processes that an analysis may use.
    progress : callable or None
        Called with how much is done, and how much there is.
    """

    stamp: Result
    mask: Mask | None = None
    workers: int = DEFAULT_WORKERS
    progress: Progress | None = None


class MeasuredExperiment(ABC):
    """What the engine needs to know of an experiment; its parts are imported on first use.

    `name` is the value of `experiment:` in a protocol file, and `reanalysis_keys` are the sections, or keys, of it that
    a reanalysis may change.
    """

    name: str
    reanalysis_keys: tuple[str, ...]

    @abstractmethod
    def find_part(self, name: str) -> Any:
        """Return a part; None if it has none."""

    @abstractmethod
    def part(self, name: str) -> Any:
        """Return a part, or its default. Raises `InputError` when it has none."""

    @abstractmethod
    def call(self, code: Callable[[], Any], more: str = "") -> Any:
        """Return what code of its package returns; what that raises by mistake is blamed on it, with file and line.

        `more` ends the hint.
        """

    @property
    def protocol_model(self) -> type[ExperimentProtocol]:
        """The model of its protocol."""
        return cast("type[ExperimentProtocol]", self.part("Protocol"))


@dataclass(frozen=True)
class TaskOutcome:
    """What came of one task: how it ended, and its quantities.

    Attributes
    ----------
    exit_status : str
        success, failed or aborted, as in the manifest of a run.
    reason : str or None
        As in the manifest, such as target_missed or blocked; None for a success.
    values : mapping of str to float, int, bool, str or None
        Quantities by name, units in the names; None where one has no value.
    """

    exit_status: str
    reason: str | None
    values: Mapping[str, float | int | bool | str | None]
