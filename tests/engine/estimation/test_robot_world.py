"""Robot-world solvers: exact data, OpenCV 4's solvers, noise, and motions that do not determine them."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calibration.base.arrays import Array
from calibration.engine.estimation.start.linear_solvers import RobotWorld, Spectrum, solve_li, solve_robot_world
from calibration.engine.geometry import rotations
from calibration.engine.geometry.transforms import distance, inverse, retract, transform

SOLVERS = pytest.mark.parametrize("solve", [solve_robot_world, solve_li])


def random_poses(rng: np.random.Generator, n: int) -> Array:
    return transform(rotations.exp(rng.normal(size=(n, 3))), rng.normal(size=(n, 3)))


def problem(seed: int, n: int) -> tuple[Array, Array, Array, Array]:
    rng = np.random.default_rng(seed)
    (X, Y), B = random_poses(rng, 2), random_poses(rng, n)
    return X @ B @ Y, B, X, Y


@SOLVERS
@given(seed=st.integers(0, 2**32 - 1), n=st.integers(3, 30))
def test_exact_data_give_the_exact_answer(solve, seed, n):
    A, B, X, Y = problem(seed, n)
    found = solve(A, B)
    tilt = found.spectrum.dispersion[0]
    if tilt > 0.05:  # the random motion happened to determine it well
        np.testing.assert_allclose(found.X, X, atol=1e-9 / tilt**2)
        np.testing.assert_allclose(found.Y, Y, atol=1e-9 / tilt**2)


@SOLVERS
def test_the_answer_is_a_pair_of_rigid_motions_whatever_the_noise(solve):
    A, B, _, _ = problem(3, 12)
    noise = np.random.default_rng(4).normal(size=(12, 6))
    for T in solve(retract(A, noise), B)[:2]:
        np.testing.assert_allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-12)
        assert np.linalg.det(T[:3, :3]) == pytest.approx(1)
        np.testing.assert_array_equal(T[3], [0, 0, 0, 1])


@SOLVERS
def test_inverting_every_pose_swaps_and_inverts_the_unknowns(solve):
    A, B, X, Y = problem(5, 10)
    found = solve(inverse(A), inverse(B))  # inverse(A) = inverse(Y) inverse(B) inverse(X)
    np.testing.assert_allclose(found.X, inverse(Y), atol=1e-9)
    np.testing.assert_allclose(found.Y, inverse(X), atol=1e-9)


@SOLVERS
def test_noise_of_one_part_in_a_thousand_moves_the_answer_as_much(solve):
    A, B, X, Y = problem(6, 50)
    found = solve(retract(A, np.random.default_rng(7).normal(size=(50, 6)) * 1e-3), B)
    assert max(*distance(found.X, X), *distance(found.Y, Y)) < 1.5e-3


@SOLVERS
def test_a_weight_of_zero_removes_a_pose(solve):
    A, B, X, _ = problem(8, 12)
    A[3] = random_poses(np.random.default_rng(9), 1)[0]
    assert distance(solve(A, B).X, X)[0] > 1e-2
    weights = np.ones(12)
    weights[3] = 0
    np.testing.assert_allclose(solve(A, B, weights).X, X, atol=1e-9)


@SOLVERS
def test_scaling_the_weights_changes_nothing(solve):
    A, B, _, _ = problem(10, 8)
    A = retract(A, np.random.default_rng(11).normal(size=(8, 6)) * 0.01)
    w = np.linspace(1, 2, 8)
    np.testing.assert_allclose(solve(A, B, w).X, solve(A, B, 1000 * w).X, atol=1e-12)


@SOLVERS
@pytest.mark.parametrize("noise", [0.0, 1e-4, 1e-2])
def test_equal_to_opencv(solve, noise):
    cv2 = pytest.importorskip("cv2")
    if not hasattr(cv2, "calibrateRobotWorldHandEye"):
        pytest.skip(f"OpenCV {cv2.__version__} has no calibrateRobotWorldHandEye (OpenCV 4 has)")
    methods = {
        solve_robot_world: cv2.CALIB_ROBOT_WORLD_HAND_EYE_SHAH,
        solve_li: cv2.CALIB_ROBOT_WORLD_HAND_EYE_LI,
    }
    A, B, _, _ = problem(12, 20)
    A = retract(A, np.random.default_rng(13).normal(size=(20, 6)) * noise)
    R_base_world, t_base_world, R_gripper_camera, t_gripper_camera = cv2.calibrateRobotWorldHandEye(
        A[:, :3, :3], A[:, :3, 3], B[:, :3, :3], B[:, :3, 3], method=methods[solve]
    )
    found = solve(A, B)
    np.testing.assert_allclose(found.X, transform(R_gripper_camera, t_gripper_camera[:, 0]), atol=1e-9)
    np.testing.assert_allclose(found.Y, inverse(transform(R_base_world, t_base_world[:, 0])), atol=1e-9)


def spectrum_of(solve, rotation_vectors: Array) -> Spectrum:
    rng = np.random.default_rng(14)
    X, Y, base = random_poses(rng, 3)
    B = base @ transform(rotations.exp(rotation_vectors), rng.normal(size=(len(rotation_vectors), 3)))
    found: RobotWorld = solve(X @ B @ Y, B)
    assert np.isfinite(found.X).all()
    assert np.isfinite(found.Y).all()
    return found.spectrum


@SOLVERS
def test_a_motion_about_one_axis_is_reported_with_its_axis(solve):
    axis = np.array([0.0, 0.6, 0.8])
    spectrum = spectrum_of(solve, np.linspace(-1, 1, 7)[:, None] * axis)
    assert spectrum.axes() == 1
    assert abs(spectrum.axis @ axis) == pytest.approx(1)


@SOLVERS
def test_a_motion_without_rotation_is_reported(solve):
    spectrum = spectrum_of(solve, np.zeros((7, 3)))
    assert spectrum.axes() == 0
    np.testing.assert_allclose(spectrum.dispersion, 0, atol=1e-6)


@SOLVERS
@pytest.mark.parametrize(("n", "axes"), [(1, 0), (2, 1), (3, 2)])
def test_three_poses_are_needed(solve, n, axes):
    A, B, _, _ = problem(15, n)
    assert solve(A, B).spectrum.axes() == axes


@SOLVERS
def test_dispersion_is_the_angle_by_which_the_motion_tilts_its_axis(solve):
    wobble = np.radians(2)
    around, about = np.meshgrid(np.arange(6) * np.pi / 3, np.arange(4) * np.pi / 2)
    tilts = rotations.exp(wobble * np.stack([np.cos(around), np.sin(around), 0 * around], -1).reshape(-1, 3))
    turns = rotations.exp(about.reshape(-1, 1) * np.array([0.0, 0.0, 1.0]))
    spectrum = spectrum_of(solve, rotations.log(tilts @ turns))
    assert spectrum.axes() == 2
    assert spectrum.dispersion[0] == pytest.approx(wobble, rel=1e-3)


@SOLVERS
def test_no_pose_is_an_error(solve):
    with pytest.raises(ValueError, match="without poses"):
        solve(np.empty((0, 4, 4)), np.empty((0, 4, 4)))
