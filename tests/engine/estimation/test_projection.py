"""Uncertainty of projection: that of calibrations of other recordings, with the camera's own pose made up for."""

from dataclasses import replace

import numpy as np
import pytest

from calibration.base.arrays import Array
from calibration.engine.dataset.model import Dataset
from calibration.engine.estimation.calibrate import calibrate
from calibration.engine.estimation.covariance.projection import Projection, given_lens, projection_of
from calibration.engine.estimation.options import ALL_EXACT, Assumptions, Options
from calibration.engine.geometry.cameras import Camera
from calibration.engine.geometry.lenses import Equidistant, PlumbBob
from calibration.engine.geometry.transforms import apply
from tests.engine.estimation.systems import covering, stereo

OPTIONS = Options(intrinsics=("all",), assume=ALL_EXACT, loss="linear")
LENSES = {
    "plumb_bob": Camera(600.0, 590.0, 640.0, 480.0, 1280, 960, PlumbBob(-0.10, 0.05, 0.001, -0.0005, 0.01)),
    "equidistant": Camera(500.0, 495.0, 640.0, 480.0, 1280, 960, Equidistant(-0.02, 0.01, -0.003, 0.001)),
}


def scene(model: Camera, seed: int, views: int = 25, noise: float = 0.2) -> Dataset:
    """Other noise of the same views."""
    return covering(views, 7, 1, model=model, pixel_noise=noise).dataset(seed)


def moved_to_fit(camera: Camera, other: Camera, points: Array) -> Array:
    """The twist (6,) of points (n, 3) after which another camera sees them where a camera has seen them."""
    twist, seen = np.zeros(6), camera.project(points)
    for _ in range(8):
        J = np.empty((seen.size, 6))
        off = (other.project(moved(points, twist)) - seen).ravel()
        for k in range(6):
            step = np.zeros(6)
            step[k] = 1e-6
            J[:, k] = ((other.project(moved(points, twist + step)) - seen).ravel() - off) / 1e-6
        twist = twist - np.linalg.lstsq(J, off, rcond=None)[0]
    return twist


def moved(points: Array, twist: Array) -> Array:
    """Points after a small twist, to first order."""
    return points + twist[:3] + np.cross(twist[3:], points)


def corners_of(dataset: Dataset, name: str = "c0") -> Array:
    """Corners (n, 3) of all views in the camera's frame, at the true poses."""
    pattern = dataset.patterns["board"] if "board" in dataset.patterns else next(iter(dataset.patterns.values()))
    T = dataset.transform(dataset.sensors[name].frame, pattern.link)
    return np.concatenate([apply(each, pattern.corners) for each in T])


@pytest.mark.thorough(but_first=1)
@pytest.mark.parametrize("name", LENSES)
@pytest.mark.many_scenes
def test_the_map_is_the_scatter_of_calibrations_of_other_recordings(name: str) -> None:
    model = LENSES[name]
    first = calibrate(scene(model, 0), OPTIONS)
    found = projection_of(first, "c0")
    covariance = first.intrinsics["c0"].covariance
    corners = corners_of(scene(model, 0))
    x, y = np.moveaxis(model.normalise(found.pixels), -1, 0)
    rays = np.stack([x, y, np.ones_like(x)], -1).reshape(-1, 3)
    far, near = [], []
    for seed in range(1, 21):
        other = calibrate(scene(model, seed), OPTIONS).dataset.sensors["c0"].camera
        assert other is not None
        twist = moved_to_fit(model, other, corners)
        turned = twist * np.array([0, 0, 0, 1, 1, 1])
        far.append(other.project(moved(rays, turned)) - found.pixels.reshape(-1, 2))
        at = found.distance * rays / np.linalg.norm(rays, axis=-1, keepdims=True)
        near.append(other.project(moved(at, twist)) - found.pixels.reshape(-1, 2))
    for scatter, distance in ((far, np.inf), (near, found.distance)):
        worst = np.array([np.linalg.eigvalsh(np.cov(np.array(scatter)[:, i].T))[-1] for i in range(len(rays))])
        stated = found.sigmas(covariance, distance).ravel()
        ratio = np.sqrt(worst) / stated
        inside = found.seen.ravel() & np.isfinite(ratio)
        assert np.median(ratio[inside]) == pytest.approx(1.0, abs=0.2)
        assert np.quantile(ratio[inside], 0.9) < 1.5


def simple_projection(model: Camera) -> tuple[Projection, Array]:
    result = calibrate(scene(model, 0), OPTIONS)
    return projection_of(result, "c0"), result.intrinsics["c0"].covariance


def test_what_a_motion_of_the_camera_makes_up_for_does_not_count() -> None:
    found, _ = simple_projection(LENSES["plumb_bob"])
    change = np.array([found.camera.parameters[i] == "cx" for i in found.at], float)
    assert found.shift(change) < 0.5  # px, of 1 px by which every point moves
    far = np.linalg.norm(found.changes() @ change, axis=-1)
    near = np.linalg.norm(found.changes(found.distance) @ change, axis=-1)
    assert np.nanmedian(near) < np.nanmedian(far) < 1.5


def test_it_is_best_where_the_patterns_were() -> None:
    found, covariance = simple_projection(LENSES["plumb_bob"])
    there = np.nanmedian(found.sigmas(covariance, found.distance))
    assert there < np.nanmedian(found.sigmas(covariance))
    assert there < np.nanmedian(found.sigmas(covariance, found.distance / 10))


def test_cells_that_the_lens_cannot_see_have_no_number() -> None:
    found, covariance = simple_projection(LENSES["equidistant"])
    larger = replace(found, camera=replace(found.camera, width=9600, height=7200))
    sigmas = larger.sigmas(covariance)
    assert np.isnan(sigmas[-1, -1])
    assert np.isfinite(sigmas[0, 0])


def test_given_intrinsics_are_as_sure_as_other_ones_with_their_errors_place_points() -> None:
    """By draws of the intrinsics; each camera is placed again, to fit the corners."""
    result = calibrate(stereo(30, pixel_noise=0.2).dataset(), Options(assume=Assumptions(focal_length=0.002)))
    lens = given_lens(result, "left")
    assert lens is not None
    assert lens.source == "assume"
    camera = result.dataset.sensors["left"].camera
    assert camera is not None
    at = tuple(camera.parameters.index(name) for name in lens.parameters)
    found = projection_of(result, "left", at)
    corners = corners_of(result.dataset, "left")[::11]
    rays = camera.rays(found.pixels[::6, ::6].reshape(-1, 2))
    points = found.distance * rays / np.linalg.norm(rays, axis=-1, keepdims=True)
    draws, scatter = np.random.default_rng(1), []
    for _ in range(80):
        changed = camera.intrinsics.copy()
        changed[list(at)] += lens.root @ draws.standard_normal(lens.root.shape[1])
        other = camera.with_intrinsics(changed)
        scatter.append(other.project(moved(points, moved_to_fit(camera, other, corners))) - camera.project(points))
    worst = [np.linalg.eigvalsh(np.cov(np.array(scatter)[:, i].T))[-1] for i in range(len(points))]
    stated = found.sigmas(lens.root @ lens.root.T, found.distance)[::6, ::6].ravel()
    assert np.median(np.sqrt(worst) / stated) == pytest.approx(1.0, abs=0.15)


def test_intrinsics_that_are_calibrated_or_exactly_known_are_not_given() -> None:
    assert given_lens(calibrate(scene(LENSES["plumb_bob"], 0), OPTIONS), "c0") is None
    assert given_lens(calibrate(stereo().dataset(), Options(assume=ALL_EXACT)), "left") is None
