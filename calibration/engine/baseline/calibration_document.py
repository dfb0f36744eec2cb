"""Calibration as a document, the same in a cell's results, in the baseline and in an export: comparable numbers."""

import hashlib
import json
from collections.abc import Collection, Iterator, Mapping
from functools import cached_property
from typing import Annotated, Any, Literal

import numpy as np

from calibration import __version__
from calibration.base.arrays import Array
from calibration.base.records import Misfit, at_least, between, computed, document_of, field, length, matching, record
from calibration.engine.dataset.model import CornerLabels, Dataset, Edge, Labels, PointLabels, label_arrays, label_count
from calibration.engine.estimation.covariance.result import CalibratedJoint, Calibration
from calibration.engine.estimation.least_squares.noise_levels import NoiseLevels
from calibration.engine.estimation.options import Options
from calibration.engine.estimation.problem.blocks import CalibratedIntrinsics
from calibration.engine.estimation.problem.fixing import RIGID_TOLERANCE
from calibration.engine.geometry.rotations import to_rpy
from calibration.engine.geometry.transforms import adjoint, from_xyz_rpy, inverse, translation
from calibration.engine.tasks.robot_task import TaskUnit

Number = Annotated[float, between(-1e9, 1e9)]
Positive = Annotated[float, between(0, 1e9)]
Three = Annotated[tuple[Number, ...], length(3, 3)]
Sigmas = Annotated[tuple[Positive, ...], length(3, 3)]
Six = Annotated[tuple[Number, ...], length(6, 6)]
Count = Annotated[int, at_least(0)]
Name = Annotated[str, length(1, 500)]
COVERAGE_CELLS = 4
"""The coverage of the image is counted in a grid of this number of cells per side."""
MAX_NEGLIGIBLE_SHARE = 1e-3
"""Fraction of a variance below which a contribution is not stored separately."""
POSITIONS_INPUT = "the robot's moving transforms"
"""Name of the input that differs between any two recordings."""
MIN_EIGENVALUE = -1e-4
"""Lower limit of the smallest eigenvalue of correlations; a more negative one is not rounding error."""


