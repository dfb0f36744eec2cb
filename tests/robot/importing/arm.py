"""A recording of riwbot: a camera that watches an arm with a pattern on its flange."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any

import cv2
import numpy as np

from calibration.engine.dataset.reading import read_dataset
from tests.robot.importing.bags import BEGIN, SECOND, BagFile, Kind
from tests.robot.importing.conftest import BOARD, DATASETS

SYSTEM = DATASETS / "riwbot"
PATTERN = {**BOARD, "columns": 7, "rows": 7, "square": 0.02, "marker": 0.015, "dictionary": "DICT_4X4_100"}
ON_FLANGE = {**PATTERN, "parent": "flange"}


def keys() -> tuple[str, ...]:
    """The collections of riwbot, each a pose of the arm."""
    return read_dataset(SYSTEM).keys


def record_arm(
    path: Path,
    kind: Kind,
    poses: Sequence[str],
    *,
    encoding: str = "rgb8",
    focal: float = 1.0,
    urdf: bool = True,
    moving: Sequence[int] = (),
    info: Mapping[str, Any] = MappingProxyType({}),
) -> None:
    """Write a bag in which the arm stands still at some poses, and an image is taken at each.

    Args:
        path: of the bag.
        kind: of bag.
        poses: collections of riwbot.
        encoding: of the images.
        focal: factor of the focal length that camera_info states.
        urdf: whether ``/robot_description`` is recorded.
        moving: poses, by their number in the bag, at which the arm does not stand still.
        info: fields of camera_info that are not those of riwbot's camera.
    """
    camera = read_dataset(SYSTEM).sensors["rgb_world"]
    assert camera.camera is not None
    size = camera.camera.width, camera.camera.height
    motion = json.loads((SYSTEM / "motion.json").read_text())
    with BagFile(path, kind) as bag:
        if urdf:
            bag.text("/robot_description", BEGIN, (SYSTEM / "robot.urdf").read_text())
        for n, key in enumerate(poses):
            pose, stamp = motion[str(int(key) + 1)], BEGIN + n * SECOND
            for offset in (-2, 0, 2):
                shift = 0.1 if n in moving and offset else 0.0
                positions = {name: value + shift for name, value in (pose.get("joints") or pose).items()}
                bag.joints("/joint_states", stamp + offset * SECOND // 10, positions)
            bag.camera_info("/rgb_world/camera_info", stamp, camera.frame, size, focal * camera.camera.fx, **info)
            shown = np.asarray(cv2.imread(str(SYSTEM / f"rgb_world_{key}.jpg")))
            bag.image("/rgb_world/image_raw", stamp, shown, camera.frame, encoding)
