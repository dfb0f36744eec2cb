"""Calibrations that other software has made, right, wrong and unfinished, against our optimum."""

from dataclasses import replace

import numpy as np
import pytest

from calibration.base import UndeterminedError
from calibration.engine.dataset.model import Dataset
from calibration.engine.diagnosis.against_optimum import OurOptimum, against_optimum, find_optimum, optimum_for
from calibration.engine.diagnosis.finding import Finding
from calibration.engine.diagnosis.limits import Limits
from calibration.engine.estimation.calibrate import calibrate
from calibration.engine.estimation.options import Options
from calibration.engine.estimation.start.guesses import StartingNoise, with_starting_noise
from calibration.engine.geometry.frames import JOINT_PARAMETERS
from calibration.engine.geometry.transforms import retract, translation
from tests.engine.estimation.scenes import relabelled
from tests.engine.estimation.systems import eye_to_hand, jointed_arm, linked_by_an_arm, stereo

NOISE = StartingNoise(0.1, 0.1, 3)


def optimum_of(dataset: Dataset, options: Options | None = None) -> OurOptimum:
    return find_optimum(dataset, options or Options())


@pytest.fixture(scope="module")
def rig() -> OurOptimum:
    return optimum_of(stereo(12, pixel_noise=0.3).dataset())


@pytest.fixture(scope="module")
def arm() -> OurOptimum:
    return optimum_of(eye_to_hand(12, pixel_noise=0.3).dataset())


def judged(optimum: OurOptimum, found: Dataset, limits: Limits | None = None) -> Finding:
    start = with_starting_noise(optimum.given, NOISE)
    [finding] = against_optimum(optimum, found, start, limits or Limits())
    return finding


def off(optimum: OurOptimum, sensor: str, *metres: float) -> Dataset:
    """Our result with one sensor somewhere else."""
    found = optimum.calibration.dataset
    edge = found.sensors[sensor].edge
    return found.with_transforms({edge: found.transforms[edge] @ translation(np.array(metres))})


def test_our_own_result_is_the_optimum(rig: OurOptimum, arm: OurOptimum) -> None:
    for optimum in (rig, arm):
        finding = judged(optimum, optimum.calibration.dataset)
        assert finding.severity == "note"
        assert finding.moves_mm == pytest.approx(0, abs=1e-6)
        assert finding.text.endswith("is within 0.01 mm and 0.001 deg of our optimum on the same labels")


def test_views_that_ours_leaves_out_do_not_count() -> None:
    scene = stereo(12, pixel_noise=0.3).dataset()
    other = scene.collections[5].labels["board", "right"]
    optimum = optimum_of(relabelled(scene, lambda i, name, label: other if (i, name) == (2, "right") else label))
    assert {view.collection for view in optimum.calibration.dropped_views} == {"002"}
    assert optimum.cost == pytest.approx(optimum.calibration.cost, rel=1e-6)
    assert judged(optimum, optimum.calibration.dataset).severity == "note"


def test_undetermined_directions_are_no_difference(rig: OurOptimum) -> None:
    found, elsewhere = rig.calibration.dataset, retract(np.eye(4), np.array([0.5, -0.3, 0.2, 0.4, 0.1, -0.6]))
    edges = [sensor.edge for sensor in found.sensors.values()]
    moved = found.with_transforms({edge: elsewhere @ found.transforms[edge] for edge in edges})
    assert judged(rig, moved).severity == "note"


def test_a_common_motion_of_sensors_is_a_difference_with_an_arm() -> None:
    optimum = optimum_of(linked_by_an_arm(16, pixel_noise=0.3).dataset())
    found = optimum.calibration.dataset
    edges = [sensor.edge for sensor in found.sensors.values()]
    moved = found.with_transforms({e: translation(np.array([0.01, 0, 0])) @ found.transforms[e] for e in edges})
    finding = judged(optimum, moved)
    assert (finding.severity, set(finding.sensors)) == ("red", set(found.sensors))  # equally far: rounding orders them


def test_another_loss_is_an_honest_difference(rig: OurOptimum, arm: OurOptimum) -> None:
    for optimum in (rig, arm):
        finding = judged(optimum, calibrate(optimum.given, Options(loss="linear")).dataset)
        assert finding.severity == "note"
        assert finding.value is not None
        assert 0.01 < finding.value < 1


def test_two_millimetres_are_red_with_the_distance(rig: OurOptimum, arm: OurOptimum) -> None:
    finding = judged(rig, off(rig, "right", 0.002, 0, 0))
    assert (finding.severity, finding.sensors) == ("red", ("left", "right"))
    assert finding.moves_mm == pytest.approx(2, rel=1e-3)
    assert "'left' to 'right' by 2 mm and 0 deg (limit 1 mm, 0.05 deg, as none is set)" in finding.text
    finding = judged(arm, off(arm, "cam", 0, 0.002, 0))
    assert (finding.severity, finding.sensors) == ("red", ("cam",))
    assert "'cam' by 2 mm and 0 deg" in finding.text