@record
class CalibratedPose:
    """Calibrated transform. Its covariance is that of a twist, (translation, rotation) in the child frame.

    Fixed parameters that are not exactly known (intrinsics, the board, an arm) have the same error in every recording
    of a robot, so their effects are stored separately: ``C = C_own + sum m m^T`` over the effects m in `held`.
    """

    parent: Name = field("The parent frame.")
    child: Name = field("The child frame.")
    xyz_mm: Three = field("Translation.", unit="mm")
    rpy_deg: Three = field("Rotation as roll, pitch and yaw.", unit="degrees")
    sensor: Name | None = field("The sensor that it calibrates, if any.", default=None)
    own_mm: Sigmas | None = field(
        "Standard deviations of the translation, without the effects of fixed parameters; absent for a fixed pose.",
        unit="mm",
        default=None,
    )
    own_deg: Sigmas | None = field("Standard deviations of the rotation, likewise.", unit="degrees", default=None)
    correlations: tuple[Annotated[float, between(-1, 1)], ...] | None = field(
        "Correlations of these six, below the diagonal, row by row.", default=None
    )
    held: Mapping[str, tuple[Six, ...]] = field(
        "Effects of fixed parameters that are not exactly known: by what an error of one standard deviation moves "
        "the pose, mm and degrees; the same error in every recording of this robot.",
        default_factory=dict,
    )
    label_sigma_mm: Positive | None = field(
        "Standard deviation of the translation by the labels' noise alone, the norm of three axes.",
        unit="mm",
        default=None,
    )
    label_sigma_deg: Positive | None = field(
        "Standard deviation of the rotation by the labels' noise alone, the norm of three axes.",
        unit="degrees",
        default=None,
    )

    def __post_init__(self) -> None:
        """Refuse correlations that no covariance has.

        Raises:
            Misfit: they are not 15, or some combination of the six would have a negative variance.
        """
        parts = (self.own_mm, self.own_deg, self.correlations)
        if any(part is None for part in parts) != all(part is None for part in parts):
            raise Misfit("expected own-mm, own-deg and correlations, or none of them")
        if self.correlations is not None:
            if len(self.correlations) != 15:
                raise Misfit(f"found {len(self.correlations)} numbers, expected 15", "correlations")
            if np.linalg.eigvalsh(self._correlation)[0] < MIN_EIGENVALUE:
                raise Misfit("these are no correlations: a variance would be negative", "correlations")

    @property
    def edge(self) -> Edge:
        """Parent and child."""
        return self.parent, self.child

    @property
    def name(self) -> str:
        """Name of the pose in messages."""
        return self.sensor or f"{self.parent} to {self.child}"

    @property
    def matrix(self) -> Array:
        """``T_parent_child`` (4, 4)."""
        return from_xyz_rpy(1e-3 * np.array(self.xyz_mm), np.radians(self.rpy_deg))

    @cached_property
    def covariance(self) -> Array | None:
        """Total covariance (6, 6), m and rad; None for a fixed pose."""
        if self.own_mm is None or self.own_deg is None:
            return None
        sigmas = np.concatenate([1e-3 * np.array(self.own_mm), np.radians(self.own_deg)])
        moves = [each for name in self.held for each in self.moves(name)]
        covariance: Array = self._correlation * np.outer(sigmas, sigmas)
        return covariance + sum(np.outer(each, each) for each in moves)

    def moves(self, held: str) -> Array:
        """Effects (k, 6) of a fixed input on the pose, for one standard deviation of each, m and rad."""
        return np.asarray(np.array(self.held[held]) * np.array([1e-3] * 3 + [np.pi / 180] * 3))

    @property
    @computed("sigma-mm")
    def sigma_mm(self) -> tuple[float, ...] | None:
        """Standard deviations of the translation, mm, in total."""
        return self._sigmas(slice(3), 1e3)

    @property
    @computed("sigma-deg")
    def sigma_deg(self) -> tuple[float, ...] | None:
        """Standard deviations of the rotation, degrees, in total."""
        return self._sigmas(slice(3, 6), 180 / np.pi)

    def _sigmas(self, part: slice, unit: float) -> tuple[float, ...] | None:
        if self.covariance is None:
            return None
        return _significant_values(unit * np.sqrt(np.diagonal(self.covariance)[part]), 4)

    @property
    def norm_mm(self) -> float:
        """Standard deviation of the translation, norm over three axes, mm; 0 for a fixed pose."""
        return float(np.linalg.norm(self.sigma_mm)) if self.sigma_mm else 0.0

    @cached_property
    def _correlation(self) -> Array:
        correlation = np.zeros((6, 6))
        correlation[np.tril_indices(6, -1)] = self.correlations or ()
        return np.eye(6) + correlation + correlation.T


@record
class CalibratedParameter:
    """Calibrated parameter of a joint or a camera."""

    of: Name = field("The joint or the camera.")
    parameter: Name = field("Name of the parameter.")
    value: Number = field("The calibrated value.")
    unit: Literal["m", "rad", "px", "1"] = field("Unit of value and sigmas.")
    sigma: Positive = field("Standard deviation, in all.")
    label_sigma: Positive | None = field("Standard deviation by the labels' noise alone, where known.", default=None)

    @property
    def name(self) -> str:
        """Name of the parameter in messages."""
        return f"{self.of}'s {self.parameter}"


@record
class TaskDocument:
    """Error of a task of the robot at its worst point."""

    median: Positive = field("What it does not exceed with a probability of one half, in the task's unit.")
    most: Positive = field("What it does not exceed in 95 % of cases.")
    unit: TaskUnit = field("Of these, and of the limit.")
    limit: Positive | None = field("The largest that passes.", default=None)


