"""Comparison of a result with the robot's description: positions, distances and identities of sensors.

The description is the dataset's original transforms, such as those of a URDF. If it has the identity as a sensor's
transform, it contains no information about that sensor.
"""

from collections.abc import Mapping
from functools import lru_cache
from itertools import combinations

import numpy as np

from calibration.base.arrays import Array
from calibration.engine.dataset.model import Dataset, Sensor
from calibration.engine.diagnosis.finding import Finding, Severity
from calibration.engine.diagnosis.units import square
from calibration.engine.estimation.covariance.result import Calibration
from calibration.engine.estimation.options import Options
from calibration.engine.geometry.transforms import distance, inverse

MAX_DISTANCE = (0.25, 0.25)
"""m, rad: a sensor farther than this from the description's pose is not of the robot described."""
IDENTITY_TOLERANCE = 1e-6
"""m, rad: a transform closer to the identity carries no information."""
SCALE_TOLERANCE = 0.05
"""Relative tolerance of the scale: a smaller deviation from 1 may be an error of the description."""
LEAST_SCALED = 0.01
"""m: distances that differ by less may be errors of the description too."""
BY_CHANCE = 0.003
"""Significance level of a scale: errors in random directions would yield as good a fit in this share of cases."""
MAX_EXCHANGED_RATIO = 0.2
"""Sensors are exchanged if that reduces the distance from the description to less than this fraction."""
LEAST_EXCHANGED = (0.02, 0.05)
"""m, rad: sensors closer to each other cannot be distinguished by their poses."""

RelativePoses = Mapping[tuple[str, str], Array]


def exchanged_or_scaled(calibration: Calibration, description: Dataset, options: Options) -> tuple[Finding, ...]:
    """Report what explains the whole difference from the description: a failure, unless it is declared rough.

    Only the best explanation is reported: two sensors with exchanged labels; distances between sensors that are all
    off by one factor, that of the pattern's size.

    Args:
        calibration: the result.
        description: the dataset without the noise of an initial guess.
        options: options of the calibration, and whether the description is rough.
    """
    severity: Severity = "note" if options.description == "rough" else "red"
    described, expected = _described_poses(description, calibration.gauge)
    found = _relative_poses(calibration.dataset, described)
    return _find_exchanged_sensors(described, expected, found, severity) or _find_common_scale(
        calibration, described, expected, found, severity
    )


def far_from_description(calibration: Calibration, description: Dataset, options: Options) -> tuple[Finding, ...]:
    """Report each sensor that is far from where the description puts it, as a failure; none if that is rough."""
    if options.description == "rough":
        return ()
    described, expected = _described_poses(description, calibration.gauge)
    found = _relative_poses(calibration.dataset, described)
    return _find_far_sensors(calibration, description, described, expected, found)


@lru_cache(maxsize=4)
def _described_poses(description: Dataset, gauge: str | None) -> tuple[tuple[Sensor, ...], RelativePoses]:
    """Return the sensors that the description has a pose for, including a fixed one, and its relative poses of them.

    They are the same for all calibrations of a dataset.
    """
    held = (gauge, description.anchored)
    sensors = tuple(
        sensor
        for sensor in description.sensors.values()
        if sensor.name in held or not _is_identity(description.transform(*sensor.edge)[0])
    )
    return sensors, _relative_poses(description, sensors)


def _is_identity(T: Array) -> bool:
    return max(float(d) for d in distance(T, np.eye(4))) < IDENTITY_TOLERANCE


def _relative_poses(dataset: Dataset, sensors: tuple[Sensor, ...]) -> RelativePoses:
    """Return ``T_a_b`` between the frames of any two sensors, both ways, that are rigidly connected."""
    found = {}
    for a, b in combinations(sensors, 2):
        T = dataset.transform(a.frame, b.frame)
        if np.ptp(T, axis=0).max() < IDENTITY_TOLERANCE:
            found[a.name, b.name], found[b.name, a.name] = T[0], inverse(T[0])
    return found


def _distance_with_names(expected: RelativePoses, found: RelativePoses, names: Mapping[str, str]) -> float:
    """Distance (root of the sum of squares, m and rad alike) between poses, with sensors renamed by ``names``."""
    apart = [
        np.hypot(*distance(expected[names.get(a, a), names.get(b, b)], T))
        for (a, b), T in found.items()
        if (names.get(a, a), names.get(b, b)) in expected
    ]
    return float(np.linalg.norm(apart))


