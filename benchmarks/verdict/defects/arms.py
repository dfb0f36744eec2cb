"""Arms that are not where their description and their encoders say: the world is changed, not what the user has."""

from collections.abc import Callable, Collection, Mapping
from dataclasses import replace
from itertools import pairwise

import numpy as np

from benchmarks.verdict.scene import Scene
from benchmarks.verdict.strata import at_zero, moving_edges
from calibration.base.arrays import Array, IntArray
from calibration.engine.dataset.model import Edge
from calibration.engine.geometry import rotations
from calibration.engine.geometry.transforms import inverse, retract, transform, translation

Plant = Callable[[Scene, float, np.random.Generator], Scene]


def _moved(scene: Scene, edge: Edge, T: Array) -> Scene:
    return _all_moved(scene, {edge: T})


def _all_moved(scene: Scene, transforms: Mapping[Edge, Array]) -> Scene:
    return scene.seen_as_in(replace(scene, world=scene.world.with_transforms(transforms)))


def _link(scene: Scene, rng: np.random.Generator) -> Edge:
    """Choose a moving link; not the first or last, whose errors the mounts of arm and sensor compensate."""
    edges = moving_edges(scene)
    inner = edges[1:-1]
    return inner[int(rng.integers(len(inner)))]


def origin_shift(axis: int) -> Plant:
    """The origin of a joint lies elsewhere, m along an axis of its parent."""

    def plant(scene: Scene, size: float, rng: np.random.Generator) -> Scene:
        edge = _link(scene, rng)
        return _moved(scene, edge, translation(size * np.eye(3)[axis]) @ scene.world.transforms[edge])

    return plant


def origin_turn(axis: int) -> Plant:
    """The origin of a joint is turned, degrees about an axis of its parent."""

    def plant(scene: Scene, size: float, rng: np.random.Generator) -> Scene:
        edge = _link(scene, rng)
        T = scene.world.transforms[edge].copy()
        T[:, :3, :3] = rotations.exp(np.radians(size) * np.eye(3)[axis]) @ T[:, :3, :3]
        return _moved(scene, edge, T)

    return plant


def _axis(T: Array) -> tuple[Array, Array, bool]:
    """Axis of a joint with poses (N, 4, 4), in its child frame; its positions (N,), and whether it slides."""
    relative = inverse(T[:1]) @ T
    turns = rotations.log(relative[:, :3, :3])
    slides = bool(np.abs(turns).max() < 1e-6)
    steps = relative[:, :3, 3] if slides else turns
    axis = np.linalg.svd(steps)[2][0]
    return axis, steps @ axis, slides


def _motion(axis: Array, by: Array, slides: bool) -> Array:
    steps = np.asarray(by)[..., None] * axis
    T: Array = translation(steps) if slides else transform(rotations.exp(steps), np.zeros(3))
    return T


def _turning(scene: Scene, rng: np.random.Generator) -> tuple[Edge, Array, Array]:
    """Choose a revolute joint, inner ones first: its edge, its axis, its positions."""
    edges = moving_edges(scene)
    turning = [e for e in edges[1:-1] if not _axis(scene.world.transforms[e])[2]]
    edge = turning[int(rng.integers(len(turning)))]
    axis, positions, _ = _axis(scene.world.transforms[edge])
    return edge, axis, positions


def encoder_offset(scene: Scene, size: float, rng: np.random.Generator) -> Scene:
    """The zero of an encoder, degrees."""
    edge, axis, _ = _turning(scene, rng)
    return _moved(scene, edge, scene.world.transforms[edge] @ _motion(axis, np.radians(size), False))


def encoder_gain(scene: Scene, size: float, rng: np.random.Generator) -> Scene:
    """An encoder that counts too much by a share."""
    edge, axis, positions = _turning(scene, rng)
    return _moved(scene, edge, scene.world.transforms[edge] @ _motion(axis, size * positions, False))


def backlash(scene: Scene, size: float, rng: np.random.Generator) -> Scene:
    """A gear with play, degrees: the joint stays behind on the side that it comes from."""
    edge, axis, positions = _turning(scene, rng)
    side = np.sign(np.diff(positions, prepend=positions[-1]))
    return _moved(scene, edge, scene.world.transforms[edge] @ _motion(axis, np.radians(size) / 2 * side, False))


