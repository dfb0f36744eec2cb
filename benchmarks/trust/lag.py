"""A lag that is calibrated: of a camera on an arm that moves while it looks, and between two cameras.

The arm sways, and its poses and motions are read from records, as an import does. A board has a velocity and an
acceleration of its own in each collection, of which the dataset has the velocity with an error. The arm's camera, or
the second of two, sees everything later.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from benchmarks.rows import Bar, Row
from benchmarks.scenes import CAMERA, board, boards, rig
from benchmarks.workers import on_all_cores
from calibration.base.arrays import Array
from calibration.engine.dataset.model import Collection, CornerLabels, Dataset, Edge
from calibration.engine.estimation.calibrate import Options, calibrate
from calibration.engine.estimation.options import ALL_EXACT
from calibration.engine.geometry.rotations import exp
from calibration.engine.geometry.transforms import apply, from_xyz_rpy, inverse, local, retract, transform
from calibration.robot.importing.bags.motion import MotionLog

DRAWS, COLLECTIONS = 100, 30
MOST_LAG = 0.05
"""s."""
SWAY_HZ, RECORD_HZ = (0.1, 0.5), (20.0, 100.0)
"""How fast the arm sways, and how often its pose is recorded: from and to."""
SWAY = (0.12, 0.1, 0.15, 0.35, 0.35, 0.35)
"""How far it sways, m and rad."""
BOARD_AT = (0.0, 0.0, 0.9)
"""The board before the camera, m."""
RECORD_ERROR = (2e-5, 2e-5, 2e-5, 5e-5, 5e-5, 5e-5)
"""Standard deviation of recorded poses, m and rad."""
SPEED = (0.08, 0.08, 0.08, 0.25, 0.25, 0.25)
"""Standard deviation of velocities, m/s and rad/s."""
ACCELERATION = (0.1, 0.1, 0.1, 0.3, 0.3, 0.3)
"""Likewise, m/s^2 and rad/s^2."""
VELOCITY_ERROR = (0.002, 0.002, 0.002, 0.005, 0.005, 0.005)
"""Likewise, of the velocities in the dataset."""
FEW = 9
"""Moments of cameras without a common clock."""
UNSYNCHRONISED = 0.03
"""s: how early or late such a camera is at most, anew at each moment."""
NOISE = 0.3
"""px."""
WITHIN = 2.0
SHARE = Bar(low=0.9)
"""Of the lags within 2 sigma; of 100 whose error bars are right 95 are, and 90 or fewer once in 50 times."""
NEES = Bar(0.7, 1.3)


@dataclass(frozen=True)
class Draw:
    """Errors of one calibration."""

    in_sigmas: float
    """Error of the lag."""
    sigma_ms: float
    nees: float
    """``e^T C^-1 e / 6`` of the camera's transform."""


def rows(quick: bool) -> Iterator[Row]:
    """Lags within two standard deviations, and whether the transforms' error bars are honest beside a free lag."""
    count = 20 if quick else DRAWS
    for name, draw in (("arm", of_an_arm), ("stereo", of_two_cameras)):
        found = on_all_cores(draw, list(range(count)))
        within = float(np.mean([abs(each.in_sigmas) <= WITHIN for each in found]))
        note = f"{count} lags of 0 to 50 ms, ± {np.median([each.sigma_ms for each in found]):.2g} ms"
        yield Row(f"trust/lag, {name}, within 2 sigma", within, "", SHARE, note)
        yield Row(f"trust/lag, {name}, NEES/6", float(np.mean([each.nees for each in found])), "", NEES)
    scattering = on_all_cores(of_scattering_cameras, list(range(count)))
    yield Row("trust/no common clock, NEES/6", float(np.mean(scattering)), "", NEES, f"4 cameras, {FEW} moments")


def of_scattering_cameras(seed: int) -> float:
    """Return NEES/6 of a camera of four without a common clock, each of which sees 9 moments of a board or fewer."""
    rng = np.random.default_rng((3, seed))
    base, T_world_camera = rig(FEW, cameras=4, seed=seed)
    T_world_board = boards(rng, FEW, 0.18, base.patterns["board"])
    velocity = rng.normal(size=(FEW, 6)) * SPEED
    late = rng.uniform(-UNSYNCHRONISED, UNSYNCHRONISED, (4, FEW, 1))
    seen = {
        name: inverse(T) @ retract(T_world_board, delay * velocity)
        for name, T, delay in zip(base.sensors, T_world_camera, late, strict=True)
    }
    whole = _labelled(base, seen, rng)
    kept = [
        replace(
            c, labels={key: label for i, (key, label) in enumerate(c.labels.items()) if i < 2 or rng.random() < 0.5}
        )
        for c in whole.collections
    ]
    result = calibrate(replace(whole, collections=tuple(kept)), Options(assume=ALL_EXACT))
    edge = ("world", "camera_1_link")
    error = local(result.transforms[edge], T_world_camera[1])
    return float(error @ np.linalg.solve(result.covariances[edge], error)) / 6


