"""Intrinsics beside the poses: truth, error bars, and time against mrcal from the same start to the same optimum."""

import statistics
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from benchmarks.peers import SAME_COST, PeerError, Solution, mrcal
from benchmarks.rig_arrays import RigArrays, corner_pixels
from benchmarks.rows import Bar, Row
from benchmarks.scenes import CAMERA, rig
from benchmarks.timing import seconds
from calibration.base.arrays import Array
from calibration.engine.estimation.calibrate import Options, calibrate
from calibration.engine.estimation.covariance.result import Calibration
from calibration.engine.estimation.least_squares.minimisation import minimise
from calibration.engine.estimation.least_squares.noise_levels import NoiseLevels
from calibration.engine.estimation.least_squares.normal_equations import Weighting
from calibration.engine.estimation.problem.blocks import CalibratedIntrinsics, Values
from calibration.engine.estimation.problem.problem import Problem
from calibration.engine.estimation.start.build import build
from calibration.engine.estimation.start.linear_start import linear_start
from calibration.engine.geometry.cameras import Camera
from calibration.engine.geometry.lenses import Distortion, Equidistant, PlumbBob, Rational
from calibration.engine.geometry.transforms import inverse, local, translation
from tests.engine.estimation.scenes import camera, relative
from tests.engine.estimation.systems import covering

LENSES: tuple[Distortion, ...] = (
    PlumbBob(-0.10, 0.05, 0.001, -0.0005, 0.01),
    Rational(-0.3, 0.1, 0.001, -0.002, 0.02, 0.1, -0.1, 0.08),
    Equidistant(-0.02, 0.01, -0.003, 0.001),
)
OFF = np.array([1.02, 0.98, 1.01, 0.99, 0.9, 0.9, 0.9, 0.9, 0.9])
"""How far the start of plumb_bob's intrinsics is off."""
PLAIN = Weighting({"pixel": 1.0}, None)
KNOWN = np.array([3.0, 3.0, 4.0, 4.0, 0.01, 0.01, 0.001, 0.001, 0.005]) ** 2
"""Variances of intrinsics that are known beforehand."""


def measure(quick: bool) -> Iterator[Row]:
    """Truth, error bars with and without what is known beforehand, and mrcal."""
    scenes = 30 if quick else 100
    for distortion in LENSES:
        yield _truth(distortion)
        yield from _error_bars(distortion, scenes)
    yield from _known_beforehand(scenes)
    yield from _against_mrcal(2, 200, True, Bar(high=0.5), 3 if quick else 9)
    yield from _against_mrcal(8, 500, False, Bar(high=0.2), 3 if quick else 5)
    yield from _against_mrcal(8, 500, True, None, 1 if quick else 3)


def _lens(distortion: Distortion) -> Camera:
    return Camera(600.0, 590.0, 640.0, 480.0, 1280, 960, distortion)


def _truth(distortion: Distortion) -> Row:
    model = _lens(distortion)
    dataset = covering(model=model).dataset()
    size = np.concatenate([[1.02, 0.98, 1.01, 0.99], np.full(len(model.intrinsics) - 4, 0.9)])
    start = dataset.with_cameras({name: model.with_intrinsics(model.intrinsics * size) for name in dataset.sensors})
    result = calibrate(start, Options(intrinsics=("all",)))
    worst = max(float(np.abs(each.values / model.intrinsics - 1).max()) for each in result.intrinsics.values())
    note = "exact labels, the worst parameter, starts 2 % off, coefficients 10 %"
    return Row(f"intrinsics/truth, {distortion.ros_name}", worst, "relative", Bar(high=1e-6), note)


def _error_bars(distortion: Distortion, scenes: int) -> Iterator[Row]:
    model = _lens(distortion)
    own, poses = [], []
    for seed in range(scenes):
        dataset = covering(30, seed, model=model, pixel_noise=0.3).dataset(seed)
        result = calibrate(dataset, Options(intrinsics=("all",), loss="linear"))
        own += [_nees(each.values - model.intrinsics, each.covariance) for each in result.intrinsics.values()]
        poses.append(_pose_nees(result, dataset.transforms))
    for what, values in (("intrinsics", own), ("extrinsics", poses)):
        note = f"of its expectation, {scenes} scenes of 2 cameras x 30 collections"
        yield Row(f"intrinsics/NEES of {what}, {distortion.ros_name}", float(np.mean(values)), "", Bar(0.8, 1.2), note)


