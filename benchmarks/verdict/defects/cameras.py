"""Cameras whose intrinsics, or whose images, are not what the user has."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from benchmarks.verdict.scene import Scene
from calibration.dataset.model import CornerLabels, Labels
from calibration.geometry.cameras import Camera
from calibration.geometry.distortion import Equidistant, PlumbBob
from calibration.geometry.types import Array


def one_of(names: list[str], rng: np.random.Generator) -> str:
    """Random one of the names."""
    return names[int(rng.integers(len(names)))]


def camera_of(scene: Scene, name: str) -> Camera:
    """The intrinsics that the user has."""
    camera = scene.told.sensors[name].camera
    assert camera
    return camera


def _told(scene: Scene, name: str, camera: Camera) -> Scene:
    return replace(scene, told=scene.told.with_cameras({name: camera}))


def focal(scene: Scene, size: float, rng: np.random.Generator) -> Scene:
    """camera_info's focal length too great by a share."""
    name = one_of(scene.cameras, rng)
    camera = camera_of(scene, name)
    return _told(scene, name, replace(camera, fx=camera.fx * (1 + size), fy=camera.fy * (1 + size)))


def aspect(scene: Scene, size: float, rng: np.random.Generator) -> Scene:
    """Change fy alone."""
    name = one_of(scene.cameras, rng)
    camera = camera_of(scene, name)
    return _told(scene, name, replace(camera, fy=camera.fy * (1 + size)))


def principal_x(scene: Scene, size: float, rng: np.random.Generator) -> Scene:
    """cx, px."""
    name = one_of(scene.cameras, rng)
    camera = camera_of(scene, name)
    return _told(scene, name, replace(camera, cx=camera.cx + size))


def principal_y(scene: Scene, size: float, rng: np.random.Generator) -> Scene:
    """cy, px."""
    name = one_of(scene.cameras, rng)
    camera = camera_of(scene, name)
    return _told(scene, name, replace(camera, cy=camera.cy + size))


def _distorted(scene: Scene, rng: np.random.Generator, **by: float) -> Scene:
    name = one_of(scene.cameras, rng)
    camera = camera_of(scene, name)
    lens = camera.distortion
    assert isinstance(lens, PlumbBob)
    lens = replace(lens, **{key: getattr(lens, key) + value for key, value in by.items()})
    return _told(scene, name, replace(camera, distortion=lens))


def k1(scene: Scene, size: float, rng: np.random.Generator) -> Scene:
    """The first radial coefficient."""
    return _distorted(scene, rng, k1=size)


def k2(scene: Scene, size: float, rng: np.random.Generator) -> Scene:
    """The second radial coefficient."""
    return _distorted(scene, rng, k2=size)


def tangential(scene: Scene, size: float, rng: np.random.Generator) -> Scene:
    """p1 and p2."""
    return _distorted(scene, rng, p1=size, p2=-size)


def no_distortion(scene: Scene, size: float, rng: np.random.Generator) -> Scene:
    """The lens distorts by k1 = -size, and camera_info has zeros."""
    name = one_of(scene.cameras, rng)
    camera = camera_of(scene, name)
    real = replace(camera, distortion=PlumbBob(k1=-size, k2=size / 5))
    scene = scene.seen_as_in(replace(scene, world=scene.world.with_cameras({name: real})))
    return _told(scene, name, replace(camera, distortion=PlumbBob()))


def lens_model(scene: Scene, size: float, rng: np.random.Generator) -> Scene:
    """A fisheye lens whose coefficient is read as plumb_bob's."""
    name = one_of(scene.cameras, rng)
    camera = camera_of(scene, name)
    real = replace(camera, distortion=Equidistant(-size))
    scene = scene.seen_as_in(replace(scene, world=scene.world.with_cameras({name: real})))
    return _told(scene, name, replace(camera, distortion=PlumbBob(k1=-size)))


def bad_camera_info(scene: Scene, size: float, rng: np.random.Generator) -> Scene:
    """Another camera's: focal lengths off by a share, the principal point by as much of half the width."""
    name = one_of(scene.cameras, rng)
    camera = camera_of(scene, name)
    wrong = replace(
        camera,
        fx=camera.fx * (1 + size),
        fy=camera.fy * (1 + size),
        cx=camera.cx + size * camera.width / 2,
        cy=camera.cy - size * camera.width / 3,
    )
    return _told(scene, name, wrong)


