"""Labels that are not of what they are said to be: of another sensor, another moment, another corner."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from benchmarks.verdict.defects.cameras import one_of
from benchmarks.verdict.scene import Scene
from calibration.base.arrays import Array, IntArray
from calibration.engine.dataset.model import Collection, CornerLabels, Labels


def _with(scene: Scene, collections: list[Collection]) -> Scene:
    return replace(scene, told=replace(scene.told, collections=tuple(collections)))


def _some(scene: Scene, share: float, rng: np.random.Generator) -> set[int]:
    """Random collections, at least one."""
    n = len(scene.told.collections)
    return set(rng.permutation(n)[: max(1, round(share * n))].tolist())


def exchanged(scene: Scene, size: float, rng: np.random.Generator) -> Scene:
    """The labels of two cameras exchanged in a share of the collections."""
    first, second, *_ = rng.permutation(scene.cameras).tolist()
    other = {first: second, second: first}
    wrong = _some(scene, size, rng)
    return _with(
        scene,
        [
            replace(c, labels={(p, other.get(s, s)): label for (p, s), label in c.labels.items()}) if i in wrong else c
            for i, c in enumerate(scene.told.collections)
        ],
    )


def exchanged_names(scene: Scene, size: float, rng: np.random.Generator) -> Scene:
    """Left is called right: 1 labels and camera_info, 2 the labels alone."""
    first, second, *_ = rng.permutation(scene.cameras).tolist()
    scene = exchanged(scene, 1.0, rng)
    if size == 2:
        return scene
    sensors = scene.told.sensors
    cameras = {first: sensors[second].camera, second: sensors[first].camera}
    return replace(scene, told=scene.told.with_cameras({k: c for k, c in cameras.items() if c}))


def of_another_collection(scene: Scene, size: float, rng: np.random.Generator) -> Scene:
    """A share of the views of one sensor are of another moment."""
    sensor = one_of(list(scene.told.sensors), rng)
    collections = list(scene.told.collections)
    n = len(collections)

    def of(collection: Collection) -> dict[tuple[str, str], Labels]:
        return {key: label for key, label in collection.labels.items() if key[1] == sensor}

    for i in _some(scene, size, rng):
        source = scene.told.collections[(i + int(rng.integers(1, n))) % n]
        rest = {key: label for key, label in scene.told.collections[i].labels.items() if key[1] != sensor}
        collections[i] = replace(collections[i], labels={**rest, **of(source)})
    return _with(scene, collections)


def copied(scene: Scene, size: float, rng: np.random.Generator) -> Scene:
    """Copy one collection a number of times."""
    return _copied(scene, int(size), rng, 0.0)


def nearly_copied(scene: Scene, size: float, rng: np.random.Generator) -> Scene:
    """The same pose so many times more, each with the noise of its own image."""
    return _copied(scene, int(size), rng, 0.03)


def _copied(scene: Scene, times: int, rng: np.random.Generator, noise: float) -> Scene:
    n = len(scene.told.collections)
    which = int(rng.integers(n))
    order = [*range(n), *[which] * times]

    def cut(dataset_of: Scene) -> Scene:
        told, world = (d.with_collections(order) for d in (dataset_of.told, dataset_of.world))
        keys = [f"{i:03d}" for i in range(len(order))]
        told = replace(told, collections=tuple(replace(c, key=k) for c, k in zip(told.collections, keys, strict=True)))
        return replace(dataset_of, told=told, world=world, seen={})

    def noisy(i: int, _: str, labels: Labels) -> Labels:
        if i < n or not noise or not isinstance(labels, CornerLabels):
            return labels
        return replace(labels, pixels=labels.pixels + rng.normal(0, noise, labels.pixels.shape))

    return cut(scene).labelled(noisy)


IdChange = Callable[[IntArray, int], IntArray]
"""From ids and the number of the pattern's corners to other ids."""


def _ids(scene: Scene, size: float, rng: np.random.Generator, new: IdChange) -> Scene:
    sensor, wrong = one_of(scene.cameras, rng), _some(scene, size, rng)
    count = len(scene.pattern.corners)

    def renamed(i: int, name: str, labels: Labels) -> Labels | None:
        if name != sensor or i not in wrong or not isinstance(labels, CornerLabels):
            return labels
        ids = new(labels.ids, count)
        here = (ids >= 0) & (ids < count)
        return CornerLabels(ids[here], labels.pixels[here]) if here.sum() >= 4 else None

    return scene.labelled(renamed)


def reversed_ids(scene: Scene, size: float, rng: np.random.Generator) -> Scene:
    """The pattern's corners counted from the other end, in a share of a camera's views."""
    return _ids(scene, size, rng, lambda ids, count: count - 1 - ids)


def ids_off_by_one(scene: Scene, size: float, rng: np.random.Generator) -> Scene:
    """Corners counted from the next one, in a share of a camera's views."""
    return _ids(scene, size, rng, lambda ids, _: ids + 1)


def shuffled_ids(scene: Scene, size: float, rng: np.random.Generator) -> Scene:
    """Ids that have nothing to do with the corners, in a share of a camera's views."""
    return _ids(scene, size, rng, lambda ids, _: rng.permutation(ids))


def shifted_labels(scene: Scene, size: float, rng: np.random.Generator) -> Scene:
    """A fifth of a camera's views is shifted by so many pixels."""
    sensor, wrong = one_of(scene.cameras, rng), _some(scene, 0.2, rng)
    angle = rng.uniform(0, 2 * np.pi)
    by = size * np.array([np.cos(angle), np.sin(angle)])

    def moved(i: int, name: str, labels: Labels) -> Labels:
        if name != sensor or i not in wrong or not isinstance(labels, CornerLabels):
            return labels
        return replace(labels, pixels=labels.pixels + by)

    return scene.labelled(moved)


def in_a_corner(scene: Scene, size: float, rng: np.random.Generator) -> Scene:
    """Keep only labels in a corner of the images, a share of their width and height."""
    place = rng.uniform(0, 1 - size, 2)

    def kept(_: int, sensor: str, labels: Labels) -> Labels | None:
        camera = scene.told.sensors[sensor].camera
        if camera is None or not isinstance(labels, CornerLabels):
            return labels
        where: Array = labels.pixels / (camera.width, camera.height)
        here = ((where >= place) & (where <= place + size)).all(1)
        return CornerLabels(labels.ids[here], labels.pixels[here]) if here.sum() >= 4 else None

    return scene.labelled(kept)


def few_views(scene: Scene, size: float, rng: np.random.Generator) -> Scene:
    """Keep only a number of views of one sensor."""
    sensor = one_of([name for name in scene.told.sensors if name != scene.told.anchored], rng)
    has = [i for i, c in enumerate(scene.told.collections) if any(s == sensor for _, s in c.labels)]
    kept = set(rng.permutation(has)[: int(size)].tolist())
    return scene.labelled(lambda i, name, labels: labels if name != sensor or i in kept else None)
