"""Cost of labels at given transforms: at the optimum the engine's, elsewhere by its information."""

from collections.abc import Callable

import numpy as np
import pytest

from calibration.engine.estimation.calibrate import calibrate
from calibration.engine.estimation.solve.options import Options
from calibration.engine.estimation.start.cost import cost_of
from calibration.engine.geometry.transforms import retract, translation
from tests.engine.estimation import systems
from tests.engine.estimation.scenes import Scene

EVERY = [
    systems.stereo,
    systems.ring,
    systems.eye_to_hand,
    systems.eye_in_hand,
    systems.camera_and_lidar,
    systems.linked_by_an_arm,
    systems.hand_and_world,
    systems.two_patterns,
    systems.mobile_base,
    systems.jointed_arm,
]


@pytest.mark.parametrize("system", EVERY, ids=lambda system: system.__name__)
def test_at_the_optimum_it_is_the_optimum_s(system: Callable[..., Scene]) -> None:
    found = calibrate(system(seed=1, pixel_noise=0.3).dataset())
    assert cost_of(found.dataset, Options(), found.noise_levels) == pytest.approx(found.cost, rel=1e-6)


def test_beside_it_it_grows_with_the_information() -> None:
    """A step d costs d^T C^-1 d more, with C the covariance of the only transform that is free."""
    options = Options(loss="linear")
    found = calibrate(systems.eye_to_hand(seed=1, pixel_noise=0.3).dataset(), options)
    edge = found.dataset.sensors["cam"].edge
    rng = np.random.default_rng(1)
    for _ in range(3):
        step = np.linalg.cholesky(found.label_covariances[edge]) @ rng.normal(size=6)
        moved = found.dataset.with_transforms({edge: retract(found.transforms[edge], step)})
        expected = step @ np.linalg.inv(found.label_covariances[edge]) @ step
        excess = cost_of(moved, options, found.noise_levels) - found.cost
        assert excess == pytest.approx(expected, rel=0.02)


def test_undetermined_directions_have_no_cost() -> None:
    found = calibrate(systems.stereo(seed=1, pixel_noise=0.3).dataset())
    both = {sensor.edge: translation(np.array([0.3, 0.2, 0.1])) for sensor in found.dataset.sensors.values()}
    moved = found.dataset.with_transforms({edge: T @ found.dataset.transforms[edge] for edge, T in both.items()})
    assert cost_of(moved, Options(), found.noise_levels) == pytest.approx(found.cost, rel=1e-6)


def test_where_a_camera_looks_away_it_is_infinite() -> None:
    found = calibrate(systems.stereo(seed=1, pixel_noise=0.3).dataset())
    edge = found.dataset.sensors["right"].edge
    about = found.dataset.with_transforms({edge: found.dataset.transforms[edge] @ np.diag([-1.0, 1.0, -1.0, 1.0])})
    assert cost_of(about, Options(), found.noise_levels) == np.inf
