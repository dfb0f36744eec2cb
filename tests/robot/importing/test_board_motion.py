"""Boards moved by hand: their motion, by images alone, tells the lag of a camera."""

import json
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from calibration.base.arrays import Array
from calibration.engine.dataset.configuration import Configuration, SensorConfiguration
from calibration.engine.dataset.model import Dataset
from calibration.engine.dataset.reading import FILE_NAME, read_dataset
from calibration.engine.dataset.writing import write_document
from calibration.engine.estimation.calibrate import Options, calibrate
from calibration.engine.estimation.options import ALL_EXACT
from calibration.engine.geometry import rotations
from calibration.engine.geometry.transforms import apply, from_xyz_rpy, inverse, local, transform
from calibration.robot.importing.bags.bag import NS_PER_S
from calibration.robot.importing.bags.motion import MovingBoards
from calibration.robot.importing.bags.stillness import BagImage, moments_at
from calibration.robot.importing.document import dataset_document
from calibration.robot.importing.files.camera_files import KnownLens
from calibration.robot.importing.image_views import FoundCorners, LabelledMoment, View
from calibration.robot.importing.importing import import_data
from calibration.robot.importing.recorded import Recorded, imported_moments
from calibration.robot.simulation.kinematics import stream
from calibration.robot.simulation.scene import Board, Scene
from calibration.robot.simulation.sensors import SimulatedCamera
from tests.robot.importing.bags import BagFile
from tests.robot.labelling.pictures import VGA, chessboard

PATTERN = chessboard(size=0.04)
CORNERS = PATTERN.pattern().corners
T_LEFT_RIGHT = from_xyz_rpy([0.2, 0.01, -0.02], [0.02, -0.15, 0.01])
CAMERAS = {"left": np.eye(4), "right": T_LEFT_RIGHT}
LAG = 0.03
BEGIN, MOMENTS = 100 * int(NS_PER_S), 30


def held_board(time: float, phases: Array) -> Array:
    """``T_left_pattern`` of a board in a hand: sways of 0.3 to 0.9 Hz, up to 0.7 m/s and 1.7 rad/s."""
    sway = np.sin(2 * np.pi * np.linspace(0.3, 0.9, 6) * time + phases) * [0.12, 0.1, 0.12, 0.3, 0.3, 0.3]
    R = rotations.exp(sway[3:])
    return transform(R, sway[:3] + np.array([0.0, 0.0, 0.9]) - R @ PATTERN.pattern().centre)


def phases_of(seed: int) -> Array:
    return np.random.default_rng(seed).uniform(0, 2 * np.pi, 6)


def seen(name: str, stamp: int, after: float, phases: Array, random: np.random.Generator) -> BagImage:
    """The image of a camera with a stamp, ns, which sees what is there `after` it, s."""
    T = inverse(CAMERAS[name]) @ held_board((stamp - BEGIN) / NS_PER_S + after, phases)
    pixels = VGA.project(apply(T, CORNERS)) + random.normal(0, 0.1, (len(CORNERS), 2))
    inside = ((pixels > 0) & (pixels < [VGA.width, VGA.height])).all(-1)
    found = FoundCorners(tuple(np.flatnonzero(inside).tolist()), tuple(pixels[inside].ravel().tolist()))
    return BagImage(name, stamp, stamp, View(f"{name}_{stamp}.png", VGA.width, VGA.height, {"board": found}))


def recorded(lag: float, seed: int, rate: float = 20) -> Recorded:
    """Two cameras, of which the right one is late, and a board in a hand; a moment every second."""
    random, phases = np.random.default_rng(seed), phases_of(seed)
    stamps = [BEGIN + int(i / rate * NS_PER_S) for i in range(int(MOMENTS * rate))]
    images = {
        name: [seen(name, stamp, lag if name == "right" else 0.0, phases, random) for stamp in stamps]
        for name in CAMERAS
    }
    moments = moments_at(images, [BEGIN + (i + 0.5) * NS_PER_S for i in range(MOMENTS - 1)])
    sensors = {name: SensorConfiguration(name, "rgb", name, "world", name) for name in CAMERAS}
    return Recorded(
        Configuration("world", sensors, {"board": PATTERN}, "left"),
        {name: KnownLens(Path("given"), VGA, has_size=True) for name in CAMERAS},
        [LabelledMoment({name: image.view for name, image in each.images.items()}) for each in moments],
        {("world", name): np.broadcast_to(np.eye(4), (len(moments), 4, 4)) for name in CAMERAS},
        rough=True,
        boards=MovingBoards(images, moments),
    )


