"""The campaign file: a base protocol, what is varied, how often it is repeated, and when it stops."""

import json
import math
import re
from collections.abc import Iterable, Sequence
from itertools import chain
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field

from labrig.protocol.model import Conflict, Line, Model, Name, PositiveMm, Seed
from labrig.protocol.schema import JsonSchema, model_schema
from labrig.protocol.yaml_file import load_yaml_model

FolderName = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]*$", max_length=64)]
Key = Annotated[str, Field(min_length=1, max_length=200)]
FileName = Annotated[str, Field(min_length=1, max_length=200)]
Values = Annotated[tuple[Any, ...], Field(min_length=1, max_length=1000)]
Range = tuple[float, float]

MOST_ARMS = 1000
MOST_TASKS = 10_000_000
_LEAST_TO_JUDGE = 30
"""Repetitions: the interval of a mean of fewer may be narrow by chance, and a rule that looks at it stops too early."""
_LOOK_AGAIN = 1.25
"""Ratio of the numbers of repetitions at which a rule looks."""

_OF_PICTURES = re.compile(
    r"(max_current_ma|ask_when|stop_when|sentinel"
    r"|rig\.(camera(?!\.(width|height)_px)|can|faults|calibration\.(template|mask)"
    r"|recording\.(fsync_period_s|least_free_mb)"
    r"|world\.(light|blur_px|noise_sd|bubbles_per_specimen|ignores|markers|needle\.(bevel_deg|link_mm))))(\..+)?"
)
"""Keys that change nothing without pictures; the size of a picture is that of the world's lens, which does."""

_OTHER_KINDS = {
    "experiment": ("this is a protocol, expected a campaign file", "labrig run THIS_FILE"),
    "axes": ("this is a rig file, expected a campaign file", "name it in a campaign as rig: FILE"),
}


class Sample(Model):
    """Points drawn in a range of each key, the same for every arm."""

    method: Literal["latin-hypercube", "sobol"]
    """How the points fill the ranges; sobol takes a power of two."""
    n: int = Field(ge=1, le=1_000_000)
    """Number of points."""
    keys: dict[Key, Range] = Field(min_length=1)
    """Dotted key -> [lowest, highest]; rig.* is of the rig."""

    def conflicts(self) -> Iterable[Conflict]:
        """Yield empty ranges, and a number of points that leaves gaps in a Sobol sequence."""
        for key, (low, high) in self.keys.items():
            if low >= high:
                yield Conflict(f"keys.{key}", f"the range is empty, {low:g} must be below {high:g}")
        if self.method == "sobol" and self.n & (self.n - 1):
            below = 1 << (self.n.bit_length() - 1)
            yield Conflict("n", f"n is {self.n}, no power of two", f"take {below} or {2 * below}")


class StopWhen(Model):
    """The end of a campaign, fixed beforehand: the mean of every arm is known well enough."""

    ci95_width_mm: PositiveMm
    """Width of the 95 % interval of each arm's mean [mm]."""
    at_most: int = Field(ge=1, le=MOST_TASKS)
    """Number of repetitions, even if it is wider."""