def of_an_arm(seed: int) -> Draw:
    """A camera on a hand that sways before a board, as an import has it: images between the records of the hand."""
    rng = np.random.default_rng((1, seed))
    pattern = replace(board(), fixed=True)
    base, _ = rig(COLLECTIONS, cameras=1, seed=seed)
    T_world_board = from_xyz_rpy([0.8, 0.2, 0.1], [0.2, -0.1, 0.5])
    T_hand_camera = from_xyz_rpy([0.05, -0.03, 0.1], [0.1, 0.2, -1.4])
    frequencies, phases = rng.uniform(*SWAY_HZ, 6), rng.uniform(0, 2 * np.pi, 6)

    def hand_at(times: Array) -> Array:
        sway = np.array(SWAY) * np.sin(2 * np.pi * frequencies * times[:, None] + phases)
        R = exp(sway[:, 3:])
        T_camera_board = transform(R, sway[:, :3] + BOARD_AT - R @ pattern.centre)
        return T_world_board @ inverse(T_camera_board) @ inverse(T_hand_camera)

    hand, camera = ("world", "hand"), ("hand", "camera_0_link")
    log, step = MotionLog(), 1 / rng.uniform(*RECORD_HZ)
    records = np.arange(rng.uniform(0, step), COLLECTIONS + 2, step)
    recorded = retract(hand_at(records), rng.normal(size=(len(records), 6)) * RECORD_ERROR)
    for time, T in zip(records, recorded, strict=True):
        log.add_transform(hand, int(1e9 * time), T)
    lag, stamps = float(rng.uniform(0.0, MOST_LAG)), np.arange(1.0, COLLECTIONS + 1)
    motions = np.stack([log.motion(hand, 1e9 * stamp) for stamp in stamps])
    dataset = replace(
        base,
        sensors={"camera_0": replace(base.sensors["camera_0"], calibration_parent="hand")},
        patterns={pattern.name: pattern},
        anchored=None,
        transforms={
            hand: np.stack([log.transform(hand, 1e9 * stamp) for stamp in stamps]),
            camera: np.repeat(T_hand_camera[None], COLLECTIONS, 0),
        },
        velocities={hand: motions[:, 0]},
        accelerations={hand: motions[:, 1:]},
    )
    T_seen = inverse(hand_at(stamps + lag) @ T_hand_camera) @ T_world_board
    return _drawn(_labelled(dataset, {"camera_0": T_seen}, rng), "camera_0", camera, lag, T_hand_camera)


def of_two_cameras(seed: int) -> Draw:
    """Two cameras whose clocks differ, and a board that is moved by hand."""
    rng = np.random.default_rng((2, seed))
    base, T_world_camera = rig(COLLECTIONS, seed=seed)
    pattern = base.patterns["board"]
    T_world_board = boards(rng, COLLECTIONS, 0.06, pattern)
    lag, velocity, motion = _moving(rng)
    seen = {
        "camera_0": inverse(T_world_camera[0]) @ T_world_board,
        "camera_1": inverse(T_world_camera[1]) @ retract(T_world_board, motion),
    }
    dataset = replace(base, velocities={(pattern.parent_link, pattern.link): velocity})
    return _drawn(_labelled(dataset, seen, rng), "camera_1", ("world", "camera_1_link"), lag, T_world_camera[1])


def _moving(rng: np.random.Generator) -> tuple[float, Array, Array]:
    """Return a lag (s), the velocities (N, 6) as the dataset has them, the twists (N, 6) of the motion in the lag."""
    lag = float(rng.uniform(0.0, MOST_LAG))
    velocity, acceleration, error = (
        rng.normal(size=(COLLECTIONS, 6)) * sigma for sigma in (SPEED, ACCELERATION, VELOCITY_ERROR)
    )
    return lag, velocity + error, lag * velocity + lag**2 / 2 * acceleration


def _labelled(dataset: Dataset, seen: Mapping[str, Array], rng: np.random.Generator) -> Dataset:
    """Return the dataset with the labels of cameras by ``T_camera_board`` (N, 4, 4)."""
    pattern = dataset.patterns["board"]
    ids = np.arange(len(pattern.corners))
    corners = np.broadcast_to(pattern.corners, (len(dataset.collections), *pattern.corners.shape))
    pixels = {name: CAMERA.project(apply(T, corners)) for name, T in seen.items()}
    collections = tuple(
        Collection(
            f"{i:03}",
            {
                (pattern.name, name): CornerLabels(ids, each[i] + rng.normal(0.0, NOISE, each[i].shape))
                for name, each in pixels.items()
            },
        )
        for i in range(len(dataset.collections))
    )
    return replace(dataset, collections=collections)


def _drawn(dataset: Dataset, camera: str, edge: Edge, lag: float, T: Array) -> Draw:
    result = calibrate(dataset, Options(lag=(camera,), assume=ALL_EXACT))
    found, error = result.lags[camera], local(result.transforms[edge], T)
    nees = float(error @ np.linalg.solve(result.covariances[edge], error)) / 6
    return Draw((found.seconds - lag) / found.sigma, 1e3 * found.sigma, nees)
