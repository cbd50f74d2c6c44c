"""The protocol of a planned, image-guided insertion."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import Field, field_validator, model_validator

from labrig.protocol.model import (
    Conflict,
    Line,
    MarkerDictionary,
    MarkerId,
    Model,
    NonNegativeMm,
    PixelUv,
    PointMm,
    PositiveMm,
)
from labrig.protocol.sections import Advance, Criterion, JudgedProtocol, RollZeroSearch, TrackedSpecimen
from labrig.protocol.specimen_file import TracksBySpecimen
from labrig.steering.parameters import (
    PAPER_POLICY,
    PAPER_SECTIONS,
    Estimator,
    PlanMethod,
    PlanWeights,
    SteeringPolicy,
)

_WHERE = "give one of position_mm: [x, y, z], pixel: [u, v] and ask: true"


class Phantom(TrackedSpecimen):
    """A block of gel with obstacles cast in."""

    length_mm: float = Field(140.0, gt=0, le=1000)
    """Length of the block along the insertion [mm]."""
    width_mm: float = Field(80.0, gt=0, le=1000)
    """Width of the block, half of it to each side of the sheath [mm]."""


class Place(Model):
    """A point of the steering plane: in mm, or as a pixel of the camera's picture."""

    position_mm: PointMm | None = None
    """Place x, y, z from the origin of the steering plane [mm]; z along the insertion."""
    pixel: PixelUv | None = None
    """Pixel (u, v) of the camera's picture [px]."""
    marker_id: MarkerId | None = None
    """The id of a printed marker that moves with it: what the marker moves in the pictures after the first is
    added to its place. See markers."""
    ask: bool = False
    """Whether the operator names its pixel on a picture taken during the run."""

    def conflicts(self) -> Iterator[Conflict]:
        """Yield a place that is given more than once, or not at all."""
        given = (self.position_mm is not None) + (self.pixel is not None) + self.ask
        if given != 1:
            message = f"the place is given {given} times, expected one of position_mm, pixel and ask: true"
            yield Conflict("position_mm", message, _WHERE)


class Target(Place):
    """The point to reach."""

    tolerance_mm: PositiveMm = 2.0
    """How far from the target the needle may end [mm]."""
    sd_mm: NonNegativeMm = 0.0
    """How far it may be from where it is stated, along each axis: cast elsewhere, or moved unseen (standard
    deviation) [mm]."""


class InsertionObstacle(Place):
    """A sphere that the needle keeps off."""

    radius_mm: PositiveMm
    """Radius of the sphere [mm]."""


class Markers(Model):
    """The printed markers that target and obstacles are bound to by their `marker_id`, and how far they are trusted."""

    sd_mm: NonNegativeMm = 0.1
    """How far what is bound to a marker may be from where the marker's displacement puts it, along each axis
    (standard deviation) [mm]."""
    lost_sd_mm_per_mm: float = Field(0.05, ge=0, le=10)
    """How much is added to that for each millimetre that the needle moves while the marker is not seen [mm/mm]."""
    most_lost_mm: PositiveMm = 10.0
    """The needle stops when it has moved this far without a marker being seen [mm]."""
    jump_mm: PositiveMm = 1.0
    """The needle stops when a marker has moved by more than this between two pictures and stays there; three
    standard deviations of lost_sd_mm_per_mm are allowed besides [mm]."""
    dictionary: MarkerDictionary = "DICT_4X4_50"
    """OpenCV's name of the dictionary that all of them are from (ArUco or AprilTag)."""
    side_mm: PositiveMm
    """Side of the printed black square, without its white rim [mm]."""
    x_mm: Annotated[float, Field(ge=-500, le=500)] = 0.0
    """Where they are across the steering plane, positive away from the camera [mm]."""


class InsertionAdvance(Advance):
    """How the needle goes in and comes out."""

    frame_every_mm: PositiveMm = 1.0
    """Inserted length between two pictures; the needle does not stop for them [mm]."""
    max_length_mm: float = Field(gt=0, le=500)
    """Longest path that may be planned [mm]."""


class Planner(Model):
    """How a path is planned."""

    method: PlanMethod = "best"
    """The default planner, or the paper's for comparison."""
    radius_mm: PositiveMm
    """Radius of the needle's arcs expected in this gel [mm]."""
    clearance_mm: NonNegativeMm = 0.6
    """Asked for, from the needle's surface to an obstacle's [mm]."""
    max_arcs: int = Field(6, ge=1, le=12)
    """Most arcs of a path."""
    weights: PlanWeights = PlanWeights()
    """What makes one path better than another."""


def _allow_paper(schema: dict[str, Any]) -> None:
    """Let the schema of the section take the word too."""
    schema["anyOf"] = [{"$ref": schema.pop("$ref")}, {"const": "paper"}]


class OutOfPlane(Model):
    """What one camera does not see: how far the needle may be led out of the steering plane."""

    heading_sd_deg_per_root_mm: Annotated[float, Field(ge=0, le=10)] | None = None
    """Random lean of the tip out of the plane after a millimetre; null: as much as in the plane
    (estimator.process_sd_deg_per_root_mm), since gel knows no plane [deg / mm^0.5]."""
    start_sd_mm: NonNegativeMm = 0.1
    """Standard deviation of the start's place out of the plane, with the sheath's play, which no picture shows [mm]."""
    start_sd_deg: float = Field(0.2, ge=0, le=20)
    """Standard deviation of the angle between the sheath and the plane [deg]."""
    lag_sd_deg: float = Field(1.0, ge=0, le=90)
    """Standard deviation of the angle by which torsion keeps the bevel behind its drive; of a lag that was
    measured with the roll zero and is compensated, that of the measurement counts instead [deg]."""