class CampaignFile(Model):
    """What a campaign repeats, and what it varies.

    Each combination of an entry of `arms` and of one value for each key of `vary` is an arm. Each arm is repeated at
    each point of `sample`. All arms have the same seeds, so that differences between arms are not those of their draws.
    """

    schema_version: Literal[1] = 1
    """Version of this file format; a higher one needs a newer labrig."""
    campaign: FolderName
    """Name of the campaign, and of the folder of its table."""
    title: Line = ""
    """Heading of the report."""
    base: FileName
    """Protocol that is repeated; relative to this file."""
    rig: FileName | None = None
    """Rig file, relative to this file; it must be simulated. null: as for labrig run."""
    depth: Literal["world", "rig"] = "world"
    """world: the experiment against the simulated world, without pictures. rig: a whole simulated rig, with
    camera, bus and record."""
    set: dict[Key, Any] = Field(default_factory=dict)
    """Dotted key -> value in every arm; rig.* is of the rig."""
    arms: dict[Name, dict[Key, Any]] = Field(default_factory=dict)
    """Name -> dotted keys and values of an arm."""
    vary: dict[Key, Values] = Field(default_factory=dict)
    """Dotted key -> values, one in each arm."""
    sample: Sample | None = None
    """Points that are drawn in ranges of keys; null: none."""
    repetitions: int = Field(1, ge=1, le=MOST_TASKS)
    """Repetitions of each arm, at each point; with stop_when, the least."""
    stop_when: StopWhen | None = None
    """When to stop earlier; null: after all repetitions."""
    seed: Seed
    """Seed of the points, and of the seeds of all repetitions."""
    measure: Line | None = None
    """Quantity whose mean is compared; null: that by which the experiment is judged."""
    tolerance: float | None = Field(None, ge=0)
    """Largest value of that quantity that counts as reached; null: the protocol's."""

    @property
    def most_repetitions(self) -> int:
        """The number of repetitions if no rule ends it earlier."""
        return self.repetitions if self.stop_when is None else self.stop_when.at_most

    @property
    def points(self) -> int:
        """The number of points of each arm."""
        return 1 if self.sample is None else self.sample.n

    @property
    def round_tasks(self) -> int:
        """The number of tasks of one repetition of all arms at all points."""
        return self.points * max(1, len(self.arms)) * math.prod(map(len, self.vary.values()))

    @property
    def looks(self) -> tuple[int, ...]:
        """After which repetitions the rule looks: fixed beforehand, as each look is a chance to stop too early."""
        looks = [max(_LEAST_TO_JUDGE, self.repetitions)]
        while looks[-1] < self.most_repetitions:
            looks.append(max(looks[-1] + 1, math.ceil(_LOOK_AGAIN * looks[-1])))
        return () if self.stop_when is None else tuple(looks)

    @property
    def ranges(self) -> dict[str, Range]:
        """The dotted keys that are sampled, and the range of each."""
        return {} if self.sample is None else self.sample.keys

    @property
    def varied_keys(self) -> tuple[str, ...]:
        """The dotted keys that differ between tasks, in the order of the file."""
        return tuple(dict.fromkeys(chain(*self.arms.values(), self.vary, self.ranges)))

    def conflicts(self) -> Iterable[Conflict]:
        """Yield keys and values that are given twice or mean nothing, and campaigns that are too large."""
        named = dict.fromkeys(chain(*self.arms.values()))
        sections = {"set": self.set, "arms": named, "vary": self.vary, "sample.keys": self.ranges}
        first: dict[str, str] = {}
        for section, key in ((section, key) for section, keys in sections.items() for key in keys):
            yield from _judge_key(section, key, self.depth)
            if first.setdefault(key, section) != section:
                yield Conflict(section, f"{key} is in {first[key]} too", "give it in one of them")
        for key, values in self.vary.items():
            if len(set(map(show_value, values))) < len(values):
                yield Conflict(f"vary.{key}", f"{key} has a value more than once", "give each once")
        if (arms := self.round_tasks // self.points) > MOST_ARMS:
            message = f"these are {arms} arms, at most {MOST_ARMS} are possible"
            yield Conflict("vary", message, "draw points with sample: instead of a grid")
        elif (tasks := self.round_tasks * self.most_repetitions) > MOST_TASKS:
            message = f"these are {tasks} tasks, at most {MOST_TASKS} are possible"
            yield Conflict("repetitions", message, "fewer arms, points or repetitions")
        if self.stop_when is not None and self.stop_when.at_most < self.looks[0]:
            message = f"at_most is {self.stop_when.at_most}, must be at least {self.looks[0]}"
            yield Conflict("stop_when.at_most", message, "leave out stop_when to make all repetitions")


def show_value(value: object) -> str:
    """Return a value as it is typed: text without quotes, anything else as JSON."""
    return value if isinstance(value, str) else json.dumps(value)


def _judge_key(section: str, key: str, depth: str) -> Iterable[Conflict]:
    """Yield why a key means nothing in a campaign."""
    if key == "seed":
        message = "seed is drawn by the campaign for each repetition, from its own seed"
        yield Conflict(section, message, "leave it out; more repetitions are more seeds")
    elif depth == "world" and needs_pictures(key):
        message = f"{key} changes nothing at depth: world, which has no pictures, no devices and no record"
        yield Conflict(section, message, "say depth: rig, or leave it out")


def needs_pictures(key: str) -> bool:
    """Return whether a key changes nothing in a run that is computed without pictures, bus and record."""
    return _OF_PICTURES.fullmatch(key) is not None


def load_campaign_file(path: Path, overrides: Sequence[str] = ()) -> CampaignFile:
    """Return the campaign in a file.

    Parameters
    ----------
    overrides : sequence of str
        `key=value` each; they replace values of the file.

    Raises
    ------
    FileFormatError
        With every problem of the file and of the overrides.
    """
    return load_yaml_model(path, CampaignFile, overrides, _OTHER_KINDS)


def campaign_schema() -> JsonSchema:
    """Return the JSON Schema of campaign files."""
    return model_schema(CampaignFile, "labrig campaign file")
