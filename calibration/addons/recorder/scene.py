"""Robot, sensors, patterns and surroundings as objects in the 3D scene of a page.

Every object is placed in the world frame of the configuration, z up.
"""

import math
from collections.abc import Mapping, Sequence

import numpy as np
import viser

from calibration.addons.recorder.preview import SensorPreview
from calibration.base.arrays import Array
from calibration.engine.dataset.configuration import PatternConfiguration
from calibration.engine.geometry import rotations
from calibration.engine.geometry.cameras import Camera
from calibration.engine.geometry.transforms import apply
from calibration.robot.labelling.detection import Image
from calibration.robot.simulation.kinematics import Placement
from calibration.robot.simulation.rendering.texture import PAPER_REFLECTANCE, texture
from calibration.robot.simulation.system import System
from calibration.robot.urdf import compose

KEPT_COLOUR, LOST_COLOUR, UNKNOWN_COLOUR = (47, 158, 68), (224, 49, 49), (134, 142, 150)
"""Colours of a verdict: green, red, and grey while unknown."""
_ROBOT_COLOUR, _SENSOR_COLOUR, _LIDAR_COLOUR = (92, 102, 116), (28, 100, 210), (120, 70, 200)
_POINT_COLOUR, _LABELLED_COLOUR = (150, 158, 170), (255, 120, 0)
_MAX_TEXELS = 32  # side length of the square on the screen
_BOARD_THICKNESS = 0.004  # m: thickness of the board behind the print


