import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calibration.base import ExitCode, InputError
from calibration.engine.geometry import rotations
from calibration.engine.geometry.frames import JOINT_PARAMETERS, FrameTree, JointModel, Step
from calibration.engine.geometry.transforms import (
    adjoint,
    from_xyz_rpy,
    inverse,
    local,
    retract,
    transform,
    translation,
    twists_in_child,
)
from tests.properties import at_most

ROBOT = [("world", "arm"), ("world", "tripod"), ("arm", "hand"), ("tripod", "mount"), ("mount", "camera")]


def steps(*edges: tuple[str, str, bool]) -> tuple[Step, ...]:
    return tuple(Step(*edge) for edge in edges)


def test_down():
    expected = steps(("tripod", "mount", False), ("mount", "camera", False))
    assert FrameTree(ROBOT).path("tripod", "camera") == expected


def test_up():
    assert FrameTree(ROBOT).path("camera", "tripod") == steps(("mount", "camera", True), ("tripod", "mount", True))


def test_up_and_down_by_the_nearest_common_frame():
    assert FrameTree(ROBOT).path("hand", "mount") == steps(
        ("arm", "hand", True), ("world", "arm", True), ("world", "tripod", False), ("tripod", "mount", False)
    )


def test_siblings():
    tree = FrameTree([("a", "b"), ("b", "c"), ("b", "d")])
    assert tree.path("c", "d") == steps(("b", "c", True), ("b", "d", False))


def test_the_way_to_itself_is_empty():
    assert FrameTree(ROBOT).path("hand", "hand") == ()


def test_frames_come_in_order_of_appearance():
    tree = FrameTree(ROBOT)
    assert tree.frames == ("world", "arm", "tripod", "hand", "mount", "camera")
    assert "hand" in tree
    assert "foot" not in tree


def test_an_edge_may_stand_twice():
    assert FrameTree([*ROBOT, ("mount", "camera")]).frames == FrameTree(ROBOT).frames


def test_no_edges():
    assert FrameTree([]).frames == ()


@pytest.mark.parametrize(("start", "end"), [("foot", "world"), ("world", "foot")])
def test_an_unknown_frame(start, end):
    with pytest.raises(InputError, match=r"frame 'foot' is not in the tree \(frames: world, arm") as caught:
        FrameTree(ROBOT).path(start, end)
    assert caught.value.exit_code == ExitCode.BAD_INPUT


def test_frames_that_are_not_connected():
    tree = FrameTree([("world", "arm"), ("table", "cup")])
    with pytest.raises(InputError, match="'arm' and 'cup' are not connected"):
        tree.path("arm", "cup")


def test_two_parents():
    with pytest.raises(InputError, match="frame 'camera' has two parents, 'mount' and 'hand'; a tree needs one"):
        FrameTree([*ROBOT, ("hand", "camera")])


@pytest.mark.parametrize(
    ("edges", "loop"),
    [
        ([("a", "a")], "a -> a"),
        ([("a", "b"), ("b", "a")], "a -> b -> a"),
        ([("a", "b"), ("b", "c"), ("c", "a")], "a -> b -> c -> a"),
        ([("c", "tail"), ("a", "b"), ("b", "c"), ("c", "a"), ("tail", "tip")], "c -> a -> b -> c"),
        ([("b", "tail"), ("a", "b"), ("b", "a")], "b -> a -> b"),
        ([("world", "robot"), ("a", "b"), ("b", "a")], "a -> b -> a"),
    ],
)
def test_a_loop_is_named_along_its_edges(edges, loop):
    with pytest.raises(InputError, match=f"frames form a loop: {loop}$"):
        FrameTree(edges)


def test_a_long_chain_is_followed_once():
    chain = [(f"f{i}", f"f{i + 1}") for i in range(20_000)]  # minutes, if every frame looked at all above it
    assert len(FrameTree(reversed(chain)).path("f0", "f20000")) == 20_000


MODELS = [JointModel(False, (0.0, 0.6, 0.8)), JointModel(True, (0.8, 0.0, -0.6)), JointModel(False, (0.0, 0.0, 1.0))]
ANGLES = st.lists(st.floats(-3.0, 3.0), min_size=7, max_size=7)


@pytest.mark.parametrize("model", MODELS)
@at_most(25)
@given(values=ANGLES, position=st.floats(-2, 2))
def test_a_joint_is_its_origin_and_a_motion_by_position_and_bias(model, values, position):
    values = np.array(values)
    step = (position + values[6]) * np.array(model.axis)
    motion = translation(step) if model.prismatic else transform(rotations.exp(step), np.zeros(3))
    expected = from_xyz_rpy(values[:3], values[3:6]) @ motion
    np.testing.assert_allclose(model.pose(values) @ model.motion(position), expected, atol=1e-12)


@pytest.mark.parametrize("model", MODELS)
@at_most(25)
@given(values=ANGLES)
def test_the_columns_are_the_derivatives(model, values):
    values, h = np.array(values), 1e-6
    for k, column in enumerate(model.columns(values).T):
        ahead, behind = (local(model.pose(values), model.pose(values + s * h * np.eye(7)[k])) for s in (1, -1))
        np.testing.assert_allclose(column, (ahead - behind) / (2 * h), atol=1e-8)


def test_positions_of_any_shape():
    for model in MODELS:
        T = model.motion(np.linspace(-1, 1, 6).reshape(2, 3))
        assert T.shape == (2, 3, 4, 4)
        np.testing.assert_array_equal(T[1, 2], model.motion(1.0))


def test_units():
    turning, sliding = MODELS[:2]
    assert [turning.unit(p) for p in JOINT_PARAMETERS] == ["m"] * 3 + ["rad"] * 4
    assert [sliding.unit(p) for p in JOINT_PARAMETERS] == ["m"] * 3 + ["rad"] * 3 + ["m"]


def test_a_few_twists_are_moved_as_the_adjoint_does():
    rng = np.random.default_rng(0)
    T = retract(np.broadcast_to(np.eye(4), (5, 4, 4)), rng.normal(size=(5, 6)))
    for k in (1, 3, 7):
        columns = rng.normal(size=(6, k))
        np.testing.assert_allclose(twists_in_child(T, columns), adjoint(inverse(T)) @ columns, atol=1e-12)
