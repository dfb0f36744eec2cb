"""The result against the description: far away, scaled, exchanged; each named, and good data left alone."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calibration.engine.dataset.model import Dataset
from calibration.engine.dataset.reading import read_dataset
from calibration.engine.diagnosis.conventions.changed import with_exchanged_labels
from calibration.engine.diagnosis.description import BY_CHANCE, exchanged_or_scaled, far_from_description
from calibration.engine.diagnosis.finding import Finding
from calibration.engine.estimation.calibrate import calibrate
from calibration.engine.estimation.covariance.result import Calibration
from calibration.engine.estimation.options import Options
from calibration.engine.estimation.start.guesses import StartingNoise
from tests.engine.estimation.scenes import Scene, pose
from tests.engine.estimation.systems import eye_to_hand, hand_and_world, mobile_base, ring, stereo

DATASETS = Path(__file__).parents[3] / "datasets"
ROUGH = Options(description="rough")


def against(calibration: Calibration, description: Dataset, options: Options) -> tuple[Finding, ...]:
    explained = exchanged_or_scaled(calibration, description, options)
    return explained or far_from_description(calibration, description, options)


def found(dataset: Dataset, description: Dataset | None = None, options: Options | None = None) -> tuple[Finding, ...]:
    return against(calibrate(dataset), description or dataset, options or Options())


def scaled(dataset: Dataset, factor: float) -> Dataset:
    patterns = {
        name: replace(p, corners=p.corners * factor, outline=p.outline * factor) for name, p in dataset.patterns.items()
    }
    return replace(dataset, patterns=patterns)


def moved(dataset: Dataset, sensor: str, T: np.ndarray) -> Dataset:
    edge = dataset.sensors[sensor].edge
    return dataset.with_transforms({edge: dataset.transforms[edge][0] @ T})


@pytest.mark.parametrize("name", ["t2rgb", "riwbot", "softbot"])
def test_data_that_ship_are_where_they_are_described(name: str) -> None:
    assert found(read_dataset(DATASETS / name)) == ()


def test_recorded_cameras_with_another_square_than_the_printed_one(shared_data: Path) -> None:
    recorded = read_dataset(shared_data / "t2rgb-paper")
    assert found(recorded) == ()
    [red] = found(scaled(recorded, 5 / 6))
    assert (red.kind, red.severity) == ("pattern-size", "red")
    assert "squares of 0.05 m, but 0.0599 m would fit the robot's description" in red.text
    assert red.value == pytest.approx(-1 / 6, abs=0.002)
    [note] = found(scaled(recorded, 5 / 6), options=ROUGH)
    assert note.severity == "note"


def test_recorded_cameras_exchanged(shared_data: Path) -> None:
    [red] = found(with_exchanged_labels(read_dataset(shared_data / "t2rgb-paper"), "left_camera", "right_camera"))
    assert (red.kind, red.severity, red.sensors) == ("exchanged-sensors", "red", ("left_camera", "right_camera"))
    assert "'right_camera' comes out 0.77 m and 0.02 degrees from where the robot's description puts it" in red.text


@pytest.mark.parametrize(
    ("scene", "pair"),
    [(lambda **how: mobile_base(5, **how), ("cam", "second")), (lambda **how: ring(cameras=3, **how), ("c1", "c2"))],
    ids=["beside a LiDAR", "two of three"],
)
def test_two_of_several_sensors_exchanged(scene: Callable[..., Scene], pair: tuple[str, str]) -> None:
    dataset = scene(pixel_noise=0.1).dataset()
    assert found(dataset) == ()
    [red] = found(with_exchanged_labels(dataset, *pair)) or [None]
    assert red is not None
    assert (red.kind, set(red.sensors)) == ("exchanged-sensors", set(pair))


@pytest.mark.parametrize(("far", "kinds"), [(0.2, []), (0.3, ["far-from-description"])])
def test_a_sensor_far_from_its_place(far: float, kinds: Sequence[str]) -> None:
    dataset = eye_to_hand(pixel_noise=0.1).dataset()
    findings = found(dataset, moved(dataset, "cam", pose(0, 0, far)))
    assert [each.kind for each in findings] == kinds
    assert found(dataset, moved(dataset, "cam", pose(0, 0, far)), ROUGH) == ()
    if kinds:
        assert "'cam' comes out 0.30 m and 0.00 degrees from where the robot's description puts it" in findings[0].text
        assert "description: rough" in findings[0].text
    turned = found(dataset, moved(dataset, "cam", pose(0, 0, 0, 0, 0, far)))
    assert [each.kind for each in turned] == kinds


def test_only_relative_poses_are_compared_if_a_sensor_is_fixed() -> None:
    """A rig carried elsewhere is the same rig; a camera turned on it is not."""
    dataset = stereo(pixel_noise=0.1).dataset()
    carried = {
        sensor.edge: pose(3, 2, 1, 0.1, 0.2, 2) @ dataset.transforms[sensor.edge][0]
        for sensor in dataset.sensors.values()
    }
    elsewhere = dataset.with_transforms(carried)
    assert found(elsewhere) == ()
    [red] = found(moved(elsewhere, "right", pose(0, 0, 0, 0, 0.3, 0)))
    assert red.sensors == ("right",)
    assert "'left' being where it is" in red.text


def test_an_identity_is_no_description() -> None:
    dataset = eye_to_hand(pixel_noise=0.1).dataset()
    assert found(dataset.with_transforms({dataset.sensors["cam"].edge: np.eye(4)})) == ()
    assert found(hand_and_world(pixel_noise=0.1).dataset()) == ()


def test_the_noise_of_a_start_is_not_the_description() -> None:
    dataset = stereo(pixel_noise=0.1).dataset()
    calibration = calibrate(dataset, noise=StartingNoise(1.0, 1.0, 3))
    assert against(calibration, dataset, Options()) == ()


def test_random_errors_of_a_description_are_no_scale() -> None:
    """At most the share that `BY_CHANCE` allows, of errors large enough to be one."""
    dataset = stereo(pixel_noise=0.1).dataset()
    calibration = calibrate(dataset)
    rng = np.random.default_rng(4)
    kinds = []
    for _ in range(150):
        e = rng.normal(size=3)
        description = moved(dataset, "right", pose(*(0.06 * e / np.linalg.norm(e))))
        kinds += [each.kind for each in against(calibration, description, Options())]
    assert len(kinds) <= 3 * BY_CHANCE * 150
