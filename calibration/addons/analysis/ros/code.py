"""Calls by which the code of a node connects it: topics, services, actions, parameters."""

from dataclasses import dataclass
from typing import Literal

Kind = Literal[
    "publisher", "subscriber", "server", "client", "action server", "action client", "declared parameter", "parameter"
]
Reliability = Literal["reliable", "best effort"]
Durability = Literal["volatile", "transient local"]


@dataclass(frozen=True)
class Quality:
    """Quality of service of a publisher or subscriber, as far as the code says it."""

    reliability: Reliability = "reliable"
    durability: Durability = "volatile"


@dataclass(frozen=True)
class Call:
    """Call of a ROS client library."""

    kind: Kind
    name: str | None
    """Name as written in the code; None if it is not a constant."""
    type: str | None
    """``package/Type``; None if it is not known. None for parameters."""
    path: str
    line: int
    quality: Quality | None = None
    """Quality of service; None if it is unknown, and for ROS 1."""


@dataclass(frozen=True)
class ClientCode:
    """Uses of the ROS client library in one source file."""

    calls: tuple[Call, ...] = ()
    node_names: tuple[str, ...] = ()
    """Names that nodes are created with."""
    takes_any_parameter: bool = False
    """Whether nodes accept parameters that they do not declare."""


def short_type(parts: list[str]) -> str | None:
    """Return ``package/Type`` of ``package.msg.Type`` or ``package::msg::Type``; None if it is no type of a package."""
    kept = [each for each in parts if each not in ("msg", "srv", "action", "")]
    return "/".join(kept) if len(kept) == 2 else None
