"""Motion of boards that a hand moves, by the images around each moment.

The pose of a board is smooth over a fifth of a second: a cubic in time through its poses before and after a moment has
the velocity, the acceleration and the jerk there as its derivatives. Of a camera that stands relative to the board's
parent, this needs no mount.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from calibration.base.arrays import Array, IntArray
from calibration.engine.dataset.configuration import Configuration, PatternConfiguration
from calibration.engine.dataset.model import Edge
from calibration.engine.estimation.start.single_views import corner_term, fitted_poses, refined_poses
from calibration.engine.geometry.cameras import Camera
from calibration.engine.geometry.frames import FrameTree
from calibration.engine.geometry.transforms import local, translation
from calibration.robot.importing.bags.motion_log import polynomial_derivatives
from calibration.robot.importing.bags.stillness import NS_PER_S, BagImage, BagMoment

MIN_STEP, MAX_STEP = 0.03, 0.12
"""s: limits of the time between the images that a velocity is taken from: nearer ones have more noise than motion."""
OFF_STEP = 0.4
"""Limit of how far an image may be from where a step ends, in steps."""
MAX_RMS = 1.5
"""px: limit of the error of a pose that a velocity is taken from."""
IMAGE_STEPS = np.array([-2, -1, 1, 2])
"""Images around that of a moment, in steps."""


@dataclass(frozen=True, eq=False)
class MovingBoards:
    """Images of cameras before which boards may move."""

    images: Mapping[str, Sequence[BagImage]]
    """All images of each camera, sorted by stamp."""
    moments: Sequence[BagMoment]
    """The moments at which velocities are wanted."""
    edges: Collection[Edge] = ()
    """Recorded edges from the world to cameras and patterns' parents."""
    moving: Collection[Edge] = ()
    """Those of them that move, such as an arm's."""

    def motions(self, configuration: Configuration, cameras: Mapping[str, Camera]) -> dict[Edge, Array]:
        """Return velocity, acceleration, jerk (N, 3, 6) of each pattern, as `calibration.engine.dataset.velocities`.

        Of several cameras the anchored one, else the first, gives the motion: it is the clock. Zero at a moment
        without images before and after it.
        """
        names = [name for name in configuration.sensors if name in cameras and name in self.images]
        names.sort(key=lambda name: name != configuration.anchored_sensor)
        found: dict[Edge, Array] = {}
        for pattern in configuration.patterns.values():
            total = np.zeros((len(self.moments), 3, 6))
            for name in names if not pattern.fixed else ():
                if self._is_still(configuration.sensors[name].parent_link, pattern.parent_link):
                    missing = np.flatnonzero(~total.any((1, 2)))
                    moments = [self.moments[i] for i in missing.tolist()]
                    total[missing] = _pattern_motions(self.images[name], moments, name, cameras[name], pattern)
            if total.any():
                found[pattern.parent_link, pattern.link] = total
        return found

    def _is_still(self, one: str, other: str) -> bool:
        """Whether nothing moves between two frames."""
        tree = FrameTree(self.edges)
        if one == other or one not in tree or other not in tree:
            return one == other
        return all((step.parent, step.child) not in self.moving for step in tree.path(one, other))


def _pattern_motions(
    images: Sequence[BagImage], moments: Sequence[BagMoment], name: str, camera: Camera, pattern: PatternConfiguration
) -> Array:
    """Return the motions (N, 3, 6) of a pattern at some moments by the images of one camera; zero if there is none."""
    found = np.zeros((len(moments), 3, 6))
    seen = [(image, labels) for image in images if (labels := image.view.found[pattern.name].labels) is not None]
    index = {id(image): i for i, (image, _) in enumerate(seen)}
    stamps = np.array([image.stamp - images[0].stamp for image, _ in seen]) / NS_PER_S
    rows = [i for i, moment in enumerate(moments) if id(moment.images.get(name)) in index]
    at = np.array([index[id(moments[i].images[name])] for i in rows], int)
    around = [_neighbouring_images(stamps, i) for i in at]
    if not any(len(each) for each in around):
        return found
    geometry = pattern.pattern()
    term = corner_term(camera, geometry, [labels for _, labels in seen])
    middles, rms = fitted_poses(term.take(at))
    of = np.repeat(np.arange(len(at)), [len(each) for each in around])
    others, others_rms = refined_poses(term.take(np.concatenate(around)), middles[of])
    twists = local(middles[of] @ translation(-geometry.centre), others @ translation(-geometry.centre))
    for i, (row, own) in enumerate(zip(rows, around, strict=True)):
        if len(own) and max(rms[i], others_rms[of == i].max()) <= MAX_RMS:  # not if one is NaN
            orders = np.arange(1, min(len(own), 3) + 1)
            found[row] = polynomial_derivatives(stamps[own] - stamps[at[i]], twists[of == i], orders)
    return found


def _neighbouring_images(stamps: Array, at: int) -> IntArray:
    """Return the images before and after one, by their stamps (n,), s; none if they are too far away."""
    gaps = np.diff(stamps[max(at - 1, 0) : at + 2])
    step = max(MIN_STEP, gaps.min(initial=np.inf))
    if step > MAX_STEP:
        return np.zeros(0, int)
    ends = stamps[at] + step * IMAGE_STEPS
    nearest = abs(stamps - ends[:, None]).argmin(-1)
    around = np.unique(nearest[abs(stamps[nearest] - ends) <= OFF_STEP * step])
    both_sides = (around < at).any() and (around > at).any()
    return around if both_sides else np.zeros(0, int)