@record
class SoftwareStart:
    """Result of a team's software on a system from one initial guess."""

    translation_noise: Positive = field("Noise of the initial translation.", unit="m")
    rotation_noise: Positive = field("Noise of the initial rotation.", unit="rad")
    seed: Count = field("Seed of the noise.")
    passed: bool = field("Whether the cell passed.")
    rms_px: Positive | None = field("Root mean square of its table.", unit="px", default=None)
    distance_mm: Positive | None = field("Distance of its result from the optimum.", unit="mm", default=None)

    @property
    def start(self) -> tuple[float, float, int]:
        """Translation noise, rotation noise and seed."""
        return self.translation_noise, self.rotation_noise, self.seed


@record
class PromiseDocument:
    """What the poses that were advised are expected to bring."""

    poses: Count = field("Number of the poses.")
    sizes: Mapping[str, Mapping[Literal["mm", "deg", "px"], Positive]] = field(
        "Standard deviation afterwards by sensor or joint and unit; of a task the error that 95 % stay below."
    )


@record(kw_only=True)
class CalibrationDocument:
    """A calibration of one system."""

    data: Annotated[str, matching("[0-9a-f]{64}", "64 hexadecimal digits")] = field(
        "SHA-256 of the labels: with another one the data are others."
    )
    inputs: Mapping[str, Annotated[str, matching("[0-9a-f]{16}", "16 hexadecimal digits")]] = field(
        "Hashes of the other inputs: camera_info, patterns, fixed transforms of the robot, options.",
        default_factory=dict,
    )
    collections: Count = field("Collections in the data.")
    engine: Name = field("The version that calibrated.")
    poses: tuple[CalibratedPose, ...] = field("Calibrated transforms.")
    parameters: tuple[CalibratedParameter, ...] = field("Calibrated parameters of joints and cameras.", default=())
    lens_correlations: Mapping[str, tuple[Annotated[float, between(-1, 1)], ...]] = field(
        "By camera, the correlations of its parameters in their order, below the diagonal, row by row.",
        default_factory=dict,
    )
    rms_px: Positive | None = field(
        "Root mean square of the table, or of the reprojected corners.", unit="px", default=None
    )
    averages: Mapping[str, float] = field("Averages of the table's columns.", default_factory=dict)
    noise: NoiseLevels = field("Standard deviations of the labels.", default_factory=NoiseLevels)
    effective_collections: Positive | None = field(
        "Number of independent collections of equal weight with the same information.", default=None
    )
    tasks: Mapping[str, TaskDocument] = field("Errors of the robot's tasks, by name.", default_factory=dict)
    promise: PromiseDocument | None = field("What further poses were expected to bring.", default=None)
    rejected_labels: Count = field("Labels that do not fit.")
    labels: Count = field("Labels in all: corners, points.")
    iterations: Count = field("Of the solver.")
    views: Mapping[str, Count] = field("Views of a pattern, by sensor.")
    covered: Mapping[str, Annotated[float, between(0, 1)]] = field(
        f"Part of each camera's image, of {COVERAGE_CELLS * COVERAGE_CELLS} cells, in which there are corners.",
        default_factory=dict,
    )
    extents: Mapping[str, Positive] = field(
        "Median extent of the pattern in each camera's image, px; its distance from a LiDAR or a depth camera, m.",
        default_factory=dict,
    )
    passed: Count | None = field("Starts that passed.", default=None)
    starts: Count | None = field("Starts in all.", default=None)
    software: tuple[SoftwareStart, ...] = field("Results of the team's software from each initial guess.", default=())
    although: Name | None = field("Reason for accepting it although the verdict was fail.", default=None)

    def lens(self, camera: str) -> tuple[tuple[str, ...], Array, Array] | None:
        """Return the names, values (k,) and covariance (k, k) of a camera's parameters; None if it has none."""
        own = [each for each in self.parameters if each.of == camera]
        correlations, k = self.lens_correlations.get(camera, ()), len(own)
        if not own or len(correlations) != k * (k - 1) // 2:
            return None
        matrix = np.zeros((k, k))
        matrix[np.tril_indices(k, -1)] = correlations
        sigmas = np.array([each.sigma for each in own])
        covariance = (np.eye(k) + matrix + matrix.T) * np.outer(sigmas, sigmas)
        return tuple(each.parameter for each in own), np.array([each.value for each in own]), covariance


