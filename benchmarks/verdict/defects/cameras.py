"""Cameras whose intrinsics, or whose images, are not what the user has."""

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from functools import partial

import numpy as np

from benchmarks.verdict.scene import Scene
from calibration.base.arrays import Array
from calibration.engine.dataset.model import CornerLabels, Labels
from calibration.engine.geometry.cameras import Camera
from calibration.engine.geometry.lenses import Equidistant, PlumbBob
from calibration.engine.geometry.transforms import local, retract


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


@dataclass(frozen=True)
class MappedCamera(Camera):
    """A camera whose images are mapped, at work too."""

    change: Callable[[Array], Array] = np.asarray

    def project(self, points: Array) -> Array:
        """Pixels (..., 2) of points (..., 3) in the mapped image."""
        pixels = super().project(points)
        return self.change(pixels.reshape(-1, 2)).reshape(pixels.shape)


def _lasting(scene: Scene, sensors: list[str], change: PixelChange) -> Scene:
    """The scene with the pixels of some cameras put elsewhere, for good: at work as in the last image."""
    last, cameras = len(scene.told.collections) - 1, {}
    for name in sensors:
        camera, told = scene.world.sensors[name].camera, camera_of(scene, name)
        assert camera
        own = {each.name: getattr(camera, each.name) for each in fields(camera)}
        cameras[name] = MappedCamera(**own, change=partial(_mapped_as, change, told, last))
    return mapped(replace(scene, world=scene.world.with_cameras(cameras)), sensors, change)


def _mapped_as(change: PixelChange, camera: Camera, collection: int, pixels: Array) -> Array:
    return change(pixels, camera, collection)


def mapped(scene: Scene, sensors: list[str], change: PixelChange) -> Scene:
    """The scene with the pixels of some cameras put elsewhere, in each image in another way."""

    def moved(i: int, sensor: str, labels: Labels) -> Labels:
        if sensor not in sensors or not isinstance(labels, CornerLabels):
            return labels
        return replace(labels, pixels=change(labels.pixels, camera_of(scene, sensor), i))

    return scene.labelled(moved)


def skew(scene: Scene, size: float, rng: np.random.Generator) -> Scene:
    """Pixel columns that are not upright."""
    shear = np.array([[1.0, size], [0.0, 1.0]])
    return _lasting(scene, [one_of(scene.cameras, rng)], lambda uv, c, _: (uv - (c.cx, c.cy)) @ shear.T + (c.cx, c.cy))


def half_pixel(scene: Scene, size: float, rng: np.random.Generator) -> Scene:
    """Another convention of pixel centres."""
    return _lasting(scene, [one_of(scene.cameras, rng)], lambda uv, _, __: uv + size)


def scaled_images(scene: Scene, size: float, rng: np.random.Generator) -> Scene:
    """Images of another resolution than camera_info's."""
    return _lasting(scene, [one_of(scene.cameras, rng)], lambda uv, _, __: (uv + 0.5) * size - 0.5)


def cropped_images(scene: Scene, size: float, rng: np.random.Generator) -> Scene:
    """Images that lack a border which camera_info has."""
    return _lasting(scene, [one_of(scene.cameras, rng)], lambda uv, _, __: uv - (size, 0.6 * size))


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

    return _lasting(scene, [one_of(scene.cameras, rng)], grown)


def pixel_noise(scene: Scene, size: float, rng: np.random.Generator) -> Scene:
    """Corners that a detector places badly, in all images."""
    return mapped(scene, scene.cameras, lambda uv, _, __: uv + rng.normal(0, size, uv.shape))


def outliers(scene: Scene, size: float, rng: np.random.Generator) -> Scene:
    """A share of the corners anywhere within 50 px."""

    def spoilt(uv: Array, _: Camera, __: int) -> Array:
        wrong = rng.random(len(uv)) < size
        return uv + wrong[:, None] * rng.uniform(-50, 50, uv.shape)

    return mapped(scene, scene.cameras, spoilt)


