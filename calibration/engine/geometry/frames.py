"""Kinematic trees: the path between any two frames."""

from collections.abc import Iterable
from dataclasses import dataclass

from calibration.base.errors import InputError


@dataclass(frozen=True)
class Step:
    """Edge of a path: the transform ``T_parent_child``, or its inverse if ``inverted``."""

    parent: str
    child: str
    inverted: bool


class FrameTree:
    """Frames of a robot, connected by edges parent -> child.

    Raises:
        InputError: a frame has two parents, or the edges form a loop.
    """

    def __init__(self, edges: Iterable[tuple[str, str]]) -> None:
        self._parent: dict[str, str] = {}
        self._frames: dict[str, None] = {}  # in order of appearance
        for parent, child in edges:
            known = self._parent.setdefault(child, parent)
            if known != parent:
                raise InputError(f"frame '{child}' has two parents, '{known}' and '{parent}'; a tree needs one")
            self._frames.setdefault(parent)
            self._frames.setdefault(child)
        self._refuse_loops()

    @property
    def frames(self) -> tuple[str, ...]:
        """Frames, in order of appearance."""
        return tuple(self._frames)

    def __contains__(self, frame: str) -> bool:
        return frame in self._frames

    def path(self, start: str, end: str) -> tuple[Step, ...]:
        """Return the steps whose product is ``T_start_end``.

        Raises:
            InputError: a frame is not in the tree, or the two are not connected.
        """
        for frame in (start, end):
            if frame not in self._frames:
                raise InputError(f"frame '{frame}' is not in the tree (frames: {', '.join(self._frames)})")
        up, down = self._ancestors(start), self._ancestors(end)
        common = next((frame for frame in up if frame in down), None)
        if common is None:
            raise InputError(f"frames '{start}' and '{end}' are not connected")
        ascent = [Step(self._parent[f], f, inverted=True) for f in list(up)[: up[common]]]
        descent = [Step(self._parent[f], f, inverted=False) for f in list(down)[: down[common]]]
        return (*ascent, *reversed(descent))

    def _ancestors(self, frame: str) -> dict[str, int]:
        """Return the frame and its ancestors up to the root, each with its depth."""
        chain = {frame: 0}
        while (parent := self._parent.get(frame)) is not None:
            frame = parent
            chain[frame] = len(chain)
        return chain

    def _refuse_loops(self) -> None:
        """Raise if following the parents leads to a loop; each edge is visited once.

        A parent appears before its children do, so a loop is entered at one of its own frames.
        """
        safe: set[str] = set()
        for start in self._frames:
            chain: dict[str, None] = {}
            frame: str | None = start
            while frame is not None and frame not in safe:
                if frame in chain:
                    raise InputError(f"frames form a loop: {' -> '.join([frame, *reversed(chain)])}")
                chain[frame] = None
                frame = self._parent.get(frame)
            safe.update(chain)
