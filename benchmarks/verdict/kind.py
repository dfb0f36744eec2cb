"""A kind of defect, and the words of which a reason that names it has one."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from benchmarks.verdict.scene import Scene

ALL = ("t2rgb", "rlbot", "riwbot", "softbot", "spjbot")
LIDARS = ("rlbot", "softbot")
PAIRS = ("t2rgb", "softbot")
ARMS = ("riwbot", "spjbot")
MOVED = ("t2rgb", "rlbot")
"""Systems whose pattern is moved; that of the others is fixed."""

Group = Literal["camera", "pattern", "LiDAR", "arm", "mount", "time", "labels", "description", "data", "clean"]


@dataclass(frozen=True)
class Kind:
    """A kind of defect."""

    name: str
    group: Group
    what: str
    """For a reader's table."""
    plant: Callable[[Scene, float, np.random.Generator], Scene]
    sizes: tuple[float, ...]
    """Small, middle, great."""
    unit: str
    words: tuple[str, ...]
    """A reason names it when it has one of them, in small letters."""
    systems: tuple[str, ...] = ALL
    memory: tuple[str, ...] = ()
    """The systems on which only an earlier result could tell: their data fit another calibration as well. The joint of
    spjbot whose height is calibrated takes up what its neighbours are off by."""
    wanted: tuple[float, ...] = ()
    """The sizes that have to be red whatever harm they do: mistakes that a user has to correct."""
    spoils: bool = False
    """Whether red is right even where it does no harm: a share of the labels is worthless, or too few are left."""
    displaces: bool = False
    """Whether a sensor is moved by the size within the recording, or its lens changed by a share: by more than the
    limit that is harm, wherever the result lies between its places."""


LENS = ("lens", "distortion")
MOVED_WORDS = ("moved", "between collection", "drift", "halves", "over time", "contradict")
WHEN = ("lag", "synchron", "delay", "time", "contradict", "late")
VIEWS = ("view", "collection", "contradict", "wrong")
LINK = ("joint", "link", "arm", "encoder", "axis", "origin")
FEW = ("few", "determine", "well enough", "collections", "add ")
