"""Motions that do not tell enough: too few collections, no rotations, patterns far away."""

from dataclasses import replace

import numpy as np

from benchmarks.verdict.scene import Scene
from calibration.engine.geometry import rotations


def kept(scene: Scene, order: list[int]) -> Scene:
    """The scene with some of its collections."""
    return replace(
        scene,
        told=scene.told.with_collections(order),
        world=scene.world.with_collections(order),
        seen={name: T[order] for name, T in scene.seen.items()},
    )


def few(scene: Scene, size: float, rng: np.random.Generator) -> Scene:
    """Keep a number of collections."""
    return kept(scene, sorted(rng.permutation(len(scene.told.collections))[: int(size)].tolist()))


def no_rotations(scene: Scene, size: float, rng: np.random.Generator) -> Scene:
    """A pattern that is always held alike but for so many degrees."""
    edge = (scene.pattern.parent_link, scene.pattern.link)
    T = scene.world.transforms[edge].copy()
    T[:, :3, :3] = T[0, :3, :3] @ rotations.exp(np.radians(size) * rng.normal(size=(len(T), 3)))
    return scene.seen_as_in(replace(scene, world=scene.world.with_transforms({edge: T})))


def far(scene: Scene, size: float, rng: np.random.Generator) -> Scene:
    """A pattern so many times as far away, with fewer points of a LiDAR on it."""
    edge = (scene.pattern.parent_link, scene.pattern.link)
    world = scene.world
    T_parent_sensor = world.transform(edge[0], world.sensors[scene.cameras[0]].frame)
    T = world.transforms[edge].copy()
    eye = T_parent_sensor[:, :3, 3]
    T[:, :3, 3] = eye + size * (T[:, :3, 3] - eye)
    return scene.seen_as_in(replace(scene, world=world.with_transforms({edge: T})))


def alike(scene: Scene, size: float, rng: np.random.Generator) -> Scene:
    """Keep a number of collections, those most alike."""
    edge_free = [scene.pose(name) for name in scene.told.sensors]
    first = edge_free[0]
    centre = int(rng.integers(len(first)))
    apart = np.linalg.norm(first[:, :3, 3] - first[centre, :3, 3], axis=1)
    turn = np.linalg.norm(rotations.log(np.swapaxes(first[centre, :3, :3][None], 1, 2) @ first[:, :3, :3]), axis=1)
    return kept(scene, sorted(np.argsort(apart + turn)[: int(size)].tolist()))
