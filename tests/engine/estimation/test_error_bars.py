"""Total covariances: the labels' noise, disagreement of collections, and errors of fixed parameters."""

from dataclasses import replace

import numpy as np
import pytest

from calibration.base.arrays import Array, IntArray
from calibration.engine.dataset.model import Dataset
from calibration.engine.estimation.calibrate import Options, calibrate
from calibration.engine.estimation.covariance.error_bars import beyond_average, scatter_of_clusters
from calibration.engine.estimation.covariance.lens_errors import lens_errors
from calibration.engine.estimation.covariance.linear_model import LinearModel, linear_model
from calibration.engine.estimation.covariance.result import Calibration
from calibration.engine.estimation.least_squares import label_columns
from calibration.engine.estimation.least_squares.normal_equations import assemble
from calibration.engine.estimation.options import ALL_EXACT, OF_INTRINSICS, Assumptions
from calibration.engine.geometry.transforms import local, retract
from tests.engine.estimation import systems


def bars(found: Calibration) -> tuple[Array, Array, Array]:
    """The covariances of the first calibrated block: labels alone, expected, in all."""
    assert found.error_bars is not None
    block = next(iter(found.error_bars.total))
    return found.error_bars.labels[block], found.error_bars.expected[block], found.error_bars.total[block]


def test_with_exact_fixed_parameters_they_are_by_the_labels_alone() -> None:
    found = calibrate(systems.stereo(20, seed=1, pixel_noise=0.2).dataset(1), Options(assume=ALL_EXACT))
    labels, expected, total = bars(found)
    np.testing.assert_array_equal(labels, expected)
    assert np.trace(labels) <= np.trace(total) < 1.6 * np.trace(labels)
    (edge,) = found.covariances
    assert found.label_sigma_mm(edge) <= found.sigma_mm(edge)


@pytest.mark.thorough(but_first=1)
@pytest.mark.parametrize(
    "assume",
    [
        replace(ALL_EXACT, focal_length=1e-4),
        replace(ALL_EXACT, principal_point=0.05),
        replace(ALL_EXACT, **dict.fromkeys(OF_INTRINSICS)),
    ],
)
def test_camera_info_counts_by_its_effect_on_the_result(assume: Assumptions) -> None:
    """The added covariance, against calibrations with each of its independent errors."""
    dataset = systems.stereo(12, seed=1).dataset(1)
    levels = replace(Options().noise_levels, pixel=0.2)
    options = Options(assume=assume, noise_levels=levels)
    found = calibrate(dataset, options)
    labels, expected, _ = bars(found)
    (edge,) = found.covariances
    moves = []
    for name, sensor in dataset.sensors.items():
        camera = sensor.camera
        assert camera is not None
        lens = lens_errors(camera, assume, None)
        at = [camera.parameters.index(parameter) for parameter in lens.parameters]
        for error in lens.root.T:
            values = camera.intrinsics
            values[at] += error
            other = calibrate(dataset.with_cameras({name: camera.with_intrinsics(values)}), options)
            moves.append(local(found.transforms[edge], other.transforms[edge]))
    added = np.array(moves).T @ np.array(moves)
    np.testing.assert_allclose(expected - labels, added, rtol=0.03, atol=0.03 * np.abs(added).max())


def shaken(dataset: Dataset, sigma: float, seed: int) -> Dataset:
    """The dataset with an arm that differs from its encoders, by so much (m, rad) in each collection."""
    rng = np.random.default_rng(seed)
    edge = next(e for e, T in dataset.transforms.items() if np.abs(T - T[0]).max() > 1e-3)
    T = dataset.transforms[edge]
    return dataset.with_transforms({edge: retract(T, sigma * rng.normal(size=(len(T), 6)))})


@pytest.mark.many_scenes
def test_an_arms_repeatability_widens_them_by_its_error() -> None:
    scores, alone = [], []
    for seed in range(12):
        exact = systems.eye_to_hand(20, seed=seed, pixel_noise=0.1).dataset(seed)
        found = calibrate(shaken(exact, 1e-3, seed), Options(assume=ALL_EXACT))
        for sensor in exact.sensors.values():
            e = local(found.transforms[sensor.edge], exact.transforms[sensor.edge][0])
            scores.append(e @ np.linalg.solve(found.covariances[sensor.edge], e) / 6)
            alone.append(e @ np.linalg.solve(found.label_covariances[sensor.edge], e) / 6)
    assert 0.3 < np.median(scores) < 1.5
    assert np.median(alone) > 3 * np.median(scores)