class InsertionProtocol(JudgedProtocol, RollZeroSearch):
    """Section V-C of the paper: steer to a target between obstacles, with feedback from the camera."""

    pictures_decide_motion: ClassVar[bool] = True
    judged_values: ClassVar[Mapping[str, str]] = {
        "target_error_mm": "the distance in the plane from the needle's end to the target, at the end of an insertion"
    }

    experiment: Literal["insertion"]
    """Which experiment this file describes."""
    title: Line = "Insertion to a target"
    """Heading of the report."""
    specimen: Phantom
    """The block of gel with the obstacles; each repetition takes a new one."""
    repetitions: int = Field(1, ge=1, le=500)
    """Insertions."""
    target: Target
    """The point to reach."""
    obstacles: tuple[InsertionObstacle, ...] = Field((), max_length=100)
    """Spheres to keep off, any number up to a hundred."""
    markers: Markers | None = None
    """The printed markers by which moving targets and obstacles are followed; null: none."""
    insertion: InsertionAdvance
    """How the needle goes in and comes out."""
    planner: Planner
    """How a path is planned."""
    estimator: Estimator = Estimator()
    """How the tip's pose is estimated."""
    policy: SteeringPolicy = Field(SteeringPolicy(), json_schema_extra=_allow_paper)
    """When the path is replanned; paper: the paper's planner, filter and policy, for comparison."""
    out_of_plane: OutOfPlane = OutOfPlane()
    """What leads the needle out of the plane that the camera sees. The target is reached if the 95 % interval
    of the distance in space lies within the tolerance."""

    @field_validator("policy", mode="before")
    @classmethod
    def _read_policy(cls, policy: object) -> object:
        return PAPER_POLICY if policy == "paper" else policy

    @model_validator(mode="after")
    def _follow_paper(self) -> Self:
        if self.policy is not PAPER_POLICY:
            return self
        sections = {
            name: getattr(self, name).model_copy(update=dict(values))
            for name, values in PAPER_SECTIONS.items()
        }
        return self.model_copy(update=sections)

    @property
    def places(self) -> Mapping[str, Target | InsertionObstacle]:
        """Dotted key -> target or obstacle, the target first."""
        return {"target": self.target} | {
            f"obstacles.{number}": obstacle for number, obstacle in enumerate(self.obstacles)
        }

    @property
    def expected_radius_mm(self) -> float:
        """The radius that is planned with."""
        return self.planner.radius_mm

    @property
    def criterion(self) -> Criterion:
        """The tip's true distance from the target, and the tolerance."""
        return Criterion("true_target_error_mm", self.target.tolerance_mm)

    def find_map_circles(self, horizontal: str, vertical: str) -> Sequence[tuple[float, float, float]]:
        """Return the obstacles, if the map is one of targets in the plane, z along the horizontal."""
        if (horizontal, vertical) != ("target.position_mm.2", "target.position_mm.1"):
            return ()
        return [
            (obstacle.position_mm[2], obstacle.position_mm[1], obstacle.radius_mm)
            for obstacle in self.obstacles
            if obstacle.position_mm is not None
        ]

    @property
    def gels(self) -> Mapping[str, TrackedSpecimen]:
        """Dotted key -> block of gel."""
        return {"specimen": self.specimen}

    def put_tracks(self, tracks: TracksBySpecimen) -> Self:
        """Return this protocol with the tracks in its specimen, by the specimen's name."""
        return self.model_copy(update={"specimen": self.specimen.put_tracks(tracks)})

    def conflicts(self) -> Iterator[Conflict]:
        """Yield sizes that contradict each other, and a named block for insertions that take one each."""
        yield from super().conflicts()
        yield from self._find_keys_beside_paper()
        if self.specimen.block is not None and self.repetitions > 1:
            message = (
                f"{self.repetitions} repetitions, each in a new block, and the specimen file describes one"
            )
            yield Conflict("repetitions", message, "repetitions: 1, or leave out specimen_file")
        yield from self._find_marker_conflicts()
        if self.planner.radius_mm <= self.needle.diameter_mm:
            message = f"radius_mm is {self.planner.radius_mm:g}, must be above needle.diameter_mm"
            yield Conflict("planner.radius_mm", message, "are both in mm?")

    def _find_keys_beside_paper(self) -> Iterator[Conflict]:
        """Yield keys that `policy: paper` decides."""
        if self.policy is PAPER_POLICY:
            for name, values in PAPER_SECTIONS.items():
                for key in values:
                    if key in getattr(self, name).model_fields_set:
                        yield Conflict(f"{name}.{key}", "policy: paper says what it is", "leave it out")

    def _find_marker_conflicts(self) -> Iterator[Conflict]:
        """Yield ids of markers that nothing describes, and markers that nothing is bound to."""
        if self.markers is None:
            for key, place in self.places.items():
                if place.marker_id is not None:
                    message = (
                        f"it is bound to marker {place.marker_id}, and the protocol does not describe markers"
                    )
                    yield Conflict(
                        f"{key}.marker_id", message, "say how large they are: markers: {side_mm: 6}"
                    )
        elif all(place.marker_id is None for place in self.places.values()):
            yield Conflict(
                "markers",
                "no target and no obstacle is bound to a marker",
                "give it a marker_id, or leave this out",
            )


Protocol = InsertionProtocol
