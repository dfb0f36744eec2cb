"""Launch files: the nodes they start, the files they include and the parameters they set, read without running them."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from calibration.addons.analysis.ros.tree import join

_PACKAGE_SUBSTITUTION = re.compile(r"\$\((?:find|find-pkg-share)\s+([\w-]+)\)")
_FOLDER_SUBSTITUTION = re.compile(r"\$\(dirname\)")


@dataclass(frozen=True)
class Remapping:
    """Name that a node is given in place of another one."""

    old: str | None
    new: str | None
    """The new name; like the old one None if it is unknown."""
    line: int


@dataclass(frozen=True)
class LaunchParameter:
    """Parameter that a launch file or a file of parameters sets."""

    name: str
    path: str
    line: int


@dataclass(frozen=True)
class NodeStart:
    """Node that a launch file starts."""

    package: str | None
    executable: str | None
    name: str | None
    """Name of the node; None if it is not given, or unknown."""
    path: str
    line: int
    namespace: str | None = ""
    """Namespace of the node; None if it is unknown."""
    is_named: bool = True
    """Whether the launch file gives a name."""
    conditional: bool = False
    remappings: tuple[Remapping, ...] = ()
    parameters: tuple[LaunchParameter, ...] = ()
    parameter_files: tuple[str, ...] = ()
    arguments: tuple[str, ...] = ()


@dataclass(frozen=True)
class Include:
    """Launch file that another one includes."""

    file: str | None
    path: str
    line: int
    arguments: Mapping[str, int] = field(default_factory=dict)
    """Lines of the arguments by name."""
    namespace: str | None = ""
    conditional: bool = False
    passes_all: bool = False


@dataclass(frozen=True)
class Launch:
    """A launch file."""

    path: str
    starts: tuple[NodeStart, ...] = ()
    includes: tuple[Include, ...] = ()
    arguments: Mapping[str, bool] = field(default_factory=dict)
    """Declared arguments, and whether each has a value."""
    used: tuple[tuple[str, int], ...] = ()
    """Arguments that are used, with their lines."""
    files: tuple[tuple[str, int], ...] = ()
    """Files of packages that are named, ``package://name/path``, with their lines."""
    parameters: tuple[LaunchParameter, ...] = ()
    """Parameters of no node."""
    unresolved: Sequence[str] = ()
    """Messages about parts that could not be read."""


def with_packages(text: str, path: str) -> str:
    """Return a text with ``package://name`` for the folders of packages; other substitutions stay ``$(...)``."""
    text = _PACKAGE_SUBSTITUTION.sub(lambda match: f"package://{match[1]}", text)
    return _FOLDER_SUBSTITUTION.sub(lambda _: f"repository://{path.rpartition('/')[0]}", text)


def known(text: str | None) -> str | None:
    """Return a text without substitutions; None for others."""
    return None if text is None or "$(" in text else text


def package_of(text: str) -> tuple[str, str] | None:
    """Return package and path of ``package://name/path``; None for others, and for paths with substitutions."""
    match = re.fullmatch(r"(?:file://)?package://([\w-]+)/+([^$*?\[\]{}]+)", text)
    if match is None or (path := join("", match[2])) is None:
        return None
    return match[1], path


def resolved(namespace: str | None, name: str) -> str | None:
    """Return the full name of a relative, absolute or private one; the private ones as ``/namespace/~name``."""
    if name.startswith("/"):
        return "/" + name.strip("/")
    if namespace is None:
        return None
    return f"/{namespace.strip('/')}/{name}".replace("//", "/")