def wrong_axis(scene: Scene, size: float, rng: np.random.Generator) -> Scene:
    """An axis that leans by degrees."""
    edge, axis, positions = _turning(scene, rng)
    across = np.cross(axis, rng.normal(size=3))
    leaning = rotations.exp(np.radians(size) * across / np.linalg.norm(across)) @ axis
    T = scene.world.transforms[edge]
    return _moved(scene, edge, T @ _motion(axis, -positions, False) @ _motion(leaning, positions, False))


def in_degrees(scene: Scene, size: float, rng: np.random.Generator) -> Scene:
    """Positions told in degrees where radians are read: 1 of one joint, 2 of all, 3 of one, in half of the collections.

    What the user has is changed.
    """
    edges = [e for e in moving_edges(scene) if not _axis(scene.world.transforms[e])[2]]
    chosen = edges if size == 2 else [edges[1 + int(rng.integers(len(edges) - 2))]]
    told = scene.told
    joints = {joint.edge: name for name, joint in told.joints.items()}
    half = rng.random(len(told.collections)) < (0.5 if size == 3 else 1.1)
    for edge in chosen:
        axis, positions, _ = _axis(told.transforms[edge])
        if edge in joints:
            joint = told.joints[joints[edge]]
            factor = np.where(half, 180 / np.pi, 1.0)
            told = replace(told, joints={**told.joints, joint.name: replace(joint, positions=joint.positions * factor)})
            told = told.with_joints({joint.name: joint.values})
        else:
            more = np.where(half, (180 / np.pi - 1) * positions, 0.0)
            told = told.with_transforms({edge: told.transforms[edge] @ _motion(axis, more, False)})
    return replace(scene, told=told)


def unsteady(scene: Scene, size: float, rng: np.random.Generator) -> Scene:
    """An arm that does not repeat, m and as many half radians."""
    edge, n = moving_edges(scene)[-1], len(scene.told.collections)
    twists = np.concatenate([rng.normal(0, size, (n, 3)), rng.normal(0, size / 2, (n, 3))], axis=1)
    return _moved(scene, edge, retract(scene.world.transforms[edge], twists))