def exchanged_intrinsics(scene: Scene, size: float, rng: np.random.Generator) -> Scene:
    """Two cameras whose focal lengths differ by a share; each has the camera_info of the other."""
    first, second, *_ = rng.permutation(scene.cameras).tolist()
    camera = camera_of(scene, second)
    longer = replace(camera, fx=camera.fx * (1 + size), fy=camera.fy * (1 + size))
    scene = scene.seen_as_in(replace(scene, world=scene.world.with_cameras({second: longer})))
    return replace(scene, told=scene.told.with_cameras({first: longer, second: camera_of(scene, first)}))


PixelChange = Callable[[Array, Camera, int], Array]
"""From pixels (K, 2), the intrinsics and the collection's index to other pixels."""


def mapped(scene: Scene, sensors: list[str], change: PixelChange) -> Scene:
    """The scene with the pixels of some cameras put elsewhere."""

    def moved(i: int, sensor: str, labels: Labels) -> Labels:
        if sensor not in sensors or not isinstance(labels, CornerLabels):
            return labels
        return replace(labels, pixels=change(labels.pixels, camera_of(scene, sensor), i))

    return scene.labelled(moved)


def skew(scene: Scene, size: float, rng: np.random.Generator) -> Scene:
    """Pixel columns that are not upright."""
    shear = np.array([[1.0, size], [0.0, 1.0]])
    return mapped(scene, [one_of(scene.cameras, rng)], lambda uv, c, _: (uv - (c.cx, c.cy)) @ shear.T + (c.cx, c.cy))


def half_pixel(scene: Scene, size: float, rng: np.random.Generator) -> Scene:
    """Another convention of pixel centres."""
    return mapped(scene, [one_of(scene.cameras, rng)], lambda uv, _, __: uv + size)


def scaled_images(scene: Scene, size: float, rng: np.random.Generator) -> Scene:
    """Images of another resolution than camera_info's."""
    return mapped(scene, [one_of(scene.cameras, rng)], lambda uv, _, __: (uv + 0.5) * size - 0.5)


def cropped_images(scene: Scene, size: float, rng: np.random.Generator) -> Scene:
    """Images that lack a border which camera_info has."""
    return mapped(scene, [one_of(scene.cameras, rng)], lambda uv, _, __: uv - (size, 0.6 * size))


def mirrored_images(scene: Scene, size: float, rng: np.random.Generator) -> Scene:
    """1: left is right; 2: top is bottom; 3: both, the camera hangs upside down."""

    def mirror(uv: Array, camera: Camera, _: int) -> Array:
        u, v = uv.T
        return np.stack([camera.width - 1 - u if size != 2 else u, camera.height - 1 - v if size != 1 else v], 1)

    return mapped(scene, [one_of(scene.cameras, rng)], mirror)


def focal_drift(scene: Scene, size: float, rng: np.random.Generator) -> Scene:
    """The focal length grows with the temperature, by a share from the first collection to the last."""
    last = max(1, len(scene.told.collections) - 1)

    def grown(uv: Array, camera: Camera, i: int) -> Array:
        centre = (camera.cx, camera.cy)
        return (uv - centre) * (1 + size * (i / last - 0.5)) + centre

    return mapped(scene, [one_of(scene.cameras, rng)], grown)


def pixel_noise(scene: Scene, size: float, rng: np.random.Generator) -> Scene:
    """Corners that a detector places badly, in all images."""
    return mapped(scene, scene.cameras, lambda uv, _, __: uv + rng.normal(0, size, uv.shape))


def outliers(scene: Scene, size: float, rng: np.random.Generator) -> Scene:
    """A share of the corners anywhere within 50 px."""

    def spoilt(uv: Array, _: Camera, __: int) -> Array:
        wrong = rng.random(len(uv)) < size
        return uv + wrong[:, None] * rng.uniform(-50, 50, uv.shape)

    return mapped(scene, scene.cameras, spoilt)
