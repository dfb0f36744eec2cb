"""Checks of what another software has left: the dataset that was given, and a table that follows from it."""

from collections.abc import Iterator, Mapping

import numpy as np

from calibration.base import parse_number
from calibration.base.arrays import Array
from calibration.base.tables.table import KeyedTable
from calibration.base.tables.table import Table as Csv
from calibration.engine.dataset.model import CornerLabels, Dataset, Edge, Labels, PointLabels, PoseLabels
from calibration.engine.diagnosis.finding import Finding
from calibration.engine.diagnosis.limits import Limits
from calibration.engine.evaluation.table import AVERAGES_ROW, Table
from calibration.engine.geometry.transforms import distance

PIXEL_TOLERANCE, METRE_TOLERANCE = 0.01, 1e-4
"""px, m: tolerance of labels and patterns for rounding."""
MAX_NAMED_DIFFERENCES = 3
"""Number of differences that a message names."""
ROW_TOLERANCE, AVERAGE_TOLERANCE = 0.1, 0.05
"""Relative tolerance of a value: of one collection, and of an average. Both tables evaluate the same transforms, but
the pose of a pattern estimated from a view, or the border found in an image, depends slightly on the implementation.
"""
MAX_DIGIT_TOLERANCE = 0.1
"""Limit of the unit of the last digit as a tolerance, so that "0" is not taken for any value rounded to it; averages,
which a verdict depends on, have their relative tolerance as the limit.
"""
NO_NOISE = 0.1
"""No calibration has a smaller RMS than this fraction of the optimum's on the same labels."""


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


def table_follows(theirs: Csv, made: Table) -> tuple[Finding, ...]:
    """Report a failure for the first value of a table that differs from our evaluation of the same dataset.

    Columns and rows that both have are compared, and the averages: software may leave out a collection, but then
    the averages reveal it.

    Args:
        theirs: the table that the software left.
        made: the table of its calibrated dataset.
    """
    columns = [column for column in made.columns if theirs.header.count(column) == 1]
    if not columns:
        text = (
            f"the table is not verified: it has no column of the one that evaluate asks for ({', '.join(made.columns)})"
        )
        return (Finding("table", "note", text),)
    keyed = KeyedTable.of(theirs, None, ())
    of_label = {
        _without_leading_zeros(label): values for label, values in zip(made.labels, _values_of_table(made), strict=True)
    }
    of_label[AVERAGES_ROW] = made.averages
    if not any(_without_leading_zeros(keyed.label(row)) in of_label for row in theirs.rows):
        text = f"the table has no row of the collections of its dataset ({', '.join(made.labels[:3])}, ...)"
        return (Finding("table", "red", text),)
    wrong = list(_describe_wrong_values(keyed, columns, made, of_label))
    if not wrong:
        return ()
    more = f", and {len(wrong) - 1} more values differ" if len(wrong) > 1 else ""
    text = f"{wrong[0]}{more}: the table does not follow from the calibrated dataset"
    return (Finding("table", "red", text),)


def _values_of_table(made: Table) -> Array:
    """Return the numbers of a table; NaN for empty cells."""
    return made.values if made.missing is None else np.where(made.missing, np.nan, made.values)


def _describe_wrong_values(
    keyed: KeyedTable, columns: list[str], made: Table, of_label: dict[str, Array]
) -> Iterator[str]:
    """Describe each value that differs."""
    places = [(column, keyed.table.column(column), made.columns.index(column)) for column in columns]
    for row in keyed.table.rows:
        label = _without_leading_zeros(keyed.label(row))
        if label not in of_label:
            continue
        share = AVERAGE_TOLERANCE if label == AVERAGES_ROW else ROW_TOLERANCE
        for column, there, here in places:
            text, ours = row.cells[there], float(of_label[label][here])
            if np.isfinite(ours) and not _is_near(text, ours, share):
                where = "on average" if label == AVERAGES_ROW else f"for {keyed.label(row)}"
                yield f"the table says {column} {text or 'nothing'} {where}, its dataset gives {ours:.4g}"


def _is_near(text: str, ours: float, share: float) -> bool:
    """Whether a printed number equals ours within a relative tolerance, and a unit of its last digit if small."""
    number = parse_number(text)
    if number is None:
        return False
    mantissa, _, exponent = text.lower().partition("e")
    decimals = min(len(mantissa.partition(".")[2]) - int(exponent or 0), 300)
    coarse = share * abs(ours) if share == AVERAGE_TOLERANCE else MAX_DIGIT_TOLERANCE
    return abs(number - ours) <= share * abs(ours) + max(min(10.0**-decimals, coarse), 1e-4)


def _without_leading_zeros(label: str) -> str:
    """Return a row's label without leading zeros: "7" and "007" are one collection, "0-1" and "000-001" one pair."""
    return "-".join(part.lstrip("0") or "0" if part.isdigit() else part for part in label.split("-"))


def not_evaluated(rms_px: float | None, noise_px: float) -> tuple[Finding, ...]:
    """Check a table of unknown kind: a failure if its RMS is below the labels' noise.

    Args:
        rms_px: the average of the table; None where it has none.
        noise_px: root mean square of the reprojection errors at our optimum; NaN if there is no camera.
    """
    if rms_px is not None and rms_px < NO_NOISE * noise_px:
        text = (
            f"the table says RMS {rms_px:.4g} px, but the noise of the labels leaves {noise_px:.4g} px at the optimum"
        )
        return (Finding("table", "red", text, value=rms_px, unit="px"),)
    return (Finding("table", "note", "the table is not verified: evaluate does not say which one it is"),)