class RobotScene:
    """Objects of a system in the scene, at one placement at a time."""

    def __init__(
        self, scene: viser.SceneApi, system: System, placement: Placement, T_world_handle: Array | None
    ) -> None:
        """Add all objects to a scene, at a placement (of one pose)."""
        self._system, self._scene = system, scene
        self._bones = [joint for joint in system.robot.joints if np.linalg.norm(joint.T_parent_joint[:3, 3]) > 1e-3]
        scene.set_up_direction("+z")
        scene.configure_environment_map(None)  # disabled because it is slow to draw
        scene.configure_default_lights(cast_shadow=False)
        scene.add_light_ambient("/light", intensity=1.6)
        self.size = extent(system, placement)
        """Radius of the objects, m."""
        self._add_surroundings()
        self._robot = scene.add_line_segments(
            "/robot/links", np.zeros((max(len(self._bones), 1), 2, 3)), _ROBOT_COLOUR, thickness=0.012 * self.size
        )
        self._frames = scene.add_batched_axes(
            "/robot/frames",
            np.tile([1.0, 0.0, 0.0, 0.0], (len(system.robot.tree.frames), 1)),
            np.zeros((len(system.robot.tree.frames), 3)),
            axes_length=0.06 * self.size,
            axes_radius=0.002 * self.size,
        )
        cameras = {name: camera for name, sensor in system.by_modality if (camera := sensor.intrinsics)}
        self._frusta = {name: self._add_frustum(name, camera) for name, camera in cameras.items()}
        self._lidars = {name: self._add_lidar(name) for name in system.sensors if name not in cameras}
        self._boards = {name: self._add_board(name) for name in system.patterns}
        self._saved: dict[int, viser.LineSegmentsHandle] = {}
        self.gizmo: viser.TransformControlsHandle | None = None
        """Handle that the user drags; None if nothing in the system moves."""
        if T_world_handle is not None:
            self.gizmo = scene.add_transform_controls(
                "/handle", scale=0.4 * self.size, line_width=4.0, depth_test=False, opacity=0.9
            )
        self.show(placement, T_world_handle)

    def show(self, placement: Placement, T_world_handle: Array | None) -> None:
        """Move all objects to a placement (of one pose)."""
        tree, world = self._system.robot.tree, self._system.configuration.world_link
        T_world_link = {frame: compose(tree, placement.transforms, world, frame)[0] for frame in tree.frames}
        ends = [(T_world_link[joint.parent][:3, 3], T_world_link[joint.child][:3, 3]) for joint in self._bones]
        if ends:
            self._robot.points = np.array(ends, np.float32)
        poses = np.array(list(T_world_link.values()))
        self._frames.batched_wxyzs = wxyz(poses).astype(np.float32)
        self._frames.batched_positions = poses[:, :3, 3].astype(np.float32)
        for sensor, things in (*self._frusta.items(), *self._lidars.items()):
            _place_node(things, placement.sensors[sensor][0])
        for pattern, board in self._boards.items():
            _place_node(board, placement.patterns[pattern][0])
        if self.gizmo is not None and T_world_handle is not None:
            _place_node(self.gizmo, T_world_handle)

    def show_views(self, views: Mapping[str, SensorPreview]) -> None:
        """Show the sensors' previews: pictures in the cameras' frustums, points around the LiDARs."""
        for sensor, frustum in self._frusta.items():
            view = views.get(sensor)
            frustum.image = None if view is None else view.picture
            frustum.color = UNKNOWN_COLOUR if view is None else KEPT_COLOUR if view.detected else LOST_COLOUR
        for sensor in self._lidars:
            view = views.get(sensor)
            if view is None or view.points is None or view.on_pattern is None:
                continue
            colours = np.where(view.on_pattern[:, None], _LABELLED_COLOUR, _POINT_COLOUR).astype(np.uint8)
            self._scene.add_point_cloud(
                f"{_node_name(sensor)}/points",
                view.points,
                colours,
                point_size=0.009 * self.size,
                point_shape="circle",
                precision="float32",
            )

    def show_saved(self, saved: Sequence[tuple[Array, tuple[int, int, int]]]) -> None:
        """Show the patterns at the saved poses: as outlines (4, 3) in the world frame, in a colour."""
        for index in [index for index in self._saved if index >= len(saved)]:
            self._saved.pop(index).remove()
        for index, (outline, colour) in enumerate(saved):
            segments = np.stack([outline, np.roll(outline, -1, axis=0)], 1)
            self._saved[index] = self._scene.add_line_segments(
                f"/saved/{index}", segments, colour, thickness=0.003 * self.size
            )

    def show_extras(self, frames: bool, saved: bool) -> None:
        """Show or hide the frames of the links and the outlines of the saved poses."""
        self._frames.visible = frames
        for outline in self._saved.values():
            outline.visible = saved

    def outlines(self, placement: Placement) -> Array:
        """Return the borders (P, 4, 3) of the patterns in the world frame at a placement (of one pose)."""
        borders = [
            apply(placement.patterns[name][0], np.column_stack([pattern.outline, np.zeros(4)]))
            for name, pattern in self._system.patterns.items()
        ]
        return np.array(borders)

    def _add_surroundings(self) -> None:
        scene = self._system.scene
        if scene.ground is not None:
            self._scene.add_grid(
                "/ground",
                plane="xy",
                infinite_grid=True,
                position=(0.0, 0.0, scene.ground),
                fade_distance=8 * self.size,
                plane_color=(238, 238, 234),
                plane_opacity=1.0,
            )
        for index, box in enumerate(scene.boxes):
            thing = self._scene.add_box(
                f"/boxes/{index}",
                color=np.array(box.colour) / 255,
                dimensions=box.size,
                opacity=0.4,  # a wall must not hide the objects behind it
                side="double",
                cast_shadow=False,
            )
            _place_node(thing, box.T_world_box)

    def _add_frustum(self, sensor: str, camera: Camera) -> viser.CameraFrustumHandle:
        return self._scene.add_camera_frustum(
            _node_name(sensor),
            fov=2 * math.atan(camera.height / 2 / camera.fy),
            aspect=camera.width / camera.height,
            scale=0.12 * self.size,
            thickness=0.004 * self.size,
            color=_SENSOR_COLOUR,
            cast_shadow=False,
            receive_shadow=False,
        )

    def _add_lidar(self, sensor: str) -> viser.CylinderHandle:
        return self._scene.add_cylinder(
            _node_name(sensor), radius=0.035 * self.size, height=0.05 * self.size, color=_LIDAR_COLOUR
        )

    def _add_board(self, name: str) -> viser.FrameHandle:
        """Add a frame with the print and the board behind it."""
        configuration, pattern = self._system.configuration.patterns[name], self._system.patterns[name]
        board = self._scene.add_frame(f"/patterns/{name}", show_axes=False)
        width, height = (float(length) for length in np.ptp(pattern.outline, axis=0))
        x, y = pattern.outline.mean(axis=0)
        self._scene.add_image(
            f"/patterns/{name}/print",
            print_of(configuration, name in self._system.legacy_layouts),
            render_width=width,
            render_height=height,
            position=(x, y, 0.0),
            format="png",
            cast_shadow=False,
            receive_shadow=False,
        )
        self._scene.add_box(
            f"/patterns/{name}/board",
            color=(225, 225, 220),
            dimensions=(width, height, _BOARD_THICKNESS),
            position=(x, y, 0.001 + _BOARD_THICKNESS / 2),
        )
        return board


