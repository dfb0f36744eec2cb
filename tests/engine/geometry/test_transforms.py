import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from calibration.engine.geometry import rotations, transforms
from tests.engine.geometry.strategies import poses, shapes, vectors

IDENTITY = np.eye(4)


def close(a, b, atol=1e-12):
    np.testing.assert_allclose(a, np.broadcast_to(b, np.shape(a)), rtol=0, atol=atol)


@given(st.data())
def test_the_group_axioms(data):
    shape = st.just(data.draw(shapes))
    A, B, C = (data.draw(poses(shape)) for _ in range(3))
    close((A @ B) @ C, A @ (B @ C))
    close(A @ IDENTITY, A, 0)
    close(A @ transforms.inverse(A), IDENTITY)
    close(transforms.inverse(A) @ A, IDENTITY)
    close(transforms.inverse(A @ B), transforms.inverse(B) @ transforms.inverse(A))


@given(poses())
def test_inverse_is_the_matrix_inverse_and_its_own(T):
    close(transforms.inverse(T), np.linalg.inv(T), 1e-11)
    close(transforms.inverse(transforms.inverse(T)), T)


def test_batches_broadcast():
    R = rotations.exp(np.random.default_rng(0).normal(size=(5, 1, 3)))
    t = np.random.default_rng(1).normal(size=(4, 3))
    T = transforms.transform(R, t)
    assert T.shape == (5, 4, 4, 4)
    close(T[3, 2], transforms.transform(R[3, 0], t[2]), 0)
    close(transforms.translation(t)[2, :3, 3], t[2], 0)


def test_a_transform_of_lists_has_floats():
    assert transforms.transform([[1, 0, 0], [0, 1, 0], [0, 0, 1]], [1, 2, 3]).dtype == float


@given(st.data())
def test_apply_is_the_product_with_homogeneous_points(data):
    T = data.draw(poses())
    points = data.draw(vectors(3, 10.0, st.just((*T.shape[:-2], 7))))
    homogeneous = np.concatenate([points, np.ones((*points.shape[:-1], 1))], -1)
    close(transforms.apply(T, points), (T[..., None, :, :] @ homogeneous[..., None])[..., :3, 0])


@given(st.data())
def test_apply_composes(data):
    shape = st.just(data.draw(shapes))
    A, B = data.draw(poses(shape)), data.draw(poses(shape))
    points = np.random.default_rng(0).normal(size=(6, 3))
    close(transforms.apply(A @ B, points), transforms.apply(A, transforms.apply(B, points)))


@given(st.data())
def test_the_adjoint_is_a_homomorphism(data):
    shape = st.just(data.draw(shapes))
    A, B = data.draw(poses(shape)), data.draw(poses(shape))
    close(transforms.adjoint(A @ B), transforms.adjoint(A) @ transforms.adjoint(B), 1e-11)
    close(transforms.adjoint(transforms.inverse(A)), np.linalg.inv(transforms.adjoint(A)), 1e-10)
    close(transforms.inverse_adjoint(A), transforms.adjoint(transforms.inverse(A)), 1e-11)


@given(st.data())
def test_the_adjoint_moves_a_twist_to_the_parent_frame(data):
    """T exp(xi) = exp(Ad(T) xi) T, to first order."""
    T = data.draw(poses())
    direction = data.draw(vectors(6, 1.0, st.just(T.shape[:-2])))
    step = 1e-6
    inside = transforms.retract(T, step * direction)
    moved = (transforms.adjoint(T) @ (step * direction)[..., None])[..., 0]
    outside = transforms.retract(np.broadcast_to(IDENTITY, T.shape), moved) @ T
    close(inside, outside, 1e3 * step**2)


@given(st.data())
def test_local_undoes_retract(data):
    T = data.draw(poses())
    twist = data.draw(vectors(6, 1.7, st.just(T.shape[:-2])))  # a rotation below pi
    close(transforms.local(T, transforms.retract(T, twist)), twist, 1e-11)


@given(st.data())
def test_retract_undoes_local(data):
    shape = st.just(data.draw(shapes))
    A, B = data.draw(poses(shape)), data.draw(poses(shape))
    close(transforms.retract(A, transforms.local(A, B)), B, 1e-11)


@given(poses())
def test_a_twist_of_zero_stays(T):
    close(transforms.retract(T, np.zeros((*T.shape[:-2], 6))), T, 1e-15)
    close(transforms.local(T, T), 0, 1e-14)


def test_distance_is_a_length_and_an_angle():
    T = transforms.from_xyz_rpy([1, 2, 3], [0.1, 0.2, 0.3])
    moved = transforms.retract(T, np.array([0.3, 0, 0.4, 0, 0, -0.25]))
    translation, angle = transforms.distance(T, moved)
    close(translation, 0.5)
    close(angle, 0.25)


@given(st.data())
def test_distance_is_symmetric_and_the_same_seen_from_anywhere(data):
    shape = st.just(data.draw(shapes))
    A, B, C = (data.draw(poses(shape)) for _ in range(3))
    forth, back, elsewhere = transforms.distance(A, B), transforms.distance(B, A), transforms.distance(C @ A, C @ B)
    for i in range(2):
        close(forth[i], back[i], 1e-7)
        close(forth[i], elsewhere[i], 1e-7)


def test_urdf_origins():
    T = transforms.from_xyz_rpy([0, 0, 0.1], [-np.pi / 2, 0, -np.pi / 2])  # a camera's optical frame
    close(T[:3, :3] @ [0, 0, 1], [1, 0, 0])  # it looks along the parent's x
    close(T, transforms.from_quaternion([0, 0, 0.1], [0.5, -0.5, 0.5, -0.5]))
