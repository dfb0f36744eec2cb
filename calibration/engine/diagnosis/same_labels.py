"""Check that a calibrated dataset has the same labels as the given one."""

from collections.abc import Iterator, Mapping

import numpy as np

from calibration.base.arrays import Array
from calibration.engine.dataset.model import CornerLabels, Dataset, Edge, Labels, PointLabels, PoseLabels
from calibration.engine.diagnosis.finding import Finding
from calibration.engine.diagnosis.limits import Limits
from calibration.engine.geometry.transforms import distance

PIXEL_TOLERANCE, METRE_TOLERANCE = 0.01, 1e-4
"""px, m: tolerance of labels and patterns for rounding."""
MAX_NAMED_DIFFERENCES = 3
"""Number of differences that a message names."""


def same_labels(found: Dataset, given: Dataset) -> tuple[Finding, ...]:
    """Report a failure if a calibrated dataset was made from other labels, or for another robot.

    Args:
        found: the calibrated dataset.
        given: the dataset to calibrate.
    """
    differences = list(_of_frames(found, given)) or list(_of_labels(found, given))
    if not differences:
        return ()
    more = (
        f"; and {len(differences) - MAX_NAMED_DIFFERENCES} more differences"
        if len(differences) > MAX_NAMED_DIFFERENCES
        else ""
    )
    text = (
        "the calibrated dataset does not belong to the dataset that was given: "
        f"{'; '.join(differences[:MAX_NAMED_DIFFERENCES])}{more}"
    )
    return (Finding("other-dataset", "red", text),)


def _of_frames(found: Dataset, given: Dataset) -> Iterator[str]:
    """Yield differing collections, sensors, patterns, joints or calibrated transforms, which exclude a comparison."""
    if found.keys != given.keys:
        other = set(found.keys) ^ set(given.keys)
        more = ", ..." if len(other) > MAX_NAMED_DIFFERENCES else ""
        which = f" (not in both: {', '.join(sorted(other)[:MAX_NAMED_DIFFERENCES])}{more})"
        yield f"it has {len(found.keys)} collections, expected {len(given.keys)}{which}"
    for what, names, expected in (
        ("sensors", list(found.sensors), list(given.sensors)),
        ("patterns", list(found.patterns), list(given.patterns)),
        ("calibrated joints", list(found.joints), list(given.joints)),
    ):
        if set(names) != set(expected):
            yield f"its {what} are {', '.join(names) or 'none'}, expected {', '.join(expected) or 'none'}"
    if found.anchored != given.anchored:
        yield f"its anchored sensor is {found.anchored or 'none'}, expected {given.anchored or 'none'}"
    for name in (name for name in found.sensors if name in given.sensors):
        one, two = found.sensors[name], given.sensors[name]
        if (one.edge, one.frame, one.modality) != (two.edge, two.frame, two.modality):
            yield f"its sensor '{name}' calibrates '{'-'.join(one.edge)}', expected '{'-'.join(two.edge)}'"


def _of_labels(found: Dataset, given: Dataset) -> Iterator[str]:
    for name, pattern in given.patterns.items():
        other = found.patterns[name]
        if pattern.corners.shape != other.corners.shape:
            yield f"its pattern '{name}' has {len(other.corners)} corners, expected {len(pattern.corners)}"
        elif (off := np.abs(pattern.corners - other.corners).max()) > METRE_TOLERANCE:
            yield f"the corners of its pattern '{name}' lie up to {1e3 * off:.3g} mm elsewhere"
    for one, two in zip(found.collections, given.collections, strict=True):
        for key in dict.fromkeys((*two.labels, *one.labels)):
            sensor = key[1]
            if key not in one.labels or key not in two.labels:
                yield f"collection {two.key} {'lacks' if key in two.labels else 'has'} labels of '{sensor}'"
            elif difference := _describe_difference(one.labels[key], two.labels[key]):
                yield f"collection {two.key}: the labels of '{sensor}' {difference}"


def _describe_difference(one: Labels, two: Labels) -> str:
    """Describe the difference of a view's labels; empty if they are equal."""
    if isinstance(one, CornerLabels) and isinstance(two, CornerLabels):
        a, b = np.argsort(one.ids), np.argsort(two.ids)
        if not np.array_equal(one.ids[a], two.ids[b]):
            return f"are {len(one.ids)} corners, expected the {len(two.ids)} that were given"
        off = float(np.abs(one.pixels[a] - two.pixels[b]).max(initial=0))
        return f"differ by up to {off:.3g} px" if off > PIXEL_TOLERANCE else ""
    if isinstance(one, PointLabels) and isinstance(two, PointLabels):
        if one.points.shape != two.points.shape or not np.array_equal(one.limits, two.limits):
            return f"are {len(one.points)} points, expected the {len(two.points)} that were given"
        off = float(np.abs(one.points - two.points).max(initial=0))
        return f"differ by up to {1e3 * off:.3g} mm" if off > METRE_TOLERANCE else ""
    if isinstance(one, PoseLabels) and isinstance(two, PoseLabels):
        off, turned = (float(each) for each in distance(one.T, two.T))
        return (
            f"differ by {1e3 * off:.3g} mm, {np.degrees(turned):.2g} deg" if max(off, turned) > METRE_TOLERANCE else ""
        )
    return "are of another kind"


def moved_frames(found: Dataset, given: Dataset, limits: Limits) -> tuple[Finding, ...]:
    """Report a failure if transforms that are not calibrated have changed by more than the tolerance.

    Args:
        found: the calibrated dataset; of the same labels.
        given: the dataset to calibrate.
        limits: of the system.
    """
    most_mm, most_deg = limits.sensor
    calibrated = _calibrated_edges(given)
    moved = []
    for edge in given.transforms.keys() & found.transforms.keys() - calibrated:
        translation, angle = _distance_from_given(found.transforms, given.transforms, edge)
        if translation > most_mm or angle > most_deg:
            moved.append((translation, angle, edge))
    if not moved:
        return ()
    translation, angle, edge = max(moved)
    more = f", and {len(moved) - 1} more" if len(moved) > 1 else ""
    anchored = given.anchored is not None and given.sensors[given.anchored].edge == edge
    what = f"the anchored sensor '{given.anchored}'" if anchored else f"'{'-'.join(edge)}', which is not calibrated"
    text = f"the calibrated dataset moves {what}, by {translation:.3g} mm and {angle:.2g} deg{more}: leave it as it is"
    return (Finding("moved-frame", "red", text, moves_mm=translation, moves_deg=angle),)


def _calibrated_edges(given: Dataset) -> set[Edge]:
    """Return the transforms that a calibration may change."""
    sensors = (sensor.edge for sensor in given.sensors.values() if sensor.name != given.anchored)
    patterns = ((pattern.parent_link, pattern.link) for pattern in given.patterns.values())
    return {*sensors, *patterns, *given.additional_transforms, *(joint.edge for joint in given.joints.values())}


def _distance_from_given(found: Mapping[Edge, Array], given: Mapping[Edge, Array], edge: Edge) -> tuple[float, float]:
    """Return the distance of a transform from the given one, mm and deg, in the worst collection."""
    both = np.isfinite(found[edge]).all((1, 2)) & np.isfinite(given[edge]).all((1, 2))
    translation, angle = distance(given[edge][both], found[edge][both])
    return float(1e3 * translation.max(initial=0)), float(np.degrees(angle.max(initial=0)))
