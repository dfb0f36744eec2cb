import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from calibration.engine.geometry import rotations
from tests.engine.geometry.strategies import random_rotations, rotation_vectors, vectors

AXES = np.concatenate([np.eye(3), -np.eye(3), np.random.default_rng(1).normal(size=(50, 3))])
AXES = AXES / np.linalg.norm(AXES, axis=1, keepdims=True)
# Where sines and cosines lose digits, and where the axis is nearly (or really) ambiguous.
ANGLES = [0.0, 1e-300, 1e-12, 1e-9, 1e-7, 9.9e-5, 1.01e-4, 1e-3, 0.5, 2.0, np.pi - 1e-3, np.pi - 1e-7, np.pi - 1e-12]


@given(vectors(3, 10.0), st.data())
def test_hat_is_the_cross_product(w, data):
    v = data.draw(vectors(3, 10.0, st.just(w.shape[:-1])))
    np.testing.assert_allclose((rotations.hat(w) @ v[..., None])[..., 0], np.cross(w, v), atol=1e-12)


@given(rotation_vectors)
def test_exp_gives_rotations(w):
    R = rotations.exp(w)
    assert R.shape == (*w.shape[:-1], 3, 3)
    np.testing.assert_allclose(R @ np.swapaxes(R, -1, -2), np.broadcast_to(np.eye(3), R.shape), atol=1e-14)
    np.testing.assert_allclose(np.linalg.det(R), 1, atol=1e-14)


@pytest.mark.parametrize("angle", ANGLES)
def test_exp_is_scipys_at_every_angle(angle):
    w = AXES * angle
    np.testing.assert_allclose(rotations.exp(w), Rotation.from_rotvec(w).as_matrix(), rtol=0, atol=1e-15)


@pytest.mark.parametrize("angle", ANGLES)
def test_log_undoes_exp_at_every_angle(angle):
    w = AXES * angle
    # Near pi the matrix itself, given to 1e-16, fixes the axis to about as many digits.
    np.testing.assert_allclose(rotations.log(rotations.exp(w)), w, rtol=1e-12, atol=1e-15)


def test_log_of_half_a_turn_is_pi_long_either_way_round():
    w = rotations.log(rotations.exp(AXES * np.pi))
    np.testing.assert_allclose(np.linalg.norm(w, axis=1), np.pi, atol=1e-14)
    np.testing.assert_allclose(abs((w * AXES).sum(1)), np.pi, atol=1e-14)


def test_log_is_never_longer_than_pi():
    w = rotations.log(rotations.exp(AXES * 4.0))
    np.testing.assert_allclose(w, AXES * (4.0 - 2 * np.pi), atol=1e-14)


def test_angle_is_the_length_of_the_logarithm():
    R = random_rotations(500)
    np.testing.assert_allclose(rotations.angle(R), Rotation.from_matrix(R).magnitude(), atol=1e-13)


def test_rotations_about_one_axis_add_up():
    a, b = AXES * 0.3, AXES * 1.1
    np.testing.assert_allclose(rotations.exp(a) @ rotations.exp(b), rotations.exp(a + b), atol=1e-15)


def test_quaternions_are_scipys():
    q = np.random.default_rng(2).normal(size=(1000, 4))
    R = rotations.from_quaternion(q)
    np.testing.assert_allclose(R, Rotation.from_quat(q).as_matrix(), atol=1e-15)
    np.testing.assert_allclose(rotations.to_quaternion(R), Rotation.from_matrix(R).as_quat(canonical=True), atol=1e-15)


@given(vectors(4, 5.0).filter(lambda q: (np.linalg.norm(q, axis=-1) > 1e-3).all()))
def test_quaternion_round_trip(q):
    unit = q / np.linalg.norm(q, axis=-1, keepdims=True)
    back = rotations.to_quaternion(rotations.from_quaternion(q))
    assert (back[..., 3] >= 0).all()
    np.testing.assert_allclose(abs((back * unit).sum(-1)), 1, atol=1e-14)
    np.testing.assert_allclose(np.linalg.norm(back, axis=-1), 1, atol=1e-15)


@pytest.mark.parametrize("angle", ANGLES)
def test_quaternions_lose_no_digit_at_any_angle(angle):
    expected = Rotation.from_rotvec(AXES * angle).as_quat(canonical=True)
    np.testing.assert_allclose(rotations.to_quaternion(rotations.exp(AXES * angle)), expected, rtol=0, atol=1e-15)


def test_the_same_quaternion_gives_the_same_bits_wherever_it_stands_in_a_batch():
    q = np.array([0.1, -0.7, 0.3, 0.2])
    alone = rotations.from_quaternion(q)
    for count in (2, 3, 17, 64):
        assert (rotations.from_quaternion(np.tile(q, (count, 1))) == alone).all()


def test_roll_pitch_yaw_is_about_fixed_axes():
    rpy = np.random.default_rng(3).uniform(-3, 3, (200, 3))
    np.testing.assert_allclose(rotations.from_rpy(rpy), Rotation.from_euler("xyz", rpy).as_matrix(), atol=1e-14)


def test_roll_pitch_yaw_round_trip():
    rpy = np.random.default_rng(4).uniform([-3.1, -1.5, -3.1], [3.1, 1.5, 3.1], (200, 3))
    np.testing.assert_allclose(rotations.to_rpy(rotations.from_rpy(rpy)), rpy, atol=1e-13)


@pytest.mark.parametrize("pitch", [np.pi / 2, -np.pi / 2])
def test_roll_pitch_yaw_at_the_singularity(pitch):
    rpy = np.array([[0.3, pitch, -0.4], [-2.0, pitch, 1.0], [0.0, pitch, 0.0]])
    back = rotations.to_rpy(rotations.from_rpy(rpy))
    np.testing.assert_allclose(back[:, 2], 0)
    np.testing.assert_allclose(rotations.from_rpy(back), rotations.from_rpy(rpy), atol=1e-14)


def test_nearest_leaves_rotations_and_mends_what_is_near():
    R = random_rotations(100, seed=5)
    np.testing.assert_allclose(rotations.nearest(R), R, atol=1e-14)
    np.testing.assert_allclose(rotations.nearest(1.7 * R), R, atol=1e-14)


def test_nearest_is_never_a_reflection():
    M = np.random.default_rng(6).normal(size=(200, 3, 3))
    R = rotations.nearest(M)
    np.testing.assert_allclose(np.linalg.det(R), 1, atol=1e-13)
    distance = np.linalg.norm(R - M, axis=(1, 2))
    for other in random_rotations(20, seed=7):
        assert (distance <= np.linalg.norm(other - M, axis=(1, 2)) + 1e-12).all()


@pytest.mark.parametrize("rpy", [(0.0, 0.0, 0.0), (0.3, -0.8, 2.0), (-2.5, 1.2, -0.4)])
def test_rpy_rates_are_the_derivative(rpy: tuple[float, float, float]) -> None:
    step = 1e-6
    R = rotations.from_rpy(rpy)
    forward, back = (rotations.to_rpy(R @ rotations.exp(sign * step * np.eye(3))) for sign in (1, -1))
    np.testing.assert_allclose(rotations.rpy_rates(rpy), (forward - back).T / (2 * step), atol=1e-8)