def _restart(scene: Scene, rng: np.random.Generator) -> int:
    """Collection from which on something is another one: in the middle half of the recording."""
    n = len(scene.told.collections)
    return int(rng.integers(n // 4, 3 * n // 4 + 1))


def zoom(scene: Scene, size: float, rng: np.random.Generator) -> Scene:
    """A lens that is zoomed between two collections, by a share."""
    first = _restart(scene, rng)

    def zoomed(uv: Array, camera: Camera, i: int) -> Array:
        centre = (camera.cx, camera.cy)
        return (uv - centre) * (1 + size) + centre if i >= first else uv

    return _lasting(scene, [one_of(scene.cameras, rng)], zoomed)


def principal_drift(scene: Scene, size: float, rng: np.random.Generator) -> Scene:
    """A lens that sinks in its barrel, px from the first collection to the last."""
    angle, last = rng.uniform(0, 2 * np.pi), max(1, len(scene.told.collections) - 1)
    way = size * np.array([np.cos(angle), np.sin(angle)])
    return _lasting(scene, [one_of(scene.cameras, rng)], lambda uv, _, i: uv + way * (i / last))


def flipped_since(scene: Scene, way: float, rng: np.random.Generator) -> Scene:
    """A driver that flips images since its restart: 1 left is right, 2 top is bottom, 3 both."""
    first = _restart(scene, rng)
    later = mirrored_images(scene, way, rng).told.collections[first:]
    return replace(scene, told=replace(scene.told, collections=(*scene.told.collections[:first], *later)))


def moved_crop(scene: Scene, size: float, rng: np.random.Generator) -> Scene:
    """A region of interest that is another one since a restart, by px."""
    first, way = _restart(scene, rng), np.array([size, 0.6 * size])
    return mapped(scene, [one_of(scene.cameras, rng)], lambda uv, _, i: uv - way if i >= first else uv)


def autofocus(scene: Scene, size: float, rng: np.random.Generator) -> Scene:
    """A focal length that differs from image to image, by a share."""
    lengths = 1 + rng.normal(0, size, len(scene.told.collections))

    def breathing(uv: Array, camera: Camera, i: int) -> Array:
        centre = (camera.cx, camera.cy)
        return (uv - centre) * lengths[i] + centre

    return mapped(scene, [one_of(scene.cameras, rng)], breathing)


def stabilised_images(scene: Scene, size: float, rng: np.random.Generator) -> Scene:
    """Images that a stabiliser has shifted, each by other px."""
    shifts = rng.normal(0, size, (len(scene.told.collections), 2))
    return mapped(scene, [one_of(scene.cameras, rng)], lambda uv, _, i: uv + shifts[i])


def some_scaled(scene: Scene, size: float, rng: np.random.Generator) -> Scene:
    """Half of the images have another resolution."""
    scaled = rng.random(len(scene.told.collections)) < 0.5
    return mapped(scene, [one_of(scene.cameras, rng)], lambda uv, _, i: (uv + 0.5) * size - 0.5 if scaled[i] else uv)


def windscreen(scene: Scene, size: float, rng: np.random.Generator) -> Scene:
    """A screen before the camera whose waves shift the image, px."""
    u0, v0 = rng.uniform(0, 2 * np.pi, 2)

    def bent(uv: Array, camera: Camera, _: int) -> Array:
        u, v = uv.T
        waves = 3 * np.pi * v / camera.height + u0, 3 * np.pi * u / camera.width + v0
        return uv + size * np.sin(np.stack(waves, 1))

    return _lasting(scene, [one_of(scene.cameras, rng)], bent)


def quantised(scene: Scene, size: float, rng: np.random.Generator) -> Scene:
    """Corners that are told as multiples of so many px."""
    return mapped(scene, scene.cameras, lambda uv, _, __: np.round(uv / size) * size)


def correlated(scene: Scene, size: float, rng: np.random.Generator) -> Scene:
    """Corners that err together in each view, as in blurred images: px of shift, and as much of shear and scale."""

    def erring(uv: Array, _: Camera, __: int) -> Array:
        extent = (uv - uv.mean(0)) / max(1.0, float(uv.std(0).max()))
        return uv + rng.normal(0, size, 2) + extent @ rng.normal(0, size, (2, 2))

    return mapped(scene, scene.cameras, erring)


def binned(scene: Scene, way: float, rng: np.random.Generator) -> Scene:
    """1: the columns alone are binned, 2: camera_info alone is, 3: both, with the pixel's corner for its centre."""
    name = one_of(scene.cameras, rng)
    half = np.array([0.5, 0.5 if way == 3 else 1.0])
    camera = camera_of(scene, name)
    binned_camera = replace(
        camera, fx=camera.fx / 2, fy=camera.fy / 2, cx=camera.cx / 2, cy=camera.cy / 2,
        width=camera.width // 2, height=camera.height // 2,
    )  # fmt: skip
    if way != 2:
        scene = _lasting(scene, [name], lambda uv, _, __: (uv + 0.5) * half - 0.5)
    return scene if way == 1 else _told(scene, name, binned_camera)


def _rectified(camera: Camera, size: float) -> Camera:
    """What a rectification makes of a camera whose lens has k1 = -size."""
    wider = 1 + 0.4 * size
    return replace(camera, fx=camera.fx * wider, fy=camera.fy * wider, distortion=PlumbBob())


def rectified_images(scene: Scene, size: float, rng: np.random.Generator) -> Scene:
    """Images are rectified, camera_info is the raw lens with k1 = -size."""
    name = one_of(scene.cameras, rng)
    camera = camera_of(scene, name)
    scene = scene.seen_as_in(replace(scene, world=scene.world.with_cameras({name: _rectified(camera, size)})))
    return _told(scene, name, replace(camera, distortion=PlumbBob(k1=-size, k2=size / 5)))


def raw_images(scene: Scene, size: float, rng: np.random.Generator) -> Scene:
    """Images are raw, of a lens with k1 = -size, and camera_info is that of the rectified ones."""
    name = one_of(scene.cameras, rng)
    camera = camera_of(scene, name)
    raw = replace(camera, distortion=PlumbBob(k1=-size, k2=size / 5))
    scene = scene.seen_as_in(replace(scene, world=scene.world.with_cameras({name: raw})))
    return _told(scene, name, _rectified(camera, size))


def order_of_coefficients(scene: Scene, size: float, rng: np.random.Generator) -> Scene:
    """k3 of a lens with k1 = -size is written before p1 and p2."""
    name = one_of(scene.cameras, rng)
    camera = camera_of(scene, name)
    lens = PlumbBob(k1=-size, k2=size / 2, p1=size / 200, p2=-size / 200, k3=-size / 8)
    scene = scene.seen_as_in(replace(scene, world=scene.world.with_cameras({name: replace(camera, distortion=lens)})))
    return _told(scene, name, replace(camera, distortion=replace(lens, p1=lens.k3, p2=lens.p1, k3=lens.p2)))


def rolling_shutter(scene: Scene, size: float, rng: np.random.Generator) -> Scene:
    """The pattern moves on towards its next pose by so many metres while an image is read, row after row."""
    name = one_of(scene.cameras, rng)
    T = scene.pose(name)
    way = local(T, np.roll(T, -1, axis=0))
    way *= size / np.maximum(np.linalg.norm(way[:, :3], axis=1, keepdims=True), 1e-9)
    first, last = (replace(scene, seen={**scene.seen, name: retract(T, end * way)}) for end in (-0.5, 0.5))

    def read(i: int, sensor: str, labels: Labels) -> Labels | None:
        if sensor != name or not isinstance(labels, CornerLabels):
            return labels
        with np.errstate(all="ignore"):
            moves = last.expected(i, name, labels.ids) - first.expected(i, name, labels.ids)
        row = labels.pixels[:, 1:] / camera_of(scene, name).height - 0.5
        here = np.asarray(np.isfinite(moves).all(-1))
        return CornerLabels(labels.ids[here], (labels.pixels + row * moves)[here]) if here.sum() >= 4 else None

    return scene.labelled(read)