def test_the_limits_of_the_system_count(rig: OurOptimum) -> None:
    two, tenth = off(rig, "right", 0.002, 0, 0), off(rig, "right", 0.0001, 0, 0)
    assert judged(rig, two, Limits(translation_mm=3)).severity == "note"
    red = judged(rig, tenth, Limits(translation_mm=0.05, rotation_deg=0.1))
    assert (red.severity, "(limit 0.05 mm, 0.1 deg)" in red.text) == ("red", True)


def test_insignificant_distances_pass_unless_a_limit_is_set() -> None:
    optimum = optimum_of(stereo(4, pixel_noise=5.0).dataset())
    moved = off(optimum, "right", 0.002, 0, 0)
    finding = judged(optimum, moved)
    assert finding.value is not None
    assert 0.5 < finding.value < 4
    assert finding.severity == "note"
    assert judged(optimum, moved, Limits(translation_mm=1)).severity == "red"


def test_the_quantile_of_chi_square(rig: OurOptimum) -> None:
    """Of 6 parameters, which are the pose of one camera to the other: 22.46 (tables)."""
    assert rig.parameters == 6
    assert rig.noticeable == pytest.approx(22.46, rel=0.02)


def test_an_unchanged_initial_guess_is_reported(rig: OurOptimum, arm: OurOptimum) -> None:
    for optimum in (rig, arm):
        finding = judged(optimum, with_starting_noise(optimum.given, NOISE))
        assert finding.severity == "red"
        assert "It has returned its start unchanged" in finding.text


def test_stopped_on_its_way_is_red_with_what_is_missing(arm: OurOptimum) -> None:
    found, start = arm.calibration.dataset, with_starting_noise(arm.given, NOISE)
    edge = found.sensors["cam"].edge
    halfway = found.transforms[edge].copy()
    halfway[:, :3, 3] = 0.95 * halfway[:, :3, 3] + 0.05 * start.transforms[edge][:, :3, 3]
    finding = judged(arm, found.with_transforms({edge: halfway}))
    assert finding.severity == "red"
    assert finding.moves_mm == pytest.approx(5, rel=0.05)
    assert "above the optimum" in finding.text
    assert "stopped early" in finding.text


def test_labels_that_fit_nowhere_are_red(rig: OurOptimum) -> None:
    found = rig.calibration.dataset
    edge = found.sensors["right"].edge
    finding = judged(rig, found.with_transforms({edge: found.transforms[edge] @ np.diag([-1.0, 1.0, -1.0, 1.0])}))
    assert finding.severity == "red"
    assert "no pose of the pattern fits the labels" in finding.text


def test_better_intrinsics_are_compared_with_the_optimum_for_them() -> None:
    """Software that calibrates intrinsics, which the dataset has 1 % wrong, is right where our optimum is not."""
    truth = eye_to_hand(16, pixel_noise=0.2).dataset()
    [camera] = [sensor.camera for sensor in truth.sensors.values() if sensor.camera]
    given = truth.with_cameras({"cam": replace(camera, fx=1.01 * camera.fx, fy=1.01 * camera.fy)})
    optimum = optimum_of(given)
    good = calibrate(given, Options(intrinsics=("cam",))).dataset
    assert judged(optimum, good).severity == "red"
    assert judged(optimum_for(optimum, good), good).severity == "note"
    assert optimum_for(optimum_of(truth), optimum.calibration.dataset).given is truth
    wrong = judged(optimum_of(truth), optimum.calibration.dataset)  # worse ones are no excuse
    assert wrong.severity == "red"
    assert "It has other intrinsics of 'cam', with which the labels fit no better" in wrong.text


def test_joints_count_too() -> None:
    optimum = optimum_of(jointed_arm(pixel_noise=0.2).dataset())
    found = optimum.calibration.dataset
    name, joint = next(iter(optimum.calibration.joints.items()))
    values = found.joints[name].values.copy()
    values[JOINT_PARAMETERS.index(joint.parameters[0])] += 0.01
    finding = judged(optimum, found.with_joints({name: values}))
    assert finding.severity == "red"
    assert f"'{joint.parameters[0]}' of joint '{name}' by" in finding.text


def test_data_without_an_optimum_are_reported() -> None:
    with pytest.raises(UndeterminedError):
        find_optimum(eye_to_hand(2).dataset(), Options())
