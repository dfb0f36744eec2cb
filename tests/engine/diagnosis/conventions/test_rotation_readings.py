"""The numbers of a rotation, read by another convention and had back."""

import tracemalloc

import numpy as np
import pytest

from calibration.base.arrays import Array
from calibration.engine.diagnosis.conventions.arm_hypotheses import (
    QUATERNION_ORDERS,
    THREE_NUMBER_READINGS,
    Reading,
    rereadings,
)
from calibration.engine.estimation.start.ambiguous_views import rotations_that_agree
from calibration.engine.geometry import rotations

BY_NAME = {each.name: each for each in THREE_NUMBER_READINGS}
FIXED, MOVING = "Euler angles about the fixed axes ", "Euler angles about the moving axes "


def some(n: int = 12, seed: int = 0) -> Array:
    return rotations.exp(np.random.default_rng(seed).normal(size=(n, 3)) * 1.5)


def meant(name: str, read_as: str, R: Array, known: Array) -> Array:
    found = next(each for each in rereadings(R) if (each.written, each.read) == (name, read_as))
    chosen, apart = rotations_that_agree(found.branches, known)
    assert apart < 1e-9
    return chosen


@pytest.mark.parametrize("reading", THREE_NUMBER_READINGS, ids=lambda each: each.name)
def test_numbers_are_of_the_rotation_in_every_branch(reading: Reading) -> None:
    R = some()
    numbers = reading.numbers(R)
    there = np.isfinite(numbers).all(-1)
    assert there[:, 0].all()
    assert np.abs(reading.rotation(numbers)[there] - np.broadcast_to(R[:, None], (12, 2, 3, 3))[there]).max() < 1e-9


def test_roll_pitch_yaw_are_angles_about_fixed_axes() -> None:
    angles = np.random.default_rng(1).uniform(-1, 1, (5, 3))
    assert np.allclose(BY_NAME[f"{FIXED}x, y, z"].rotation(angles), rotations.from_rpy(angles))
    assert np.allclose(BY_NAME[f"{MOVING}z, y, x"].rotation(angles[:, ::-1]), rotations.from_rpy(angles))


@pytest.mark.parametrize("written", [f"{FIXED}x, y, z", f"{MOVING}z, y, z", f"{MOVING}x, z, y"])
@pytest.mark.parametrize("read", ["rotation vectors", f"{FIXED}z, x, y"])
def test_angles_read_by_another_convention_are_had_back(written: str, read: str) -> None:
    true, X = some(), some(1, 5)[0]
    wrong = BY_NAME[read].rotation(BY_NAME[written].numbers(true)[:, 0])
    assert np.abs(meant(written, read, wrong, X @ true) - true).max() < 1e-9


def test_rotation_vectors_in_degrees_are_had_back_through_all_their_turns() -> None:
    true = some()
    wrong = rotations.exp(np.degrees(rotations.log(true)))
    assert np.abs(meant("rotation vectors in degrees", "radians", wrong, true) - true).max() < 1e-9


def test_radians_taken_for_degrees_are_had_back() -> None:
    true = rotations.from_rpy(np.random.default_rng(2).uniform(-1.4, 1.4, (9, 3)))
    wrong = rotations.from_rpy(np.radians(rotations.to_rpy(true)))
    assert np.abs(meant(f"{FIXED}x, y, z in radians", "degrees", wrong, true) - true).max() < 1e-7


@pytest.mark.parametrize("names", QUATERNION_ORDERS, ids=lambda names: names[0])
def test_quaternions_in_the_other_order_are_had_back(names: tuple[str, str]) -> None:
    true = some()
    x, y, z, w = np.moveaxis(rotations.to_quaternion(true), -1, 0)
    moved = (w, x, y, z) if names[0] == "wxyz" else (y, z, w, x)
    wrong = rotations.from_quaternion(np.stack(moved, -1))
    found = next(each for each in rereadings(wrong) if each.written == f"quaternions {names[0]}")
    assert found.read == f"quaternions {names[1]}"
    assert np.abs(found.branches[:, 0] - true).max() < 1e-9


def test_a_branch_is_chosen_though_most_are_of_the_other() -> None:
    R = some(20)
    other = R @ np.diag([-1.0, -1.0, 1.0])
    second = np.arange(20) % 3 > 0
    branches = np.where(second[:, None, None, None], np.stack([other, R], 1), np.stack([R, other], 1))
    chosen, apart = rotations_that_agree(branches, some(1, 3)[0] @ R)
    assert apart < 1e-9
    assert min(np.abs(chosen - R).max(), np.abs(chosen - other).max()) < 1e-9


def test_the_memory_does_not_grow_with_the_square_of_the_branches() -> None:
    R = some(600)
    branches = np.stack([rotations.exp(np.array([0.0, 0.0, angle])) @ R for angle in np.linspace(0, 6, 60)], 1)
    tracemalloc.start()
    chosen, apart = rotations_that_agree(branches, some(1, 3)[0] @ R)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert apart < 1e-9
    assert peak < 20 * branches.nbytes
    assert np.abs(chosen @ np.swapaxes(R, 1, 2) - chosen[0] @ R[0].T).max() < 1e-9