def _known_beforehand(scenes: int) -> Iterator[Row]:
    """Cameras drawn from what is known of them: calibrated with it as a prior, or kept and considered."""
    model = _lens(LENSES[0])
    known = CalibratedIntrinsics("plumb_bob", model.parameters, model.intrinsics, np.diag(KNOWN))
    for what, intrinsics in (("a prior", ("all",)), ("considered", ())):
        options = Options(
            loss="linear",
            noise_levels=NoiseLevels(pixel=0.3),
            intrinsics=intrinsics,
            intrinsics_covariance={"c0": known, "c1": known},
        )
        poses = []
        for seed in range(scenes):
            rng = np.random.default_rng(seed)
            drawn = [model.with_intrinsics(model.intrinsics + np.sqrt(KNOWN) * rng.normal(size=9)) for _ in range(2)]
            scene = covering(30, seed, pixel_noise=0.3)
            sensors = [camera(f"c{k}", model=each) for k, each in enumerate(drawn)]
            truth = replace(scene, sensors=sensors).dataset(seed)
            result = calibrate(truth.with_cameras(dict.fromkeys(truth.sensors, model)), options)
            poses.append(_pose_nees(result, truth.transforms))
        note = f"of its expectation, {scenes} scenes, intrinsics drawn from their covariance"
        yield Row(f"intrinsics/NEES of extrinsics, {what}", float(np.mean(poses)), "", Bar(0.8, 1.2), note)


def _nees(error: Array, covariance: Array) -> float:
    return float(error @ np.linalg.solve(covariance, error)) / len(error)


def _pose_nees(result: Calibration, truth: "dict[tuple[str, str], Array]") -> float:
    first, second = (sensor.edge for sensor in result.dataset.sensors.values())
    error = local(relative(result)[second], inverse(truth[first][0]) @ truth[second][0])
    return _nees(error, result.label_covariances[second])


@dataclass(frozen=True, eq=False)
class _Rig:
    """A rig as the engine and as mrcal have it, with the same start."""

    problem: Problem
    start: Values
    arrays: RigArrays
    pixels: Array
    """(C, N, K, 2)."""

    def cost(self, T_camera_world: Array, T_world_board: Array, intrinsics: Array) -> float:
        """The sum of squared residuals in px^2: one judge for both."""
        total = 0.0
        for T, values, pixels in zip(T_camera_world, intrinsics, self.pixels, strict=True):
            poses = T @ T_world_board
            points = self.arrays.corners @ np.swapaxes(poses[:, :3, :3], 1, 2) + poses[:, None, :3, 3]
            total += float(((CAMERA.with_intrinsics(values).project(points) - pixels) ** 2).sum())
        return total


def _rig(cameras: int, collections: int, free: bool) -> _Rig:
    dataset, T_world_camera = rig(collections, cameras)
    nominal = CAMERA.with_intrinsics(CAMERA.intrinsics * OFF) if free else CAMERA
    dataset = dataset.with_cameras(dict.fromkeys(dataset.sensors, nominal))
    setup = build(dataset, intrinsics=("all",) if free else ())
    (pattern,) = dataset.patterns.values()
    boards = np.broadcast_to(np.eye(4), (collections, 4, 4)).copy()
    start = linear_start(setup, (*T_world_camera, boards, *(cameras * [nominal.intrinsics] if free else []))).values
    pixels = np.stack([corner_pixels(collection) for collection in dataset.collections], 1)
    arrays = RigArrays(
        np.ascontiguousarray(np.swapaxes(pixels, -1, -2)).reshape(cameras * collections, 2, -1),
        pattern.corners,
        nominal.intrinsics,
        inverse(np.stack(start[:cameras])),
        start[cameras] @ inverse(translation(pattern.centre)),
        free,
    )
    return _Rig(setup.problem, start, arrays, pixels)


def _against_mrcal(cameras: int, collections: int, free: bool, bar: Bar | None, rounds: int) -> Iterator[Row]:
    name = f"intrinsics/mrcal, {cameras} x {collections}, {'free' if free else 'held'}"
    peer = mrcal()
    if isinstance(peer, str):
        yield Row(name, bar=bar, skipped=peer)
        return
    problem = _rig(cameras, collections, free)
    solve = partial(minimise, problem.problem, problem.start, PLAIN)
    ours: list[float] = []
    theirs: list[float] = []
    for _ in range(rounds):
        ours.append(statistics.median(seconds(solve) for _ in range(3)))
        try:
            solution = peer(problem.arrays)
        except PeerError as error:
            yield Row(name, bar=bar, note=str(error))
            return
        theirs.append(solution.seconds)
    difference = _cost_of(problem, solution) / solve().cost - 1
    ratio = statistics.median(our / their for our, their in zip(ours, theirs, strict=True))
    note = (
        f"{1e3 * statistics.median(ours):.0f} ms against {1e3 * statistics.median(theirs):.0f} ms, least squares alone"
    )
    yield Row(name, ratio, "of its time", bar, note)
    yield Row(
        f"{name}, cost", abs(difference), "relative", Bar(high=SAME_COST), f"theirs over ours - 1: {difference:.1e}"
    )


def _cost_of(problem: _Rig, solution: Solution) -> float:
    held = np.tile(problem.arrays.intrinsics, (len(solution.T_camera_world), 1))
    intrinsics = held if solution.intrinsics is None else solution.intrinsics
    return problem.cost(solution.T_camera_world, solution.T_world_board, intrinsics)