def print_of(configuration: PatternConfiguration, legacy_layout: bool) -> Image:
    """Return the printed pattern with its border as a picture (H, W, 3)."""
    whole = texture(configuration, legacy_layout)
    level = min(max(int(math.log2(max(whole.texels / _MAX_TEXELS, 1))), 0), len(whole.levels) - 1)
    x, y = whole.margin
    unit = whole.texels / 2**level
    width, height = (round(length * unit) for length in whole.size)
    printed = whole.levels[level][y : y + height, x : x + width]
    right, down = (round(border / configuration.size * unit) for border in configuration.border_size)
    grey = np.pad(printed, ((down, down), (right, right)), constant_values=PAPER_REFLECTANCE)
    return np.repeat(grey[:, :, None], 3, axis=2)


def wxyz(T: Array) -> Array:
    """Return the quaternions (..., 4) of poses (..., 4, 4) in viser's order, w first."""
    return np.roll(rotations.to_quaternion(T[..., :3, :3]), 1, axis=-1)


def view_point(system: System, placement: Placement) -> tuple[Array, Array]:
    """Return the initial camera position and its target, (3,) each: from behind the sensors towards the patterns."""
    sensors = np.mean([T[0, :3, 3] for T in placement.sensors.values()], axis=0)
    patterns = np.mean([T[0, :3, 3] for T in placement.patterns.values()], axis=0)
    middle = 0.4 * sensors + 0.6 * patterns
    ahead = (patterns - sensors) * [1.0, 1.0, 0.0]
    ahead = ahead / max(float(np.linalg.norm(ahead)), 1e-9)
    aside = np.array([ahead[1], -ahead[0], 0.0])
    return middle + extent(system, placement) * (-1.9 * ahead + 1.5 * aside + np.array([0.0, 0.0, 1.1])), middle


def extent(system: System, placement: Placement) -> float:
    """Return the radius of sensors, patterns and moving links about their centre, m."""
    tree, world = system.robot.tree, system.configuration.world_link
    moving = [compose(tree, placement.transforms, world, joint.child) for joint in system.robot.movable.values()]
    points = np.array([T[0, :3, 3] for T in (*placement.sensors.values(), *placement.patterns.values(), *moving)])
    return max(float(np.linalg.norm(points - points.mean(axis=0), axis=-1).max()), 0.2)


def _node_name(sensor: str) -> str:
    return f"/sensors/{sensor}"


def _place_node(thing: viser.SceneNodeHandle, T_world_thing: Array) -> None:
    thing.wxyz, thing.position = wxyz(T_world_thing), T_world_thing[:3, 3]
