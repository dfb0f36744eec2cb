"""Systems of every structure that the engine calibrates, as scenes."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from calibration.base.arrays import Array
from calibration.engine.dataset.modalities import RGB
from calibration.engine.dataset.model import Joint, Sensor
from calibration.engine.geometry import rotations
from calibration.engine.geometry.cameras import Camera
from calibration.engine.geometry.frames import JointModel, JointParameter
from calibration.engine.geometry.transforms import inverse, retract, transform
from tests.engine.estimation.scenes import (
    AHEAD,
    PINHOLE,
    WIDE,
    Scene,
    board,
    camera,
    depth_camera,
    lidar,
    lidar2d,
    looks,
    pose,
)

STEREO = {("world", "left"): pose(0.1, 0.2, 0.3, -1.6, 0.1, -1.5), ("world", "right"): np.eye(4)}
STEREO["world", "right"] = STEREO["world", "left"] @ pose(0.3, 0.02, 0.05, 0.02, -0.2, 0.05)


def stereo(n: int = 12, seed: int = 0, **changes: object) -> Scene:
    """Two static cameras, a moving pattern, nothing anchored."""
    moving = STEREO["world", "left"] @ looks(n, seed)
    transforms = {**STEREO, ("world", "board_link"): moving}
    return replace(Scene(transforms, [camera("left"), camera("right", model=PINHOLE)], [board()]), **changes)


def ring(n: int = 20, seed: int = 0, cameras: int = 5, **changes: object) -> Scene:
    """Static cameras; collection i is seen by the cameras i and i + 1 only (modulo their number less one)."""
    transforms = {("world", f"c{k}"): pose(0.2 * k, 0.1, 0.0, 0.1 * k, -0.1 * k, 0.02) for k in range(cameras)}
    first = np.arange(n) % (cameras - 1)
    at = np.stack([transforms["world", f"c{k}"] for k in first])
    transforms["world", "board_link"] = at @ looks(n, seed)
    scene = Scene(transforms, [camera(f"c{k}") for k in range(cameras)], [board()], anchored="c0")
    return replace(scene, **{"sees": lambda sensor, _, i: int(sensor[1:]) - first[i] in (0, 1), **changes})


def eye_to_hand(n: int = 12, seed: int = 0, **changes: object) -> Scene:
    """A static camera looks at a pattern on the flange of an arm."""
    T_world_camera, T_flange_board = pose(1.0, 0.2, 0.9, -1.8, 0.1, 0.7), pose(0.02, -0.1, 0.15, 0.5, -0.3, 1.0)
    T_world_base = pose(0.1, 0.2, 0.5, 0.0, 0.0, 0.3)
    T_base_flange = inverse(T_world_base) @ T_world_camera @ looks(n, seed) @ inverse(T_flange_board)
    transforms = {
        ("world", "cam"): T_world_camera,
        ("world", "base"): T_world_base,
        ("base", "flange"): T_base_flange,
        ("flange", "board_link"): T_flange_board,
    }
    return replace(Scene(transforms, [camera("cam")], [board(parent="flange", fixed=True)]), **changes)


def eye_in_hand(n: int = 12, seed: int = 0, **changes: object) -> Scene:
    """A camera on the flange sees a fixed pattern; its mount is above its optical frame."""
    T_flange_mount, T_mount_cam = (
        pose(0.05, 0.02, 0.1, 0.1, 0.2, -0.4),
        pose(0.0, 0.01, 0.02, -np.pi / 2, 0, -np.pi / 2),
    )
    T_world_board = pose(0.8, -0.3, 0.4, 2.9, 0.2, 1.0)
    T_world_flange = T_world_board @ inverse(looks(n, seed)) @ inverse(T_flange_mount @ T_mount_cam)
    transforms = {
        ("world", "flange"): T_world_flange,
        ("flange", "mount"): T_flange_mount,
        ("mount", "cam"): T_mount_cam,
        ("world", "board_link"): T_world_board,
    }
    sensor = Sensor("cam", RGB, "cam", "flange", "mount", WIDE)
    return replace(Scene(transforms, [sensor], [board(fixed=True)]), **changes)


def two_bodies(n: int = 12, seed: int = 0, **changes: object) -> Scene:
    """Two cameras, each on a moving body, and a pattern that somebody moves freely."""
    rng = np.random.default_rng(2000 + seed)
    T_world_a = transform(rotations.exp(rng.normal(size=(n, 3))), rng.normal(size=(n, 3)))
    T_a, T_b = pose(0.1, 0.0, 0.2, 0.3, 0.1, -0.2), pose(-0.1, 0.05, 0.1, -0.2, 0.4, 0.8)
    board_seen = looks(n, seed)
    T_world_board = T_world_a @ T_a @ board_seen
    around = retract(np.broadcast_to(np.eye(4), (n, 4, 4)), rng.uniform(-0.4, 0.4, (n, 6)))
    T_world_b = T_world_board @ inverse(around @ looks(n, seed + 50)) @ inverse(T_b)
    transforms = {
        ("world", "body_a"): T_world_a,
        ("body_a", "a"): T_a,
        ("world", "body_b"): T_world_b,
        ("body_b", "b"): T_b,
        ("world", "board_link"): T_world_board,
    }
    return replace(Scene(transforms, [camera("a", "body_a"), camera("b", "body_b")], [board()]), **changes)


def camera_and_lidar(n: int = 12, seed: int = 0, behind: bool = False, **changes: object) -> Scene:
    """An anchored camera, a LiDAR beside it or (behind) on the other side of the pattern, a big moving pattern."""
    pattern = board(square=0.12)
    T_world_cam = pose(0.0, 0.0, 0.5, -np.pi / 2, 0.0, -np.pi / 2)
    T_cam_lidar = transform(AHEAD, (0.15, -0.1, 0.02)) @ pose(0, 0, 0, 0.02, 0.05, -0.1)
    if behind:
        T_cam_lidar = pose(0.1, -0.1, 3.6, 0.0, np.pi) @ T_cam_lidar
    T_cam_board = looks(n, seed, tilt=0.8, pattern=pattern)
    T_cam_board[:, 2, 3] += 0.6
    transforms = {
        ("world", "cam"): T_world_cam,
        ("world", "lidar"): T_world_cam @ T_cam_lidar,
        ("world", "board_link"): T_world_cam @ T_cam_board,
    }
    return replace(Scene(transforms, [camera("cam"), lidar("lidar")], [pattern], anchored="cam"), **changes)


def camera_and_lidar2d(n: int = 14, seed: int = 0, **changes: object) -> Scene:
    """An anchored camera, a 2D LiDAR below it with a small upward tilt, and a large moving pattern in its plane."""
    pattern = board(square=0.12)
    T_world_cam = pose(0.0, 0.0, 0.5, -np.pi / 2, 0.0, -np.pi / 2)
    T_cam_board = looks(n, seed, tilt=0.9, pattern=pattern)
    T_cam_board[:, 2, 3] += 0.6
    transforms = {
        ("world", "cam"): T_world_cam,
        ("world", "scan"): T_world_cam @ transform(AHEAD, (0.1, 0.25, 0.02)) @ pose(0, 0, 0, 0.1, -0.1, -0.1),
        ("world", "board_link"): T_world_cam @ T_cam_board,
    }
    return replace(Scene(transforms, [camera("cam"), lidar2d("scan")], [pattern], anchored="cam"), **changes)


def tripod(n: int = 14, seed: int = 0, **changes: object) -> Scene:
    """An anchored camera, a depth camera, a LiDAR and a 2D LiDAR: every modality."""
    base = camera_and_lidar2d(n, seed)
    T_world_cam = base.transforms["world", "cam"]
    transforms = {
        **base.transforms,
        ("world", "lidar"): T_world_cam @ transform(AHEAD, (0.15, -0.1, 0.02)) @ pose(0, 0, 0, 0.02, 0.05, -0.1),
        ("world", "depth"): T_world_cam @ pose(-0.1, 0.05, 0.0, 0.05, 0.1, -0.03),
    }
    return replace(
        base, transforms=transforms, sensors=[*base.sensors, lidar("lidar"), depth_camera("depth")], **changes
    )


def tripod_with_gaps(n: int = 40, seed: int = 0, **changes: object) -> Scene:
    """The tripod, of whose sensors each sees a random half."""
    seen = np.random.default_rng(6000 + seed).random((n, 4)) < 0.5
    names = ["cam", "scan", "lidar", "depth"]
    sees = {"sees": lambda sensor, _, i: bool(seen[i, names.index(sensor)])}
    return tripod(n, seed, **{**sees, **changes})


def linked_by_an_arm(n: int = 16, seed: int = 0, **changes: object) -> Scene:
    """Two static cameras of which neither sees what the other sees: an arm shows the pattern to one, then the other."""
    base = eye_to_hand(n, seed)
    T_world_second = pose(-0.8, 0.4, 1.0, -1.7, -0.1, -0.9)
    T_base_flange = base.transforms["base", "flange"].copy()
    second = np.arange(n) >= n // 2
    T_base_flange[second] = (
        inverse(base.transforms["world", "base"])
        @ T_world_second
        @ looks(n, seed)[second]
        @ inverse(base.transforms["flange", "board_link"])
    )
    transforms = {**base.transforms, ("base", "flange"): T_base_flange, ("world", "second"): T_world_second}
    scene = replace(base, transforms=transforms, sensors=[*base.sensors, camera("second")])
    return replace(scene, **{"sees": lambda sensor, _, i: (sensor == "second") == bool(second[i]), **changes})


def linked_by_a_lidar(n: int = 24, seed: int = 0, flat: bool = False, **changes: object) -> Scene:
    """Two static cameras that never see the pattern together; a LiDAR (or a 2D one) sees it with either of them."""
    base = camera_and_lidar2d(n, seed) if flat else camera_and_lidar(n, seed)
    between = base.sensors[1].name
    T_cam_second = pose(0.4, 0.1, 0.05, 0.05, -0.3, 0.1)
    transforms = {**base.transforms, ("world", "second"): base.transforms["world", "cam"] @ T_cam_second}
    scene = replace(base, transforms=transforms, sensors=[*base.sensors, camera("second")])
    sees = lambda sensor, _, i: sensor == between or (sensor == "second") == (i % 2 == 0)  # noqa: E731
    return replace(scene, **{"sees": sees, **changes})


def hand_and_world(n: int = 12, seed: int = 0, **changes: object) -> Scene:
    """An anchored static camera and one in the hand of an arm with an unknown base; one pattern is fixed."""
    base = eye_in_hand(n, seed)
    T_world_base = pose(0.3, 0.1, 0.2, 0.05, -0.1, 0.6)
    transforms = dict(base.transforms)
    T_world_flange = transforms.pop(("world", "flange"))
    T_world_board = transforms["world", "board_link"]
    static = T_world_board @ inverse(looks(1, seed + 7)[0])
    transforms |= {
        ("world", "base"): T_world_base,
        ("base", "flange"): inverse(T_world_base) @ T_world_flange,
        ("world", "static"): static,
    }
    sensors = [*base.sensors, camera("static")]
    scene = Scene(transforms, sensors, base.patterns, anchored="static", additional=(("world", "base"),))
    return replace(scene, **changes)


def two_patterns(n: int = 12, seed: int = 0, **changes: object) -> Scene:
    """A stereo rig that sees a moving pattern in even collections and a fixed one in the others."""
    scene = stereo(n, seed, anchored="left")
    still = board("still", fixed=True)
    transforms = {**scene.transforms, ("world", "still_link"): STEREO["world", "left"] @ looks(1, seed + 3)[0]}
    alternating = replace(scene, sees=lambda _, pattern, i: (i % 2 == 0) == (pattern == "board"))
    return replace(alternating, transforms=transforms, patterns=[*scene.patterns, still], **changes)


def two_arms(n: int = 14, seed: int = 0, **changes: object) -> Scene:
    """A camera in the hand of one arm, a pattern in that of another, whose base is to be found: three in a row."""
    rng = np.random.default_rng(3000 + seed)
    T_world_hand = transform(rotations.exp(0.7 * rng.normal(size=(n, 3))), 0.4 * rng.normal(size=(n, 3)))
    T_hand_cam, T_flange_board = pose(0.05, 0.02, 0.1, 0.1, 0.2, -0.4), pose(0.02, -0.1, 0.15, 0.5, -0.3, 1.0)
    T_world_base = pose(1.5, 0.3, 0.1, 0.0, 0.1, 2.8)
    T_base_flange = inverse(T_world_base) @ T_world_hand @ T_hand_cam @ looks(n, seed) @ inverse(T_flange_board)
    transforms = {
        ("world", "hand"): T_world_hand,
        ("hand", "cam"): T_hand_cam,
        ("world", "base"): T_world_base,
        ("base", "flange"): T_base_flange,
        ("flange", "board_link"): T_flange_board,
    }
    pattern = board(parent="flange", fixed=True)
    return replace(Scene(transforms, [camera("cam", "hand")], [pattern], additional=(("world", "base"),)), **changes)


def mobile_base(n: int = 12, seed: int = 0, **changes: object) -> Scene:
    """Two cameras and a LiDAR on a base whose odometry is to be found in each collection; a pattern in the world."""
    rig = camera_and_lidar(n, seed)
    T_base = {s: rig.transforms["world", s] for s in ("cam", "lidar")}
    T_base["second"] = T_base["cam"] @ pose(0.25, 0.0, 0.05, 0.02, -0.1, 0.05)
    T_world_board = pose(1.5, 0.4, 0.9, 0.2, 1.4, 0.3)
    transforms = {("base", s): T for s, T in T_base.items()}
    transforms["world", "board_link"] = T_world_board
    transforms["world", "base"] = T_world_board @ inverse(rig.transforms["world", "board_link"])
    sensors = [camera("cam", "base"), camera("second", "base", PINHOLE), lidar("lidar", "base")]
    pattern = replace(rig.patterns[0], fixed=True)
    edge = ("world", "base")
    scene = Scene(transforms, sensors, [pattern], additional=(edge,), moving=frozenset([edge]))
    return replace(scene, **changes)


def arm_with_patterns(n: int = 14, seed: int = 0, **changes: object) -> Scene:
    """A static camera in front of an arm with patterns on its forearm and its flange, and a fixed pattern."""
    rng = np.random.default_rng(4000 + seed)
    base = eye_to_hand(n, seed)
    T_world_camera, T_base_flange = base.transforms["world", "cam"], base.transforms["base", "flange"]
    T_flange_board = base.transforms["flange", "board_link"]
    T_forearm_second = pose(0.1, 0.0, 0.05, 0.2, 0.1, -0.7)
    seen = T_world_camera @ looks(n, seed + 20) @ inverse(T_forearm_second)
    transforms = {
        **{edge: T for edge, T in base.transforms.items() if edge[0] != "base"},
        ("base", "forearm"): inverse(base.transforms["world", "base"]) @ seen,
    }
    transforms["forearm", "flange"] = inverse(transforms["base", "forearm"]) @ T_base_flange
    transforms["flange", "board_link"] = T_flange_board
    transforms["forearm", "second_link"] = T_forearm_second
    transforms["world", "still_link"] = T_world_camera @ looks(1, seed + 30)[0]
    transforms["world", "loose_link"] = T_world_camera @ looks(n, seed + 40)
    shown = rng.random((n, 4)) < 0.7
    names = ["board", "second", "still", "loose"]
    patterns = [*base.patterns, board("second", "forearm", fixed=True), board("still", fixed=True), board("loose")]
    scene = replace(base, transforms=transforms, patterns=patterns)
    return replace(scene, **{"sees": lambda _, pattern, i: bool(shown[i, names.index(pattern)]), **changes})


ARM: dict[str, tuple[bool, tuple[float, float, float], tuple[float, ...]]] = {
    "j1": (False, (0.0, 0.0, 1.0), (0.0, 0.0, 0.18, 0.0, 0.0, 0.1)),
    "j2": (False, (0.0, 0.6, 0.8), (0.0, 0.1, 0.1, np.pi / 2, 0.0, 0.0)),
    "j3": (False, (0.0, 0.0, 1.0), (-0.4, 0.0, 0.0, 0.0, 0.1, 0.0)),
    "slide": (True, (0.0, 0.0, 1.0), (-0.1, 0.0, 0.1, 0.0, 0.4, -0.2)),
    "j4": (False, (1.0, 0.0, 0.0), (-0.2, 0.0, 0.1, 0.2, 0.0, 0.3)),
    "j5": (False, (0.0, 0.0, 1.0), (0.0, -0.1, 0.0, np.pi / 2, 0.0, 0.0)),
    "j6": (False, (0.0, 1.0, 0.0), (0.0, 0.1, 0.05, 0.3, 0.2, 0.0)),
}
"""Joints in a row: prismatic or not, the axis, the origin."""


def jointed_arm(
    n: int = 20, seed: int = 0, free: dict[str, tuple[JointParameter, ...]] | None = None, **changes: object
) -> Scene:
    """A camera in the hand of an arm of seven joints, some parameters of which are free, and a pattern that stands
    still. The joints move by up to half a radian or 0.15 m."""
    rng = np.random.default_rng(5000 + seed)
    free = {"j3": ("origin_yaw",)} if free is None else free
    transforms: dict[tuple[str, str], Array] = {}
    joints, T, parent = [], pose(0.3, 0.2, 0.5), "world"
    transforms["world", "base"] = T
    parent = "base"
    for name, (prismatic, axis, origin) in ARM.items():
        positions = rng.uniform(-1, 1, n) * (0.15 if prismatic else 0.5)
        joint = Joint(
            name, (parent, name), JointModel(prismatic, axis), free.get(name, ()), np.array([*origin, 0.0]), positions
        )
        T, parent = T @ joint.transform, name
        if name in free:
            joints.append(joint)
        else:
            transforms[joint.edge] = joint.transform
    T_hand_cam = pose(0.05, 0.02, 0.1, 0.1, 0.2, -0.4)
    transforms["j6", "cam"] = T_hand_cam
    still = T @ T_hand_cam
    middle = transform(rotations.nearest(still[:, :3, :3].mean(0)), still[:, :3, 3].mean(0))
    transforms["world", "board_link"] = middle @ pose(0.0, 0.0, 2.5, 0.3, -0.2, 0.1)
    scene = Scene(transforms, [camera("cam", "j6")], [board(fixed=True, square=0.12)], joints=tuple(joints))
    return replace(scene, **changes)


ALL: dict[str, Callable[..., Scene]] = {
    "stereo": stereo,
    "anchored stereo": lambda *a, **k: stereo(*a, **{"anchored": "right", **k}),
    "ring": ring,
    "eye to hand": eye_to_hand,
    "eye in hand": eye_in_hand,
    "two bodies": two_bodies,
    "camera and lidar": camera_and_lidar,
    "lidar behind": lambda *a, **k: camera_and_lidar(*a, behind=True, **k),
    "camera and 2D lidar": camera_and_lidar2d,
    "tripod": tripod,
    "linked by an arm": linked_by_an_arm,
    "linked by a lidar": linked_by_a_lidar,
    "linked by a 2D lidar": lambda *a, **k: linked_by_a_lidar(*a, **{"flat": True, **k}),
    "hand and world": hand_and_world,
    "two patterns": two_patterns,
    "arm with patterns": arm_with_patterns,
}


def rotating(scene: Scene, rotations_: Array, seed: int = 0) -> Scene:
    """A scene whose arm makes these rotations (n, 3), in the frame of its flange, with translations of up to 0.1 m."""
    edge = next(edge for edge, T in scene.transforms.items() if edge[1] == "flange")
    shifts = np.random.default_rng(seed).uniform(-0.1, 0.1, (len(rotations_), 3))
    motion = scene.transforms[edge][0] @ transform(rotations.exp(rotations_), shifts)
    return replace(scene, transforms={**scene.transforms, edge: motion})


def covering(n: int = 30, seed: int = 0, cameras: int = 2, model: Camera = WIDE, **changes: object) -> Scene:
    """Static cameras side by side, and a moving pattern before the middle one that comes to every place of its image.

    Nothing is anchored; good views for intrinsics: near, tilted by up to half a radian.
    """
    rng = np.random.default_rng(6000 + seed)
    pixels = rng.uniform((0.08, 0.08), (0.92, 0.92), (n, 2)) * (model.width, model.height)
    rays = np.concatenate([model.normalise(pixels), np.ones((n, 1))], -1)
    centre = rays / np.linalg.norm(rays, axis=-1, keepdims=True) * rng.uniform(0.5, 1.0, (n, 1))
    R = rotations.exp(rng.uniform(-0.5, 0.5, (n, 3)))
    pattern = board()
    T = transform(R, centre - R @ pattern.centre)
    transforms = {
        ("world", f"c{k}"): pose(0.04 * k, 0.01 * k, 0.02 * k, 0.02 * k, -0.03 * k, 0.02) for k in range(cameras)
    }
    transforms["world", "board_link"] = transforms["world", "c0"] @ T
    scene = Scene(transforms, [camera(f"c{k}", model=model) for k in range(cameras)], [pattern])
    return replace(scene, **changes)
