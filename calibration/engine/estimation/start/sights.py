"""Views of each sensor and pattern, with the poses or points that their labels alone determine."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calibration.base.arrays import Array, IntArray
from calibration.engine.estimation.residuals.corner_residuals import CornerTerm
from calibration.engine.estimation.residuals.pose_residuals import PoseTerm
from calibration.engine.estimation.residuals.ray_residuals import RangeTerm
from calibration.engine.estimation.residuals.views import Chain, ViewGroup
from calibration.engine.estimation.start.single_views import robust_poses


@dataclass(frozen=True, eq=False)
class Sight:
    """V views ``T_sensor_pattern = chain``: of a group, or combined from two groups of the same moving pattern."""

    sensor: str
    pattern: str
    chain: Chain
    collections: IntArray
    """(V,)."""
    counts: IntArray
    """(V,): numbers of labels."""
    seen: Array | None
    """``T_sensor_pattern`` (V, 4, 4) of a camera, or measured; NaN if a view determines none."""
    points: RangeTerm | None
    """Points on the pattern's plane, of a LiDAR or a depth camera."""

    def through(self, other: "Sight", seen: Array) -> "Sight":
        """Combine with another sensor's views (V, 4, 4) of the same pattern in common collections; its pose cancels."""
        _, own, at = np.intersect1d(self.collections, other.collections, return_indices=True)
        to_pattern, from_pattern = (sight.chain.part(-1, len(sight.chain.links) - 1) for sight in (self, other))
        return replace(
            self,
            chain=to_pattern.take(own).then(from_pattern.take(at).inverse()).then(Chain(seen[at], ())),
            collections=self.collections[own],
            counts=self.counts[own],
            seen=None if self.seen is None else self.seen[own],
            points=None if self.points is None else self.points.take(own),
        )


def sights_of(groups: Sequence[ViewGroup]) -> tuple[Sight, ...]:
    """Return the views of each group, with the poses or points that their labels alone determine."""
    terms = [group.terms[0] for group in groups]
    corners = {i: term for i, term in enumerate(terms) if isinstance(term, CornerTerm)}
    seen = dict(zip(corners, robust_poses([*corners.values()]), strict=True))
    found = []
    for i, (group, term) in enumerate(zip(groups, terms, strict=True)):
        pose = term.measured if isinstance(term, PoseTerm) else seen.get(i)
        points = term if isinstance(term, RangeTerm) else None
        found.append(Sight(group.sensor, group.pattern, group.chain, group.collections, term.counts, pose, points))
    return tuple(found)
