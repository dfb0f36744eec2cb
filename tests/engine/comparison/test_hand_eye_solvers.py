"""The five hand-eye solutions: exact motions, OpenCV's answers, other places of base and target."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calibration.engine.comparison import arm as solvers
from calibration.engine.comparison.arm import relative_motions
from calibration.engine.geometry import rotations
from calibration.engine.geometry.transforms import distance, inverse, transform

SOLVERS = {name: getattr(solvers, f"solve_{name}") for name in ("tsai", "park", "horaud", "andreff", "daniilidis")}
EACH = pytest.mark.parametrize("name", SOLVERS)


def poses(rng, n, turn=1.0):
    return transform(rotations.exp(rng.normal(size=(n, 3)) * turn), rng.normal(size=(n, 3)))


def views(seed, n=10, noise=0.0, turn=0.5):
    """X, the poses ``T_hand_base``, and ``T_eye_target`` with noise (m, rad)."""
    rng = np.random.default_rng(seed)
    X, target = poses(rng, 2)
    hand = poses(rng, n, turn)
    wrong = transform(rotations.exp(rng.normal(size=(n, 3)) * noise), rng.normal(size=(n, 3)) * noise)
    return X, hand, inverse(X) @ hand @ target @ wrong


@EACH
@given(seed=st.integers(0, 2**32 - 1), n=st.integers(4, 12))
def test_exact_motions_give_exactly_the_transform(name, seed, n):
    X, hand, eye = views(seed, n)
    A, B = relative_motions(hand, eye)
    tilts = np.linalg.svd(rotations.log(A[:, :3, :3]), compute_uv=False)
    found = SOLVERS[name](A, B)
    if tilts[1] > 0.3:  # about two axes well
        assert max(distance(X, found)) < 1e-6


@EACH
@pytest.mark.parametrize("noise", [1e-3, 1e-2])
@pytest.mark.parametrize("n", [3, 4, 20])
def test_opencv_4_gives_the_same(name, noise, n):
    cv2 = pytest.importorskip("cv2")
    if not hasattr(cv2, "calibrateHandEye"):
        pytest.skip("OpenCV 5 has no calibrateHandEye")
    _, hand, eye = views(n, n, noise, turn=0.3)
    base = inverse(hand)
    R, t = cv2.calibrateHandEye(
        *([list(T[:, :3, :3]), list(T[:, :3, 3])][i] for T in (base, eye) for i in (0, 1)),
        method=getattr(cv2, f"CALIB_HAND_EYE_{name.upper()}"),
    )
    found = SOLVERS[name](*relative_motions(hand, eye))
    # since some version OpenCV leaves out motions that Tsai's equations weigh badly
    tolerance = 3 * noise if name == "tsai" else 1e-9
    assert max(distance(transform(R, t.ravel()), found)) < tolerance


@EACH
def test_where_base_and_target_lie_does_not_matter(name):
    _, hand, eye = views(5, noise=1e-2)
    elsewhere = poses(np.random.default_rng(6), 2)
    a = SOLVERS[name](*relative_motions(hand, eye))
    b = SOLVERS[name](*relative_motions(hand @ elsewhere[0], eye @ elsewhere[1]))
    np.testing.assert_allclose(a, b, atol=1e-9)


@EACH
def test_more_views_come_closer(name):
    errors = []
    for n in (5, 80):
        found = [
            distance(X, SOLVERS[name](*relative_motions(hand, eye)))
            for X, hand, eye in (views(s, n, 5e-3) for s in range(8))
        ]
        errors.append(np.mean([sum(error) for error in found]))
    assert errors[1] < 0.5 * errors[0]


def test_the_motions_of_many_views_are_bounded():
    _, hand, eye = views(7, 200)
    assert len(relative_motions(hand, eye)[0]) == 200 * 199 // 2
    X, hand, eye = views(8, 1000)
    A, B = relative_motions(hand, eye)
    assert len(A) == len(B) <= solvers.MOST_MOTIONS
    np.testing.assert_allclose(A @ X, X @ B, atol=1e-9)


PLAIN = {
    "the hand itself": np.eye(4),
    "beside it": transform(np.eye(3), [0, 0, 1.0]),
    "turned round": transform(np.diag([1.0, -1, -1]), [0.0, 0, 0]),
}


@pytest.mark.parametrize(
    ("name", "place"),
    # Tsai's vector, the tangent of half the angle, has no half turns
    [(name, place) for name in SOLVERS for place in PLAIN if (name, place) != ("tsai", "turned round")],
)
def test_an_eye_in_a_plain_place(name, place):
    hand, X = poses(np.random.default_rng(9), 8, 0.5), PLAIN[place]  # single numbers of the unknown are 0
    found = SOLVERS[name](*relative_motions(hand, inverse(X) @ hand))
    np.testing.assert_allclose(found, X, atol=1e-7)
