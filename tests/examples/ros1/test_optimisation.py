import numpy as np
import pytest
from example_robot.optimisation import with_noise
from example_robot.poses import from_vector
from scipy.spatial.transform import Rotation


@pytest.mark.parametrize(("translation", "rotation"), [(0.1, 0.0), (0.0, 0.2), (0.3, 0.05)])
def test_noise_is_of_the_size_that_is_asked_for(translation: float, rotation: float) -> None:
    guesses = {name: from_vector(np.array([1, 2, 3, 0.1, -0.2, 0.3])) for name in ("left", "right")}
    noisy = with_noise(guesses, translation, rotation, 7)
    for name, T in guesses.items():
        assert np.linalg.norm(noisy[name][:3, 3] - T[:3, 3]) == pytest.approx(translation)
        angles = [Rotation.from_matrix(pose[:3, :3]).as_euler("xyz") for pose in (noisy[name], T)]
        assert np.abs(angles[0] - angles[1]) == pytest.approx([rotation] * 3)
    assert not np.array_equal(noisy["left"], noisy["right"])