def _find_exchanged_sensors(
    sensors: tuple[Sensor, ...], expected: RelativePoses, found: RelativePoses, severity: Severity
) -> tuple[Finding, ...]:
    """Find two sensors of a modality that fit the description far better when exchanged."""
    pairs = [
        (a.name, b.name)
        for a, b in combinations(sensors, 2)
        if a.modality == b.modality and (a.name, b.name) in expected and (a.name, b.name) in found
    ]
    if all(_is_near(expected[pair], found[pair]) for pair in pairs):
        return ()
    as_it_is = _distance_with_names(expected, found, {})
    misfits = {(a, b): _distance_with_names(expected, found, {a: b, b: a}) for a, b in pairs}
    a, b = min(misfits, key=lambda pair: misfits[pair])
    if misfits[a, b] > MAX_EXCHANGED_RATIO * as_it_is or _is_near(expected[a, b], found[a, b]):
        return ()
    t, r = _pair_of_floats(distance(expected[a, b], found[a, b]))
    there = _format_distance(*_pair_of_floats(distance(expected[b, a], found[a, b])))
    text = (
        f"the labels of '{a}' and '{b}' look exchanged: '{b}' comes out {_format_distance(t, r)} from where the "
        f"robot's description puts it, but only {there} from where '{a}' should be; look at the topics of the two "
        "sensors"
    )
    return (Finding("exchanged-sensors", severity, text, (a, b), value=t, unit="m"),)


def _is_near(expected: Array, found: Array) -> bool:
    """Whether two relative poses are too close to each other to tell an exchange."""
    t, r = _pair_of_floats(distance(expected, found))
    return t < LEAST_EXCHANGED[0] and r < LEAST_EXCHANGED[1]


def _find_common_scale(
    calibration: Calibration,
    sensors: tuple[Sensor, ...],
    expected: RelativePoses,
    found: RelativePoses,
    severity: Severity,
) -> tuple[Finding, ...]:
    """Find a common scale of all distances between sensors: the pattern's size, if nothing else fixes the scale.

    The factor is the least-squares one over the positions relative to the first sensor. Errors of the description in
    random directions cause an angle between the vectors of all positions, found and expected; the share of directions
    within such an angle, in d dimensions, is the integral of sin^(d-2).
    """
    names = [sensor.name for sensor in sensors]
    ways = [(names[0], other) for other in names[1:] if (names[0], other) in expected and (names[0], other) in found]
    if not ways:
        return ()
    was = np.concatenate([expected[way][:3, 3] for way in ways])
    came = np.concatenate([found[way][:3, 3] for way in ways])
    off = came - was
    if np.linalg.norm(off) < LEAST_SCALED or not was.any():
        return ()
    scale = float(came @ was / (was @ was))
    if abs(scale - 1) < SCALE_TOLERANCE or scale <= 0:
        return ()
    left = float(np.linalg.norm(came - scale * was) / np.linalg.norm(off))
    angles = np.linspace(0, np.pi / 2, 2001)
    directions: Array = np.sin(angles) ** (len(off) - 2)
    if float(directions[angles <= np.arcsin(min(left, 1.0))].sum()) > BY_CHANCE * directions.sum():
        return ()
    sides = {square(pattern) for pattern in calibration.dataset.patterns.values()}
    size = f": squares of {max(sides):.4g} m, but {max(sides) / scale:.3g} m would fit" if len(sides) == 1 else ", by"
    distances = f"'{ways[0][0]}' and '{ways[0][1]}' come" if len(ways) == 1 else "all sensors come"
    text = (
        f"the size of the pattern is probably wrong{size} the robot's description, from which {distances} out "
        f"{scale:.3g} times as far apart as it says; measure the squares"
    )
    sensors_ = tuple(dict.fromkeys(name for way in ways for name in way))
    return (Finding("pattern-size", severity, text, sensors_, value=scale - 1, unit="1"),)


def _find_far_sensors(
    calibration: Calibration,
    description: Dataset,
    sensors: tuple[Sensor, ...],
    expected: RelativePoses,
    found: RelativePoses,
) -> tuple[Finding, ...]:
    """Find sensors far from their described pose, relative to the fixed one if only relative poses are known."""
    findings = []
    held_at = calibration.gauge
    for sensor in sensors:
        if held_at is None:
            there = description.transform(*sensor.edge)[0], calibration.transforms[sensor.edge]
        elif (held_at, sensor.name) in found.keys() & expected.keys():
            there = expected[held_at, sensor.name], found[held_at, sensor.name]
        else:
            continue
        t, r = _pair_of_floats(distance(*there))
        if t > MAX_DISTANCE[0] or r > MAX_DISTANCE[1]:
            held = f", '{held_at}' being where it is" if held_at else ""
            text = (
                f"'{sensor.name}' comes out {_format_distance(t, r)} from where the robot's description puts it{held} "
                f"(limits {MAX_DISTANCE[0]:g} m, {np.degrees(MAX_DISTANCE[1]):.1f} degrees); look at the pattern's "
                "size and the labels, or, if the description is only a rough guess, say description: rough"
            )
            findings.append(Finding("far-from-description", "red", text, (sensor.name,), value=t, unit="m"))
    return tuple(findings)


def _pair_of_floats(values: tuple[Array, Array]) -> tuple[float, float]:
    return float(values[0]), float(values[1])


def _format_distance(translation: float, rotation: float) -> str:
    length = f"{translation:.2f} m" if translation >= 0.1 else f"{1e3 * translation:.1f} mm"
    return f"{length} and {np.degrees(rotation):.2f} degrees"
