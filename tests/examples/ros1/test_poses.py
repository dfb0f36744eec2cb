import numpy as np
import pytest
from example_robot.poses import along, chain, from_entry, from_vector, to_entry, to_vector
from hypothesis import given
from hypothesis import strategies as st

lengths = st.floats(-5, 5).map(lambda x: round(x, 6))
vectors = st.tuples(*[lengths] * 3, *[st.floats(-1.8, 1.8).map(lambda x: round(x, 6))] * 3).map(np.array)


@given(vectors)
def test_a_pose_survives_its_two_forms(vector: np.ndarray) -> None:
    T = from_vector(vector)
    np.testing.assert_allclose(to_vector(T), vector, atol=1e-9)
    np.testing.assert_allclose(from_entry(to_entry("a", "b", T)), T, atol=1e-12)


def test_a_chain_leads_from_a_frame_down_to_another() -> None:
    edges = [("b", "c"), ("world", "a"), ("a", "b"), ("a", "other")]
    assert chain(edges, "world", "c") == [("world", "a"), ("a", "b"), ("b", "c")]
    assert chain(edges, "c", "c") == []
    assert chain(edges, "other", "c") is None
    assert chain([("a", "b"), ("b", "a")], "world", "a") is None  # a loop


def test_poses_along_a_chain_are_multiplied() -> None:
    one, two = from_vector(np.array([1, 2, 3, 0, 0, np.pi / 2])), from_vector(np.array([1.0, 0, 0, 0, 0, 0]))
    transforms = {"world-a": to_entry("world", "a", one), "a-b": to_entry("a", "b", two)}
    np.testing.assert_allclose(along(transforms, "world", "b")[:3, 3], [1, 3, 3])
    with pytest.raises(ValueError, match="no transform leads from b to world"):
        along(transforms, "b", "world")