def imported(folder: Path, lag: float, seed: int, rate: float = 20) -> Dataset:
    write_document(dataset_document(imported_moments("robot", recorded(lag, seed, rate))), folder / FILE_NAME)
    return read_dataset(folder)


def true_motion(time: float, phases: Array) -> Array:
    """Velocity and acceleration (2, 6), by differences."""
    step = 0.01
    at = np.array([local(held_board(time, phases), held_board(time + i * step, phases)) for i in (-2, -1, 0, 1, 2)])
    weights = np.array([[1, -8, 0, 8, -1], [-1, 16, -30, 16, -1]]) / 12
    return np.asarray((weights @ at) / np.array([[step], [step**2]]))


@pytest.mark.thorough(but_first=1)
@pytest.mark.parametrize("seed", range(3))
def test_the_lag_of_a_camera_is_found_with_a_board_in_a_hand(tmp_path: Path, seed: int) -> None:
    found = calibrate(imported(tmp_path, LAG, seed), Options(lag=("free",), assume=ALL_EXACT, description="rough"))
    assert found.lags.keys() == {"right"}
    assert found.lags["right"].sigma < 5e-5
    assert found.lags["right"].seconds == pytest.approx(LAG, abs=2 * found.lags["right"].sigma)
    error = local(found.transforms["world", "right"], T_LEFT_RIGHT)
    assert error @ np.linalg.solve(found.covariances["world", "right"], error) < 22.5  # chi^2 of 6 at 1 in 1000


def test_motions_are_those_of_the_board(tmp_path: Path) -> None:
    dataset = imported(tmp_path, 0.0, 0)
    (edge,) = dataset.velocities
    assert edge == ("world", "board")
    true = np.array([true_motion(i + 0.5, phases_of(0)) for i in range(MOMENTS - 1)])
    found = np.stack([dataset.velocities[edge], dataset.accelerations[edge][:, 0]], 1)
    np.testing.assert_array_less(np.std(found - true, axis=0), 0.1 * np.std(true, axis=0))


def test_without_images_around_it_a_moment_has_no_velocity(tmp_path: Path) -> None:
    assert not imported(tmp_path, 0.0, 0, rate=5).velocities


def test_behind_an_arm_that_moves_none_is_written() -> None:
    given = recorded(0.0, 0)
    assert given.boards is not None
    cameras, edges = dict.fromkeys(CAMERAS, VGA), [("world", "hand")]
    in_hand = replace(given.configuration, patterns={"board": replace(PATTERN, parent_link="hand")})
    with_world = [*edges, ("world", "left"), ("world", "right")]
    assert not replace(given.boards, edges=with_world, moving=edges).motions(in_hand, cameras)
    assert replace(given.boards, edges=with_world).motions(in_hand, cameras).keys() == {("hand", "board")}


def test_a_stereo_bag_with_a_lag(tmp_path: Path) -> None:
    small = replace(VGA, fx=VGA.fx / 2, fy=VGA.fy / 2, cx=159.5, cy=119.5, width=320, height=240)
    path = tmp_path / "recorded"
    with BagFile(path, "mcap") as bag:
        for name in CAMERAS:
            bag.camera_info(f"/{name}/camera_info", BEGIN, name, (320, 240), small.fx, k=small.K.ravel())
        for moment, step in product(range(8), (-2, -1, 0, 1, 2)):
            time = moment + 0.05 * step
            for name in CAMERAS if step == 0 else ["left"]:
                board = Board(PATTERN, PATTERN.pattern(), held_board(time + LAG * (name == "right"), phases_of(1)))
                random = stream(5 * moment + step + 2)
                image = SimulatedCamera(small).render(CAMERAS[name], Scene(ground=-5.0), [board], random)
                bag.image(f"/{name}/image_raw", BEGIN + int((1 + time) * NS_PER_S), image, name, "mono8")
    pattern = {"type": "chessboard", "columns": 10, "rows": 7, "square": 0.04, "border": 0.06}
    (tmp_path / "times.txt").write_text("\n".join(f"{0.1 + i}" for i in range(8)))
    document = {"bags": {"files": ["recorded"], "at": "times.txt"}, "patterns": {"board": pattern}}
    (tmp_path / "import.yml").write_text(json.dumps(document))
    import_data(tmp_path / "import.yml", tmp_path / "out", jobs=1)
    found = calibrate(read_dataset(tmp_path / "out"), Options(lag=("free",), description="rough")).lags["right"]
    assert found.sigma < 2e-3
    assert found.seconds == pytest.approx(LAG, abs=3 * found.sigma)