def document_of_calibration(
    calibration: Calibration, given: Dataset, rms_px: float | None, options: Options | None = None
) -> CalibrationDocument:
    """Return the document of a converged calibration.

    Args:
        calibration: the result of the engine.
        given: the dataset that was calibrated.
        rms_px: RMS of its table of errors, px.
        options: options of the calibration.
    """
    return CalibrationDocuments(given, options or Options()).of(calibration, rms_px)


class CalibrationDocuments:
    """Documents of several calibrations of one dataset with the same options; what they share is computed once."""

    def __init__(self, given: Dataset, options: Options) -> None:
        self._given, self._options = given, options
        self._inputs: dict[frozenset[Edge], dict[str, str]] = {}

    @cached_property
    def data(self) -> str:
        """SHA-256 of the dataset's labels."""
        return hash_of_labels(self._given)

    @cached_property
    def _of_dataset(self) -> dict[str, Any]:
        given = self._given
        return {
            "data": self.data,
            "collections": len(given.collections),
            "labels": sum(label_count(label) for _, label in _labels(given)),
            "views": _views(given),
            "covered": _covered(given),
            "extents": _median_extents(given),
        }

    def of(self, calibration: Calibration, rms_px: float | None) -> CalibrationDocument:
        """Return the document of a converged calibration; see `document_of_calibration`."""
        sensors: dict[Edge, str] = {}
        for each in calibration.dataset.sensors.values():
            sensors.setdefault(each.edge, each.name)
        noise, bars = calibration.noise_levels.given(), calibration.error_bars
        return CalibrationDocument(
            **self._of_dataset,
            inputs=self._hashes(frozenset(calibration.transforms)),
            engine=__version__,
            poses=tuple(
                _calibrated_pose(calibration, edge, T, sensors.get(edge))
                for edge, T in sorted(_at_description(calibration, self._given))
            ),
            parameters=tuple(_calibrated_parameters(calibration)),
            lens_correlations={name: _lens_correlations(each) for name, each in calibration.intrinsics.items()},
            rms_px=None if rms_px is None else significant_value(rms_px, 6),
            noise=NoiseLevels(**{k: significant_value(v, 4) for k, v in noise.items()}),
            effective_collections=significant_value(bars.effective_collections, 3) if bars else None,
            rejected_labels=len(calibration.rejected),
            iterations=calibration.iterations,
        )

    def _hashes(self, calibrated: frozenset[Edge]) -> dict[str, str]:
        if calibrated not in self._inputs:
            self._inputs[calibrated] = hashes_of_inputs(self._given, calibrated, self._options)
        return self._inputs[calibrated]


def hash_of_labels(dataset: Dataset) -> str:
    """Return the SHA-256 of a dataset's labels."""
    found = hashlib.sha256()
    for key, label in _labels(dataset):
        arrays = label_arrays(label)
        found.update("\0".join((*key, *(str(array.shape) for array in arrays))).encode() + b"\0")
        for array in arrays:
            found.update(np.ascontiguousarray(array, "<i8" if array.dtype.kind == "i" else "<f8").tobytes())
    return found.hexdigest()


def hashes_of_inputs(given: Dataset, calibrated: Collection[Edge], options: Options) -> dict[str, str]:
    """Return hashes of a calibration's inputs other than the labels, by their names in messages.

    Args:
        given: the dataset.
        calibrated: the calibrated transforms; all others are fixed.
        options: options of the calibration.
    """
    found = {}
    for name, sensor in sorted(given.sensors.items()):
        if (camera := sensor.camera) is not None:
            model = f"{camera.distortion.ros_name} {camera.width} {camera.height}"
            found[f"camera_info of {name}"] = _hash_numbers(model, camera.intrinsics)
    for name, pattern in sorted(given.patterns.items()):
        found[f"pattern {name}"] = _hash_numbers("", pattern.corners, pattern.outline)
    held = {edge: np.nan_to_num(T) for edge, T in sorted(given.transforms.items()) if edge not in calibrated}
    fixed = {edge: T[:1] for edge, T in held.items() if np.abs(T - T[0]).max() < RIGID_TOLERANCE}
    moving = {edge: T for edge, T in held.items() if edge not in fixed}
    found["the robot's fixed transforms"] = _hash_numbers(repr(list(fixed)), *fixed.values())
    found[POSITIONS_INPUT] = _hash_numbers(repr(list(moving)), *moving.values())
    asked = {key: value for key, value in document_of(options).items() if key != "start"}  # not of the optimum
    found["options"] = _hash_numbers(json.dumps(asked, sort_keys=True, default=str))
    return found