def base_moved(scene: Scene, size: float, rng: np.random.Generator) -> Scene:
    """The arm was pushed on its table, m, between two collections."""
    edge, n = moving_edges(scene)[0], len(scene.told.collections)
    way = rng.normal(size=3)
    shift = np.zeros((n, 3))
    shift[int(rng.integers(n // 4, 3 * n // 4 + 1)) :] = size * way / np.linalg.norm(way)
    return _moved(scene, edge, translation(shift) @ scene.world.transforms[edge])


def poses_of_others(scene: Scene, size: float, rng: np.random.Generator) -> Scene:
    """A share of the collections has the arm's pose of another one: what the user has is changed."""
    n = len(scene.told.collections)
    source = np.arange(n)
    wrong = rng.permutation(n)[: max(1, round(size * n))]
    source[wrong] = (wrong + rng.integers(1, n, len(wrong))) % n
    return _told_as_in(scene, moving_edges(scene), source)


def _told_as_in(scene: Scene, edges: Collection[Edge], source: IntArray) -> Scene:
    """The scene whose user has the states of some joints from other collections (N,)."""
    told = scene.told
    joints = {name: joint for name, joint in told.joints.items() if joint.edge in edges}
    plain = {e: told.transforms[e][source] for e in edges if e not in {j.edge for j in joints.values()}}
    changed = {name: replace(j, positions=j.positions[source]) for name, j in joints.items()}
    told = replace(told, joints={**told.joints, **changed}).with_transforms(plain)
    return replace(scene, told=told.with_joints({name: j.values for name, j in changed.items()}))


def stale_states(scene: Scene, way: float, rng: np.random.Generator) -> Scene:
    """States of the collection before: 1 of all joints, 2 of one, 3 of all, in half of the collections."""
    n, edges = len(scene.told.collections), moving_edges(scene)
    late = rng.random(n) < (0.5 if way == 3 else 1.1)
    source = np.maximum(0, np.arange(n) - late)
    return _told_as_in(scene, [_link(scene, rng)] if way == 2 else edges, source)


def stuck_joint(scene: Scene, share: float, rng: np.random.Generator) -> Scene:
    """A joint whose state is not read anew for a share of the recording."""
    source = np.arange(len(scene.told.collections))
    length = max(2, round(share * len(source)))
    first = int(rng.integers(0, len(source) - length + 1))
    source[first : first + length] = first
    return _told_as_in(scene, [_link(scene, rng)], source)


def flipped_axis(scene: Scene, way: float, rng: np.random.Generator) -> Scene:
    """A joint that is described to move the other way: 1 and 2 one of them, 3 all."""
    told, zero = scene.told, at_zero(scene.system.name)
    joints = {joint.edge: name for name, joint in told.joints.items()}
    for edge in moving_edges(scene) if way == 3 else [_link(scene, rng)]:
        if edge in joints:
            joint = told.joints[joints[edge]]
            told = replace(told, joints={**told.joints, joint.name: replace(joint, positions=-joint.positions)})
            told = told.with_joints({joint.name: joint.values})
        else:
            told = told.with_transforms({edge: zero[edge] @ inverse(told.transforms[edge]) @ zero[edge]})
    return replace(scene, told=told)


def gravity_sag(scene: Scene, size: float, rng: np.random.Generator) -> Scene:
    """An arm that hangs lower the farther it reaches, m where it reaches farthest."""
    world = scene.world
    edge = max(moving_edges(scene), key=lambda each: len(world.tree.path(world.world, each[1])))
    T_world_parent = world.transform(world.world, edge[0])
    place = world.transform(world.world, edge[1])[:, :3, 3]
    first = min(moving_edges(scene), key=lambda each: len(world.tree.path(world.world, each[1])))
    reach = np.linalg.norm((place - world.transform(world.world, first[0])[:, :3, 3])[:, :2], axis=1)
    down = -size * (reach / reach.max()) ** 2
    lower = translation(down[:, None] * np.array([0.0, 0.0, 1.0]))
    return _moved(scene, edge, inverse(T_world_parent) @ lower @ T_world_parent @ world.transforms[edge])


def eccentric_gear(scene: Scene, size: float, rng: np.random.Generator) -> Scene:
    """A gear whose error comes again with each turn, degrees."""
    edge, axis, positions = _turning(scene, rng)
    error = np.radians(size) * np.sin(positions + rng.uniform(0, 2 * np.pi))
    return _moved(scene, edge, scene.world.transforms[edge] @ _motion(axis, error, False))


def slipping_belt(scene: Scene, size: float, rng: np.random.Generator) -> Scene:
    """A belt that slips steadily, degrees from the first collection to the last."""
    edge, axis, positions = _turning(scene, rng)
    slip = np.radians(size) * np.linspace(0, 1, len(positions))
    return _moved(scene, edge, scene.world.transforms[edge] @ _motion(axis, slip, False))


def lost_zero(scene: Scene, size: float, rng: np.random.Generator) -> Scene:
    """An encoder with another zero after a power cycle, degrees."""
    edge, axis, positions = _turning(scene, rng)
    n = len(positions)
    offset = np.where(np.arange(n) >= rng.integers(n // 4, 3 * n // 4 + 1), np.radians(size), 0.0)
    return _moved(scene, edge, scene.world.transforms[edge] @ _motion(axis, offset, False))


def coarse_encoder(scene: Scene, size: float, rng: np.random.Generator) -> Scene:
    """An encoder that tells only multiples of so many degrees."""
    edge, axis, positions = _turning(scene, rng)
    step = np.radians(size)
    return _moved(scene, edge, scene.world.transforms[edge] @ _motion(axis, -np.mod(positions, step), False))


def cancelling_joints(scene: Scene, size: float, rng: np.random.Generator) -> Scene:
    """Two joints one after the other, as parallel as there are, off by degrees that nearly cancel."""
    world = scene.world
    turning = []
    for edge in sorted(moving_edges(scene), key=lambda each: len(world.tree.path(world.world, each[1]))):
        axis, _, slides = _axis(world.transforms[edge])
        if not slides:
            turning.append((edge, axis, world.transform(world.world, edge[1])[0, :3, :3] @ axis))
    first, second = max(pairwise(turning), key=lambda pair: abs(pair[0][2] @ pair[1][2]))
    back = -np.sign(first[2] @ second[2])
    changed = {}
    for (edge, axis, _), by in ((first, size), (second, back * size)):
        changed[edge] = world.transforms[edge] @ _motion(axis, np.radians(by), False)
    return _all_moved(scene, changed)