def test_how_many_collections_count_and_what_the_result_hangs_on() -> None:
    dataset = systems.stereo(10, seed=1, pixel_noise=0.2).dataset(1)
    found = calibrate(dataset)
    assert found.error_bars is not None
    assert 4 < found.error_bars.effective_collections <= 10
    assert set(found.error_bars.worth) >= {"camera_info of left", "size of board"}


def test_the_defaults_are_those_of_a_good_robot() -> None:
    defaults = Assumptions()
    assert (defaults.focal_length, defaults.principal_point, defaults.flatness) == (None, None, 0.0002)
    assert replace(defaults, **dict.fromkeys(vars(defaults), 0.0)) == ALL_EXACT


def test_contributions_are_in_metres_of_transforms_alone() -> None:
    """Intrinsics that are calibrated too, in pixels, are displaced by nothing."""
    dataset = systems.stereo(24, seed=1, pixel_noise=0.1).dataset(1)
    bars = calibrate(dataset, Options(intrinsics=("all",))).error_bars
    assert bars is not None
    assert 0 < max(bars.worth.values()) < 0.01


def with_gaps(sensor: str, _: str, i: int) -> bool:
    """Whether a sensor sees the pattern; each camera misses some collections."""
    return i % 5 != ("left", "right", "cam", "lidar").index(sensor)


@pytest.mark.parametrize("labels", [1, 10**6])
@pytest.mark.parametrize("name", ["cameras", "LiDAR", "arm"])
def test_a_clusters_sums_are_those_of_its_collections(name: str, labels: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever the order of the clusters, and however many labels are in a pass."""
    scenes = {
        "cameras": systems.stereo(11, pixel_noise=0.3, sees=with_gaps),
        "LiDAR": systems.camera_and_lidar(11, pixel_noise=0.3, range_noise=0.01, sees=with_gaps),
        "arm": systems.eye_to_hand(11, pixel_noise=0.3),
    }
    solution = calibrate(scenes[name].dataset(1)).solution
    problem, values = solution.setup.problem, solution.values

    def model(clusters: IntArray) -> LinearModel:
        return linear_model(problem, values, solution.weighting, solution.dataset, Assumptions(), clusters)

    each = model(np.arange(11))
    information = assemble(problem, values, solution.weighting).schur
    S = each.shared
    np.testing.assert_allclose(each.G.sum(0)[:S, :S], information, atol=1e-9 * np.abs(information).max())
    monkeypatch.setattr(label_columns, "LABELS_PER_PASS", labels)
    clusters = np.array([0, 1, 2, 0, 1, 2, 3, 3, 2, 0, 1])
    together = model(clusters)
    for k in range(4):
        expected = each.G[clusters == k].sum(0)
        np.testing.assert_allclose(together.G[k], expected, atol=1e-9 * np.abs(each.G).max())
        np.testing.assert_allclose(together.G[k], together.G[k].T, atol=1e-12 * np.abs(each.G).max())
        gradient = each.g[clusters == k].sum(0)
        np.testing.assert_allclose(together.g[k], gradient, atol=1e-9 * np.abs(each.g).max())


@pytest.mark.parametrize(("alike", "expected"), [(0.0, 1.0), (0.5, 3.0), (0.8, 9.0)])
def test_changes_that_are_alike_in_a_row_add_up(alike: float, expected: float) -> None:
    """The variance of a sum of K of them: K (1 + alike) / (1 - alike) of a first-order autoregression; less by bias."""
    rng = np.random.default_rng(0)
    K, ratios, batches = 200, [], []
    for _ in range(100):
        pulls = rng.normal(size=(K, 3))
        for k in range(1, K):
            pulls[k] = alike * pulls[k - 1] + np.sqrt(1 - alike**2) * pulls[k]
        scatter, shares = scatter_of_clusters(np.tile(np.eye(3) / K, (K, 1, 1)), (pulls - pulls.mean(0)) / np.sqrt(K))
        ratios.append(np.trace(scatter) / 3)
        batches.append(len(shares))
    assert 0.75 * expected < np.mean(ratios) < 1.1 * expected
    assert np.median(batches) == K if alike == 0 else np.median(batches) <= K / 4


def test_a_direction_in_which_clusters_disagree_more_than_on_average_counts_by_itself() -> None:
    """What is beyond it is added there, and nothing elsewhere; nothing of what disagrees alike."""
    turned, _ = np.linalg.qr(np.random.default_rng(0).normal(size=(4, 4)))
    columns = beyond_average(turned * [9.0, 1.0, 2.0, 0.5] @ turned.T, 3.0)
    np.testing.assert_allclose(columns @ columns.T, 6.0 * np.outer(turned[:, 0], turned[:, 0]), atol=1e-12)
    assert not beyond_average(3.0 * np.eye(4), 3.0).any()