def _hash_numbers(text: str, *arrays: Array) -> str:
    """Hash numbers rounded to 1e-9: the last bits of a result may differ between processors."""
    found = hashlib.sha256(text.encode())
    for array in arrays:
        found.update(np.ascontiguousarray(np.round(array, 9) + 0.0, "<f8").tobytes())
    return found.hexdigest()[:16]


def _labels(dataset: Dataset) -> Iterator[tuple[tuple[str, str, str], Labels]]:
    for collection in dataset.collections:
        for (pattern, sensor), label in sorted(collection.labels.items()):
            yield (collection.key, pattern, sensor), label


def _at_description(calibration: Calibration, given: Dataset) -> Iterator[tuple[Edge, Array]]:
    """Return the calibrated transforms by edge, independent of the initial guess.

    If only relative poses are determined, one sensor is fixed at its initial guess: all sensors are moved together
    so that it is where the dataset has it, ``T_p_s' = T_p_g D T_g_p T_p_s`` with ``D = T_g_h (given) T_h_g``. A pattern
    that was fixed for the same reason is left out.
    """
    patterns = {pattern.edge for pattern in calibration.dataset.patterns.values()}
    edges = {sensor.edge for sensor in calibration.dataset.sensors.values()}
    held = calibration.dataset.sensors[calibration.gauge].edge if calibration.gauge else None
    for edge, T in calibration.transforms.items():
        if edge in patterns and edge not in calibration.covariances:
            continue
        if held is None or edge not in edges:
            yield edge, T
            continue
        to_held = given.transform(edge[0], held[0])
        rigid = np.abs(to_held - to_held[0]).max() < RIGID_TOLERANCE
        moved = given.transforms[held][0] @ inverse(calibration.transforms[held])
        yield edge, to_held[0] @ moved @ inverse(to_held[0]) @ T if rigid else T


def _calibrated_pose(calibration: Calibration, edge: Edge, T: Array, sensor: str | None) -> CalibratedPose:
    C = calibration.covariances.get(edge)
    xyz, rpy = _round_values(1e3 * T[:3, 3], 6), _round_values(np.degrees(to_rpy(T[:3, :3])), 9)
    if C is None:
        return CalibratedPose(*edge, xyz, rpy, sensor)
    moved = _moved_by_held(calibration, edge)
    held = {name: rows for name, moves in moved.items() if (rows := _relevant_moves(moves, C))}
    own = C - sum((moves @ moves.T for name, moves in moved.items() if name in held), 0 * C)
    sigmas = np.sqrt(np.maximum(np.diagonal(own), 1e-30))
    correlation = own / np.outer(sigmas, sigmas)
    return CalibratedPose(
        *edge,
        xyz,
        rpy,
        sensor,
        _significant_values(1e3 * sigmas[:3], 4),
        _significant_values(np.degrees(sigmas[3:]), 4),
        _round_values(np.clip(correlation[np.tril_indices(6, -1)], -1, 1), 5),
        held,
        significant_value(calibration.label_sigma_mm(edge), 4),
        significant_value(float(np.degrees(1e-3 * calibration.label_sigma_mrad(edge))), 4),
    )


def _moved_by_held(calibration: Calibration, edge: Edge) -> dict[str, Array]:
    """Effects (6, k) of each fixed input's assumed errors on a transform, m and rad."""
    setup, bars = calibration.solution.setup, calibration.error_bars
    at = setup.problem.shared_parameters[setup.block(edge)]
    frames = {
        pattern.edge: adjoint(translation(pattern.centre)) for pattern in calibration.dataset.patterns.values()
    }  # the engine's frame of a pattern is at its centre
    to_frame = frames.get(edge, np.eye(6))
    return {name: to_frame @ moves[at] for name, moves in bars.held.items()} if bars else {}


