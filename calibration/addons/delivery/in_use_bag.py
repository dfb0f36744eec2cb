"""Transforms and cameras that are in use, from ``/tf_static`` and camera_info of a bag; needs the extra ``bags``."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from calibration.addons.delivery.in_use import InUse, UsedCamera, UsedTransform
from calibration.addons.delivery.poses import pose_of
from calibration.robot.importing.bags.bag import Bag, open_bag

STATIC_TOPIC = "/tf_static"
CAMERA_INFO_TYPE = "sensor_msgs/msg/CameraInfo"
_FIELDS = ("K", "D", "R", "P")


def read_bag(path: Path) -> InUse:
    """Read the static transforms and the intrinsics that a bag has; each that changes is there several times.

    Raises:
        InputError: it is no bag, or is damaged.
        InfrastructureError: rosbags is not installed.
    """
    with open_bag([path]) as bag:
        transforms = tuple(dict.fromkeys(_static_transforms(bag)))
        cameras = tuple(_cameras(bag))
    return InUse(str(path), transforms, cameras)


def _static_transforms(bag: Bag) -> Iterator[UsedTransform]:
    for message in bag.messages([STATIC_TOPIC]):
        for entry in bag.decode(message).transforms:
            t, q = entry.transform.translation, entry.transform.rotation
            numbers = [float(value) for value in (t.x, t.y, t.z, q.x, q.y, q.z, q.w)]
            parent, child = (name.removeprefix("/") for name in (entry.header.frame_id, entry.child_frame_id))
            yield UsedTransform(parent, child, pose_of(numbers))


def _cameras(bag: Bag) -> Iterator[UsedCamera]:
    seen: set[tuple[str, bytes]] = set()
    for message in bag.messages(bag.of_type(CAMERA_INFO_TYPE)):
        key = (message.topic, bag.without_stamp(message))
        if key not in seen:
            seen.add(key)
            info = bag.decode(message)
            values: dict[str, Any] = {
                "width": int(info.width),
                "height": int(info.height),
                "distortion_model": info.distortion_model,
            }
            for name in _FIELDS:  # capitals in ROS 1
                numbers = getattr(info, name.lower(), None)
                values[name] = [float(each) for each in (getattr(info, name) if numbers is None else numbers)]
            frame = info.header.frame_id.removeprefix("/") or None
            yield UsedCamera(f"{bag.path}, {message.topic}", None, frame, values)
