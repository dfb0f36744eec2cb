"""Section ``requirements`` of calibration.yml: what must hold of a robot's messages."""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated

from calibration.base.records import Converted, Misfit, Place, above, field, length, matching, one_of, record
from calibration.ci.execution.job import Seconds

MAX_REQUIREMENTS = 1000
_TOPIC = matching(r"/[A-Za-z0-9_]+(/[A-Za-z0-9_]+)*", "the name of a topic, such as /scan")
_FIELD = matching(r"[A-Za-z]\w*(\.[A-Za-z]\w*)*", "a field such as twist.linear.x")


def _bag_path(text: str, place: Place) -> Path:
    return Path(text) if text.startswith(RECORDED_PREFIX) else place.folder / text


RECORDED_PREFIX = "simulation:"
"""Prefix of a bag that an entry of ``simulation`` records."""
_Bag = Annotated[Path, Converted(Annotated[str, length(1)], _bag_path)]


@record(rules=(one_of("min", "max", "equals", why="expected min, max or equals: else it can never fail"),))
class FieldLimits:
    """What every value of a field must be; of an array, each item."""

    min: float | None = field("The smallest value.", default=None)
    max: float | None = field("The largest value.", default=None)
    equals: bool | float | str | None = field("The only value.", default=None)

    def __post_init__(self) -> None:
        if self.min is not None and self.max is not None and self.min > self.max:
            raise Misfit(f"found {self.max:g}, expected at least min, {self.min:g}: else it can never be met", "max")


@record(
    rules=(
        one_of(
            *("within", "type", "min-rate", "max-rate", "max-gap", "max-latency", "fields"),
            why="expected at least one requirement",
        ),
    )
)
class TopicRequirements:
    """What must hold of a topic."""

    within: Seconds | None = field("The first message comes within this time from the begin of the bag.", default=None)
    type: Annotated[str, matching(r"\w+(/msg)?/\w+", "a type such as sensor_msgs/LaserScan")] | None = field(
        "The type of its messages, such as sensor_msgs/LaserScan.", default=None
    )
    min_rate: Annotated[float, above(0)] | None = field(
        "The smallest rate of its messages, from the first to the last one.", unit="Hz", default=None
    )
    max_rate: Annotated[float, above(0)] | None = field("The largest rate, likewise.", unit="Hz", default=None)
    max_gap: Seconds | None = field(
        "The longest time without a message, from the first one to the end of the bag.", default=None
    )
    max_latency: Seconds | None = field(
        "The longest time from the stamp in a message's header to its recording.", default=None
    )
    fields: Mapping[Annotated[str, _FIELD], FieldLimits] = field(
        "What the values of fields must be, by field, such as twist.linear.x.", default_factory=dict
    )

    def __post_init__(self) -> None:
        if self.min_rate is not None and self.max_rate is not None and self.min_rate > self.max_rate:
            raise Misfit(f"found {self.max_rate:g}, expected at least min-rate, {self.min_rate:g}", "max-rate")


@record(rules=(one_of("within", "max-age", why="expected within, max-age or both"),))
class FrameRequirements:
    """What must hold of a frame in tf."""

    to: Annotated[str, length(1)] | None = field(
        "The frame above it that it must be connected with (any parent).", default=None
    )
    within: Seconds | None = field("It is known within this time from the begin of the bag.", default=None)
    max_age: Seconds | None = field(
        "From when it is known: the greatest age of a transform up to it, static ones aside.", default=None
    )


@record(rules=(one_of("topics", "frames", "nodes", "services", "hpl", why="expected at least one requirement"),))
class RequirementSettings:
    """Requirements over the messages of a robot, judged over a bag."""

    bag: _Bag | tuple[_Bag, ...] | None = field(
        "The bag: a file .bag, .db3 or .mcap, the folder of a ROS 2 bag, or several files of one recording; "
        "simulation:NAME for what that entry of simulation records in this run.",
        default=None,
    )
    topics: Mapping[Annotated[str, _TOPIC], TopicRequirements] = field(
        "What must hold of topics, by topic.", default_factory=dict
    )
    frames: Mapping[str, FrameRequirements] = field("What must hold of frames in tf, by frame.", default_factory=dict)
    nodes: tuple[str, ...] = field(
        "Nodes that must be seen: in the headers of a ROS 1 bag's connections, in /rosout or /parameter_events.",
        default=(),
    )
    services: tuple[str, ...] = field(
        "Services of ROS 2 that must be called: those with service introspection, whose events are a topic.",
        default=(),
    )
    hpl: Annotated[tuple[str, ...], length(0, MAX_REQUIREMENTS)] = field(
        "Properties in HPL, such as 'globally: /goal causes /result within 60 s'.", default=()
    )

    @property
    def bags(self) -> tuple[Path, ...]:
        """The files of the bag."""
        return () if self.bag is None else (self.bag,) if isinstance(self.bag, Path) else self.bag

    @property
    def recorded_by(self) -> str | None:
        """The entry of ``simulation`` that records the bag, if one does."""
        first = str(self.bags[0]) if self.bags else ""
        return first.removeprefix(RECORDED_PREFIX) if first.startswith(RECORDED_PREFIX) else None