def _relevant_moves(moves: Array, C: Array) -> tuple[tuple[float, ...], ...]:
    """Effects of fixed inputs in the file's form; empty if they are a negligible part of the covariance."""
    if (np.square(moves) < MAX_NEGLIGIBLE_SHARE * np.diagonal(C)[:, None]).all():
        return ()
    return tuple(_significant_values(row, 4) for row in (moves * np.array([1e3] * 3 + [180 / np.pi] * 3)[:, None]).T)


def _calibrated_parameters(calibration: Calibration) -> Iterator[CalibratedParameter]:
    for name, joint in calibration.joints.items():
        yield from _parameters_of(name, joint, tuple(significant_value(v, 4) for v in joint.label_sigmas))
    for name, camera in calibration.intrinsics.items():
        yield from _parameters_of(name, camera, (None,) * len(camera.parameters))


def _parameters_of(
    name: str, found: CalibratedJoint | CalibratedIntrinsics, of_labels: tuple[float | None, ...]
) -> Iterator[CalibratedParameter]:
    rows = zip(found.parameters, found.values.tolist(), found.units, found.sigmas.tolist(), of_labels, strict=True)
    for parameter, value, unit, sigma, own in rows:
        yield CalibratedParameter(name, parameter, significant_value(value, 12), unit, significant_value(sigma, 4), own)


def _lens_correlations(found: CalibratedIntrinsics) -> tuple[float, ...]:
    correlations = found.covariance / np.outer(found.sigmas, found.sigmas)
    return _round_values(np.clip(correlations[np.tril_indices(len(correlations), -1)], -1, 1), 6)


def _views(dataset: Dataset) -> dict[str, int]:
    seen = [sensor for collection in dataset.collections for _, sensor in collection.labels]
    return {name: seen.count(name) for name in sorted(dataset.sensors)}


def _covered(dataset: Dataset) -> dict[str, float]:
    """Fraction of each camera's image covered by corners."""
    found = {}
    for name, sensor in sorted(dataset.sensors.items()):
        if sensor.camera is None or not sensor.modality.has_corners:
            continue
        size = np.array([sensor.camera.width, sensor.camera.height])
        cells: set[tuple[int, ...]] = set()
        for (_, _, of), label in _labels(dataset):
            if of == name and isinstance(label, CornerLabels):
                cells.update(
                    map(
                        tuple, np.clip(label.pixels * COVERAGE_CELLS / size, 0, COVERAGE_CELLS - 1).astype(int).tolist()
                    )
                )
        found[name] = round(len(cells) / COVERAGE_CELLS**2, 4)
    return found


def _median_extents(dataset: Dataset) -> dict[str, float]:
    """Return the median extent of the corners of each camera's views, px, and the median distance of points, m."""
    found: dict[str, list[float]] = {}
    for (_, _, sensor), label in _labels(dataset):
        if isinstance(label, CornerLabels):
            found.setdefault(sensor, []).append(float(np.linalg.norm(np.ptp(label.pixels, axis=0))))
        elif isinstance(label, PointLabels) and len(label.points):
            found.setdefault(sensor, []).append(float(np.linalg.norm(np.median(label.points, axis=0))))
    return {name: significant_value(float(np.median(values)), 4) for name, values in sorted(found.items())}


def _round_values(values: Array, digits: int) -> tuple[float, ...]:
    return tuple(round(float(v), digits) + 0.0 for v in values)


def _significant_values(values: Array, digits: int) -> tuple[float, ...]:
    """Round to a number of significant digits, and to 1e-9."""
    return tuple(round(significant_value(float(v), digits), 9) + 0.0 for v in values)


def significant_value(value: float, digits: int) -> float:
    """Round to a number of significant digits."""
    return float(f"{value:.{digits}g}")
