"""A snapshot is the same wherever the calibration started, and survives its file to what its digits mean."""

from dataclasses import replace

import numpy as np
import pytest

from calibration.engine.baseline.calibration_document import (
    POSITIONS_INPUT,
    CalibrationDocument,
    hash_of_labels,
    hashes_of_inputs,
)
from calibration.engine.baseline.document import Baseline, baseline_text, parse_baseline
from calibration.engine.dataset.model import CornerLabels, Dataset, Labels
from calibration.engine.estimation.calibrate import calibrate
from calibration.engine.estimation.options import Options
from calibration.engine.estimation.start.guesses import StartingNoise
from calibration.engine.geometry.transforms import local
from tests.engine.baseline.scenes import RIGHT, stereo, taken
from tests.engine.estimation import systems
from tests.engine.estimation.scenes import relabelled


@pytest.mark.parametrize(
    "make",
    [
        stereo,
        lambda: systems.eye_to_hand(24, pixel_noise=0.1).dataset(),
        lambda: systems.linked_by_an_arm(24, pixel_noise=0.1).dataset(),
        lambda: systems.camera_and_lidar(24, pixel_noise=0.1).dataset(),
    ],
)
def test_it_does_not_depend_on_the_start(make) -> None:
    dataset = make()
    one, other = taken(dataset), taken(dataset, StartingNoise(0.3, 0.2, 7))
    assert [each.edge for each in one.poses] == [each.edge for each in other.poses]
    for a, b in zip(one.poses, other.poses, strict=True):
        assert np.abs(local(a.matrix, b.matrix)).max() < 1e-8, a.name
        assert (a.covariance is None) == (b.covariance is None)
        if a.covariance is not None:
            assert b.covariance is not None
            sigmas = np.sqrt(np.diagonal(b.covariance))
            units = np.outer(sigmas, sigmas) + 1e-12
            assert a.covariance / units == pytest.approx(b.covariance / units, abs=1e-2)


def test_a_pose_keeps_its_error_bar_as_a_covariance() -> None:
    dataset = stereo()
    calibration = calibrate(dataset)
    pose = next(each for each in taken(dataset).poses if each.edge == RIGHT)
    C = calibration.covariances[RIGHT]
    sigmas = np.sqrt(np.diagonal(C))
    assert pose.covariance is not None
    assert pose.covariance / np.outer(sigmas, sigmas) == pytest.approx(C / np.outer(sigmas, sigmas), abs=1e-3)
    assert pose.sensor == "right"


def test_the_hash_is_of_the_labels_alone() -> None:
    dataset = stereo()
    described = dataset.with_transforms({RIGHT: np.eye(4)})
    assert hash_of_labels(described) == hash_of_labels(dataset)

    def nudged(i: int, sensor: str, label: Labels) -> Labels:
        if (i, sensor) != (3, "right") or not isinstance(label, CornerLabels):
            return label
        return replace(label, pixels=label.pixels + 1e-9)

    assert hash_of_labels(relabelled(dataset, nudged)) != hash_of_labels(dataset)
    assert hash_of_labels(without_a_label(dataset)) != hash_of_labels(dataset)


def without_a_label(dataset: Dataset) -> Dataset:
    return relabelled(dataset, lambda i, sensor, label: None if (i, sensor) == (3, "right") else label)


def test_it_is_the_same_after_its_file() -> None:
    found = taken(stereo())
    text = baseline_text(Baseline(1, {"robot": found}))
    assert parse_baseline(text.encode(), "file").systems["robot"] == found
    assert baseline_text(parse_baseline(text.encode(), "file")) == text
    assert max(map(len, text.splitlines())) < 260


def test_views_and_the_images_coverage_are_counted() -> None:
    found: CalibrationDocument = taken(without_a_label(stereo()))
    assert found.views == {"left": 24, "right": 23}
    assert 0 < found.covered["left"] <= 1
    assert found.labels > 23 * 2 * 4


def test_changed_inputs_have_other_hashes() -> None:
    dataset = stereo()
    calibrated = {each.edge for each in dataset.sensors.values()}
    before = hashes_of_inputs(dataset, calibrated, Options())
    camera = dataset.sensors["left"].camera
    assert camera is not None

    def changed(other: Dataset, options: Options | None = None) -> set[str]:
        after = hashes_of_inputs(other, calibrated, options or Options())
        return {name for name in after if after[name] != before[name]}

    assert changed(dataset, Options(start="given")) == set()
    assert changed(dataset, Options(loss="linear")) == {"options"}
    assert changed(dataset.with_cameras({"left": replace(camera, fx=camera.fx + 1)})) == {"camera_info of left"}
    assert changed(dataset.with_transforms({RIGHT: np.eye(4)})) == set()
    board = replace(dataset.patterns["board"], corners=1.01 * dataset.patterns["board"].corners)
    assert changed(replace(dataset, patterns={"board": board})) == {"pattern board"}
    arm = systems.eye_to_hand(24).dataset()
    moved = {edge: np.abs(T - T[0]).max() > 1e-6 for edge, T in arm.transforms.items()}
    for edge, moves in moved.items():
        before = hashes_of_inputs(arm, (), Options())
        after = hashes_of_inputs(arm.with_transforms({edge: 1.001 * arm.transforms[edge]}), (), Options())
        name = POSITIONS_INPUT if moves else "the robot's fixed transforms"
        assert {each for each in after if after[each] != before[each]} == {name}
    assert len(set(moved.values())) == 2
