"""What an analysis is given and what it hands over, whatever the experiment."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol, TypeAlias

from labrig.analysis.pictures import Analysis, Progress
from labrig.analysis.result import Findings, Result, Stamp
from labrig.analysis.workers import DEFAULT_WORKERS
from labrig.protocol.sections import ExperimentProtocol
from labrig.vision.mask import Mask


@dataclass(frozen=True)
class AnalysisRequest:
    """How a run is to be analysed.

    Attributes
    ----------
    stamp : Stamp
        What every result carries.
    mask : Mask or None
        Pixels that are not the needle.
    workers : int
        Processes that an analysis may use by itself; one that asks for pictures needs none.
    progress : callable or None
        Called with how much is done, and how much there is.
    """

    stamp: Stamp
    mask: Mask | None = None
    workers: int = DEFAULT_WORKERS
    progress: Progress | None = None


Analyze: TypeAlias = Callable[[Any, Any, AnalysisRequest], Findings | Analysis[Findings]]
"""(run, protocol, request) -> findings; a generator where pictures can be measured one by one, in any process."""


class MeasuredExperiment(Protocol):
    """What the engine needs to know of an experiment."""

    @property
    def name(self) -> str:
        """What a protocol file has behind `experiment:`."""
        ...

    @property
    def protocol_model(self) -> type[ExperimentProtocol]:
        """The model of its protocol."""
        ...

    @property
    def result_model(self) -> type[Result]:
        """The model of its result."""
        ...

    @property
    def reanalysis_keys(self) -> tuple[str, ...]:
        """Sections of the protocol that a reanalysis may change."""
        ...

    @property
    def analyze(self) -> Analyze:
        """The function that makes a result of a run."""
        ...
