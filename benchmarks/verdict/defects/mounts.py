"""Sensors and patterns that move when they should stay, lag behind, or are not where the description says."""

from dataclasses import replace

import numpy as np

from benchmarks.verdict.defects.cameras import one_of
from benchmarks.verdict.scene import Scene
from benchmarks.verdict.strata import moving_edges, swayed
from calibration.base.arrays import Array
from calibration.engine.dataset.model import Edge
from calibration.engine.geometry import rotations
from calibration.engine.geometry.transforms import inverse, local, retract, transform, translation


def _free(scene: Scene, rng: np.random.Generator) -> str:
    """A sensor that is calibrated."""
    return one_of([name for name in scene.told.sensors if name != scene.told.anchored], rng)


def _moved(scene: Scene, edge: Edge, twists: Array) -> Scene:
    world = scene.world.with_transforms({edge: retract(scene.world.transforms[edge], twists)})
    return scene.seen_as_in(replace(scene, world=world))


def _way(rng: np.random.Generator) -> Array:
    way = rng.normal(size=3)
    direction: Array = way / np.linalg.norm(way)
    return direction


def _after(scene: Scene, rng: np.random.Generator) -> Array:
    """(N, 1): 1 from a collection in the middle half on."""
    n = len(scene.told.collections)
    return (np.arange(n) >= int(rng.integers(n // 4, 3 * n // 4 + 1)))[:, None].astype(float)


def shifted(scene: Scene, size: float, rng: np.random.Generator) -> Scene:
    """A sensor that was pushed between two collections, m."""
    sensor = scene.told.sensors[_free(scene, rng)]
    return _moved(scene, sensor.edge, _after(scene, rng) * np.concatenate([size * _way(rng), np.zeros(3)]))


def turned(scene: Scene, size: float, rng: np.random.Generator) -> Scene:
    """A sensor that was turned between two collections, degrees."""
    sensor = scene.told.sensors[_free(scene, rng)]
    return _moved(scene, sensor.edge, _after(scene, rng) * np.concatenate([np.zeros(3), np.radians(size) * _way(rng)]))


def drifting(scene: Scene, size: float, rng: np.random.Generator) -> Scene:
    """A sensor that sinks steadily, m from the first collection to the last."""
    sensor, n = scene.told.sensors[_free(scene, rng)], len(scene.told.collections)
    share = np.linspace(-1, 0, n)[:, None]
    return _moved(scene, sensor.edge, share * np.concatenate([size * _way(rng), np.zeros(3)]))


def loose(scene: Scene, size: float, rng: np.random.Generator) -> Scene:
    """A sensor that shakes on its mount, m, in each collection anew."""
    sensor, n = scene.told.sensors[_free(scene, rng)], len(scene.told.collections)
    return _moved(scene, sensor.edge, np.c_[rng.normal(0, size, (n, 3)), np.zeros((n, 3))])


def pattern_moved(scene: Scene, size: float, rng: np.random.Generator) -> Scene:
    """A fixed pattern that was pushed between two collections, m."""
    edge = (scene.pattern.parent_link, scene.pattern.link)
    return _moved(scene, edge, _after(scene, rng) * np.concatenate([size * _way(rng), np.zeros(3)]))


def breathing(scene: Scene, size: float, rng: np.random.Generator) -> Scene:
    """A mount that moves to and fro with the temperature, m to either side, once in a recording."""
    sensor, n = scene.told.sensors[_free(scene, rng)], len(scene.told.collections)
    share = np.sin(2 * np.pi * np.arange(n) / n)[:, None]
    return _moved(scene, sensor.edge, share * np.concatenate([size * _way(rng), np.zeros(3)]))


def loosened(scene: Scene, size: float, rng: np.random.Generator) -> Scene:
    """A mount that is loosened, shakes for a quarter of the recording, m, and is set again as far from where it was."""
    sensor, n = scene.told.sensors[_free(scene, rng)], len(scene.told.collections)
    first = int(rng.integers(n // 4, n // 2 + 1))
    shifts = rng.normal(0, size, (n, 3))
    shifts[:first], shifts[first + n // 4 :] = 0.0, size * _way(rng)
    return _moved(scene, sensor.edge, np.c_[shifts, np.zeros((n, 3))])


def lag(scene: Scene, size: float, rng: np.random.Generator) -> Scene:
    """Delay a sensor's data: it saw the pattern a distance (m) back on the way from the last pose."""
    return _at_other_moments(scene, one_of(list(scene.told.sensors), rng), np.array(size))


def lidar_lag(scene: Scene, size: float, rng: np.random.Generator) -> Scene:
    """Delay the data of a LiDAR, likewise."""
    return _at_other_moments(scene, one_of(scene.lidars, rng), np.array(size))


def jittered_stamps(scene: Scene, size: float, rng: np.random.Generator) -> Scene:
    """A camera whose time stamps are off by other times, as if it saw the pattern so many metres before."""
    distances = np.abs(rng.normal(0, size, len(scene.told.collections) - 1))
    return _at_other_moments(scene, one_of(scene.cameras, rng), distances)


def _at_other_moments(scene: Scene, sensor: str, distances: Array) -> Scene:
    """A sensor that saw the pattern distances (N - 1,) back on the way from the last pose."""
    T = scene.pose(sensor)
    back = local(T[1:], T[:-1])
    length = np.maximum(np.linalg.norm(back[:, :3], axis=1), 1e-9)
    late = T.copy()
    late[1:] = retract(T[1:], back * np.minimum(1, distances / length)[:, None])
    return scene.seen_as_in(replace(scene, seen={sensor: late}))


def trembling(scene: Scene, size: float, rng: np.random.Generator) -> Scene:
    """A pattern in a trembling hand, m and 2.5 rad a metre: a fixed one in each collection, others for each sensor."""
    n = len(scene.told.collections)
    sigmas = size * np.repeat([1.0, 2.5], 3)
    common = rng.normal(0, sigmas, (n, 6))
    twists = {name: common if scene.pattern.fixed else rng.normal(0, sigmas, (n, 6)) for name in scene.told.sensors}
    seen = {name: retract(scene.pose(name), twist) for name, twist in twists.items()}
    return scene.seen_as_in(replace(scene, seen=seen))


def sway(scene: Scene, size: float, rng: np.random.Generator) -> Scene:
    """A pattern held by hand that moves between what two sensors see of it, m."""
    return scene.seen_as_in(
        replace(scene, seen={name: swayed(scene.pose(name), size, rng) for name in scene.told.sensors})
    )


def _described(scene: Scene, name: str, change: Array) -> Scene:
    edge = scene.told.sensors[name].edge
    return replace(scene, told=scene.told.with_transforms({edge: scene.told.transforms[edge] @ change}))


def described_elsewhere(scene: Scene, size: float, rng: np.random.Generator) -> Scene:
    """The description puts a sensor so many metres from where it is."""
    return _described(scene, _free(scene, rng), translation(size * _way(rng)))


def described_turned(scene: Scene, size: float, rng: np.random.Generator) -> Scene:
    """The description has a sensor turned by so many degrees."""
    turn = transform(rotations.exp(np.radians(size) * _way(rng)), np.zeros(3))
    return _described(scene, _free(scene, rng), turn)


def optical_frame(scene: Scene, size: float, rng: np.random.Generator) -> Scene:
    """The camera's optical frame: 1 the same as its link's, 2 turned the other way, 3 half a turn about z."""
    sensor = scene.told.sensors[one_of([c for c in scene.cameras if c != scene.told.anchored], rng)]
    edge = (sensor.calibration_child, sensor.frame)
    T = scene.told.transforms[edge]
    half = transform(rotations.exp([0, 0, np.pi]), np.zeros(3))
    wrong = {1: np.broadcast_to(np.eye(4), T.shape), 2: inverse(T), 3: T @ half}[int(size)]
    return replace(scene, told=scene.told.with_transforms({edge: wrong}))


def transforms_in_mm(scene: Scene, size: float, rng: np.random.Generator) -> Scene:
    """Millimetres for metres: 1 in the mount of a sensor, 2 in all fixed transforms, 3 in an arm's links, or in all."""
    told, arm = scene.told, moving_edges(scene)
    plain = [
        e
        for e in told.transforms
        if e not in told.moving_transforms and e not in {j.edge for j in told.joints.values()}
    ]
    edges = {1: [told.sensors[_free(scene, rng)].edge], 2: [e for e in plain if e not in arm], 3: arm or plain}[
        int(size)
    ]
    changed = {}
    for edge in edges:
        if edge in plain:
            changed[edge] = told.transforms[edge].copy()
            changed[edge][:, :3, 3] *= 1000
    return replace(scene, told=told.with_transforms(changed))


def moved_before(scene: Scene, size: float, rng: np.random.Generator) -> Scene:
    """A sensor was pushed (m) before the data were taken, after the calibration that is in use."""
    sensor, n = scene.told.sensors[_free(scene, rng)], len(scene.told.collections)
    return _moved(scene, sensor.edge, np.tile(np.concatenate([size * _way(rng), np.zeros(3)]), (n, 1)))


def anchor_elsewhere(scene: Scene, size: float, rng: np.random.Generator) -> Scene:
    """The anchored sensor is described so many metres from where it is: it is believed."""
    assert scene.told.anchored
    return _described(scene, scene.told.anchored, translation(size * _way(rng)))
