import pytest

from calibration.base.errors import ExitCode, InputError
from calibration.engine.geometry.frames import FrameTree, Step

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
