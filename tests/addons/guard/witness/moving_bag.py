"""A bag of two cameras on an arm over a table, and the baseline in which they are accepted."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from benchmarks.guard.moving_clips import T_LINK_CAMERA, HandMotion, Table, taken
from calibration.base.arrays import Array
from calibration.engine.baseline.calibration_document import CalibratedPose, CalibrationDocument
from calibration.engine.geometry.cameras import Camera
from calibration.engine.geometry.rotations import to_rpy
from calibration.engine.geometry.transforms import from_xyz_rpy, inverse, retract, translation
from tests.robot.importing.bags import BEGIN, SECOND, BagFile

FOCAL = 300.0
CAMERA = Camera(FOCAL, FOCAL, 160.5, 120.5, 320, 240)
T_BESIDE = translation(np.array([0.1, 0.0, 0.0])) @ from_xyz_rpy(np.zeros(3), np.array([0.0, -0.15, 0.0]))
"""Of the second camera in the frame of the first."""
OPTICAL = from_xyz_rpy(np.array([0.0, 0.01, 0.0]), np.array([-np.pi / 2, 0.0, -np.pi / 2]))
"""Of the first camera's data in the frame that is calibrated."""


@dataclass(frozen=True)
class ArmBag:
    """What is in the bag."""

    images: int = 10
    shift: tuple[float, ...] = (0.0,) * 6
    """Of the first camera's data, m and rad, from `begin` on."""
    begin: int = 0
    shift_of_other: tuple[float, ...] = (0.0,) * 6
    cameras: Sequence[str] = ("hand",)
    arm_moves: bool = True
    textured: float = 1.0

    def write(self, path: Path) -> Path:
        """Write it."""
        random = np.random.default_rng(7)
        motion, table = (
            HandMotion.drawn(random),
            Table.drawn(random, boxes=4, moving=0, fingers=1, textured=self.textured),
        )
        step = 0.5 if self.arm_moves else 0.0
        with BagFile(path, "bag") as bag:
            bag.transforms(
                "/tf_static", BEGIN, {("camera_link", "optical"): OPTICAL, ("other_link", "other_optical"): OPTICAL}
            )
            for i in range(50 * self.images // 2 + 25):
                T = motion.camera(step * (i - 10) / 25) @ inverse(T_LINK_CAMERA)
                bag.transforms("/tf", BEGIN + (i - 10) * SECOND // 50, {("base", "tool"): T})
            for k in range(self.images):
                stamp, T = BEGIN + k * SECOND // 2, motion.camera(step * k)
                first = retract(T, np.array(self.shift)) if k >= self.begin else T
                places = {"hand": first, "other": retract(T @ T_BESIDE, np.array(self.shift_of_other))}
                for name in self.cameras:
                    frame = "optical" if name == "hand" else "other_optical"
                    image = taken(table.seen(places[name], 0.5 * k, CAMERA), random)
                    bag.camera_info(f"/{name}/camera_info", stamp, frame, (320, 240), FOCAL)
                    bag.image(
                        f"/{name}/image_raw", stamp, np.asarray(cv2.cvtColor(image, cv2.COLOR_GRAY2BGR)), frame, "mono8"
                    )
        return path


def accepted_cameras(sigma_mm: float = 0.1, sigma_deg: float = 0.01) -> CalibrationDocument:
    """The accepted calibration of both cameras."""
    mounts = {"hand": ("camera_link", T_LINK_CAMERA), "other": ("other_link", T_LINK_CAMERA @ T_BESIDE)}
    return accepted_mounts(
        {name: ("tool", child, T @ inverse(OPTICAL)) for name, (child, T) in mounts.items()}, sigma_mm, sigma_deg
    )


def accepted_mounts(
    mounts: Mapping[str, tuple[str, str, Array]], sigma_mm: float = 0.1, sigma_deg: float = 0.01
) -> CalibrationDocument:
    """The accepted calibration of sensors: the frames of each, and the pose of the second in the first."""
    return CalibrationDocument(
        data="0" * 64,
        collections=20,
        engine="1",
        poses=tuple(_pose(name, *mount, sigma_mm, sigma_deg) for name, mount in mounts.items()),
        rejected_labels=0,
        labels=1000,
        iterations=5,
        views=dict.fromkeys(mounts, 20),
    )


def _pose(name: str, parent: str, child: str, T: Array, sigma_mm: float, sigma_deg: float) -> CalibratedPose:
    rpy = np.degrees(to_rpy(T[:3, :3]))
    return CalibratedPose(
        parent, child, tuple((1e3 * T[:3, 3]).tolist()), tuple(rpy.tolist()), name,
        (sigma_mm,) * 3, (sigma_deg,) * 3, (0.0,) * 15,
    )  # fmt: skip
