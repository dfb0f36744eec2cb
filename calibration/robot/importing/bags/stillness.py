"""Detection of moments at standstill, by the motion of the corners from image to image."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from calibration.robot.importing.bags.bag import NS_PER_S
from calibration.robot.importing.image_views import View

MAX_GAP_SECONDS = 0.5
"""s: images that are farther apart give no information on the motion between them."""
MIN_STILL_SECONDS = 0.3
"""s: minimum duration of a standstill."""
MAX_STILL_MOTION_PX = 1.0
"""px: limit of the corners' motion at a standstill, their median."""
MAX_ASSOCIATED_SECONDS = 0.1
"""s: limit of the time between associated single images."""


@dataclass(frozen=True, eq=False)
class BagImage:
    """Image of one camera in a bag, with the patterns in it."""

    sensor: str
    stamp: int
    """Stamp, ns."""
    recorded: int
    """Recording time, ns, which locates it in the bag."""
    view: View


@dataclass(frozen=True, eq=False)
class Group:
    """Images of one camera in which a pattern does not move."""

    images: Sequence[BagImage]

    @property
    def start(self) -> int:
        """Stamp of the first, ns."""
        return self.images[0].stamp

    @property
    def end(self) -> int:
        """Stamp of the last, ns."""
        return self.images[-1].stamp

    def nearest(self, time: float) -> BagImage:
        """Return the image nearest to a time, ns."""
        return min(self.images, key=lambda image: abs(image.stamp - time))


@dataclass(frozen=True, eq=False)
class BagMoment:
    """Images of a bag's cameras at one moment, at which all may stand still or not."""

    images: Mapping[str, BagImage]
    """Images by sensor; only of sensors that see a pattern."""

    @property
    def time(self) -> float:
        """Mean of the stamps, ns."""
        return float(np.mean([image.stamp for image in self.images.values()]))

    @property
    def lag(self) -> float:
        """Time between the first and the last stamp, s."""
        stamps = [image.stamp for image in self.images.values()]
        return (max(stamps) - min(stamps)) / NS_PER_S


def still_moments(images: Mapping[str, Sequence[BagImage]]) -> list[BagMoment]:
    """Return the moments at which the corners of every camera that sees a pattern do not move.

    One for each standstill, whatever its duration. If images are farther apart than `MAX_GAP_SECONDS`, each is one by
    itself.

    Args:
        images: all images of each camera, sorted by stamp.
    """
    groups = {name: still_groups(own) for name, own in images.items()}
    order = sorted(groups, key=lambda name: -len(groups[name]))
    used: set[int] = set()
    moments = []
    for i, name in enumerate(order):
        for group in groups[name]:
            if id(group) in used:
                continue
            start, end, together = group.start, group.end, {name: group}
            for other in order[i + 1 :]:
                best = max(groups[other], key=lambda g: _overlap_ns(g, start, end), default=None)
                if (
                    best is not None
                    and id(best) not in used
                    and _overlap_ns(best, start, end) >= -MAX_ASSOCIATED_SECONDS * NS_PER_S
                ):
                    used.add(id(best))
                    together[other] = best
                    start, end = sorted((max(start, best.start), min(end, best.end)))
            moments.append(BagMoment({s: g.nearest((start + end) / 2) for s, g in together.items()}))
    return sorted(moments, key=lambda moment: moment.time)


def moments_at(images: Mapping[str, Sequence[BagImage]], times: Sequence[float]) -> list[BagMoment]:
    """Return the images with a pattern nearest to each time (ns), within `MAX_ASSOCIATED_SECONDS`; moving or not."""
    moments = []
    for time in times:
        found = {}
        for name, own in images.items():
            near = [
                image
                for image in own
                if abs(image.stamp - time) <= MAX_ASSOCIATED_SECONDS * NS_PER_S and image.view.labelled
            ]
            if near:
                found[name] = min(near, key=lambda image: abs(image.stamp - time))
        if found:
            moments.append(BagMoment(found))
    return moments


def evenly(moments: Sequence[BagMoment], most: int) -> list[BagMoment]:
    """Return at most this many moments, evenly spaced."""
    if len(moments) <= most:
        return list(moments)
    return [moments[i] for i in np.linspace(0, len(moments) - 1, most).round().astype(int)]


def still_groups(images: Sequence[BagImage]) -> list[Group]:
    """Return the standstills of one camera's patterns, from all of its images sorted by stamp."""
    groups: list[Group] = []
    run: list[BagImage] = []

    def finish() -> None:
        if run and (_is_lone_image(images, run) or run[-1].stamp - run[0].stamp >= MIN_STILL_SECONDS * NS_PER_S):
            groups.append(Group(tuple(run)))
        run.clear()

    for image in images:
        if run and (
            not image.view.labelled
            or image.stamp - run[-1].stamp > MAX_GAP_SECONDS * NS_PER_S
            or _have_corners_moved(run[0], image)
        ):
            finish()
        if image.view.labelled:
            run.append(image)
    finish()
    return groups


def _is_lone_image(images: Sequence[BagImage], run: Sequence[BagImage]) -> bool:
    """Whether a run is a single image, with no other of the camera near it."""
    if len(run) > 1:
        return False
    stamps = [image.stamp for image in images]
    at = stamps.index(run[0].stamp)
    near = [abs(stamps[i] - run[0].stamp) for i in (at - 1, at + 1) if 0 <= i < len(stamps)]
    return all(gap > MAX_GAP_SECONDS * NS_PER_S for gap in near)


def _have_corners_moved(one: BagImage, other: BagImage) -> bool:
    """Whether the common corners have moved; also true if there are none."""
    steps = []
    for pattern, found in one.view.found.items():
        a, b = found.labels, other.view.found[pattern].labels
        if a is not None and b is not None:
            _, i, j = np.intersect1d(a.ids, b.ids, return_indices=True)
            steps.append(np.linalg.norm(a.pixels[i] - b.pixels[j], axis=-1))
    distances = np.concatenate(steps) if steps else np.zeros(0)
    return not len(distances) or bool(np.median(distances) > MAX_STILL_MOTION_PX)


def _overlap_ns(group: Group, start: int, end: int) -> int:
    """Overlap of a group and an interval, ns; negative for a gap."""
    return min(group.end, end) - max(group.start, start)
