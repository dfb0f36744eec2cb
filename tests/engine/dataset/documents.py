"""Tiny valid dataset to change and break: a camera and a LiDAR that see a chessboard."""

import copy
import json
from pathlib import Path
from typing import Any

import numpy as np

from calibration.engine.dataset.sensor_data import write_points

Document = dict[str, Any]
MISSING = object()
"""The value that `changed` gives to a key that it removes."""

CLOUD = np.array([[2.0, y / 8, z / 8] for z in (-1, 0, 1) for y in (-1, 0, 1)], np.float32)
IDENTITY = [0.0, 0.0, 0.0, 1.0]


def edge(parent: str, child: str, trans: list[float], quat: list[float] = IDENTITY) -> Document:
    return {f"{parent}-{child}": {"parent": parent, "child": child, "trans": trans, "quat": quat}}


def corners(*ids: int) -> list[Document]:
    return [{"id": i, "x": 100.5 + 40 * (i % 3), "y": 80.25 + 40 * (i // 3)} for i in ids]


def document() -> Document:
    """Version 3.0: collection 000 is seen by both sensors, 002 in part by the camera alone."""
    transforms = {
        **edge("world", "mount", [0.0, 0.0, 1.0]),
        **edge("mount", "cam_link", [0.1, 0.0, 0.0], [0.0, 0.0, 0.6, 0.8]),
        **edge("cam_link", "cam_optical", [0.0, 0.0, 0.0], [0.5, -0.5, 0.5, -0.5]),
        **edge("mount", "lidar_base", [-0.1, 0.0, 0.0]),
        **edge("lidar_base", "lidar_frame", [0.0, 0.0, 0.04]),
    }
    image = {"data_file": "cam_000.jpg", "encoding": "bgr8", "height": 240, "width": 320, "step": 960}
    cloud = {"data_file": "lidar_000.pcd", "height": 1, "width": len(CLOUD), "point_step": 12}
    return {
        "_metadata": {"dataset_name": "tiny", "robot_name": "two", "timestamp": "0.0", "user": "ci", "version": "3.0"},
        "additional_sensor_data": {},
        "calibration_config": {
            "world_link": "world",
            "anchored_sensor": "lidar",
            "additional_tfs": {"mast": {"parent_link": "world", "child_link": "mount"}},
            "joints": None,
            "package_name": "two_calibration",
            "description_file": "package://two_description/urdf/two.urdf.xacro",
            "bag_file": "",
            "max_duration_between_msgs": 1000,
            "version": 3.0,
            "sensors": {
                "cam": {
                    "link": "cam_optical",
                    "parent_link": "mount",
                    "child_link": "cam_link",
                    "topic_name": "/cam/image_raw",
                    "modality": "rgb",
                    "throttle": None,
                },
                "lidar": {
                    "link": "lidar_frame",
                    "parent_link": "mount",
                    "child_link": "lidar_base",
                    "topic_name": "/lidar/points",
                    "modality": "lidar3d",
                    "throttle": None,
                },
            },
            "calibration_patterns": {
                "board": {
                    "link": "board_link",
                    "parent_link": "world",
                    "fixed": False,
                    "pattern_type": "charuco",
                    "dictionary": "DICT_5X5_100",
                    "mesh_file": "",
                    "border_size": {"x": 0.02, "y": 0.01},
                    "dimension": {"x": 3, "y": 2},
                    "size": 0.1,
                    "inner_size": 0.08,
                }
            },
        },
        "sensors": {
            "cam": {
                "_name": "cam",
                "modality": "rgb",
                "parent": "cam_optical",
                "calibration_parent": "mount",
                "calibration_child": "cam_link",
                "topic": "/cam/image_raw",
                "camera_info": {
                    "height": 240,
                    "width": 320,
                    "distortion_model": "plumb_bob",
                    "D": [0.1, -0.2, 0.001, 0.002, 0.03],
                    "K": [300.0, 0.0, 160.5, 0.0, 301.0, 120.5, 0.0, 0.0, 1.0],
                },
            },
            "lidar": {
                "_name": "lidar",
                "modality": "lidar3d",
                "parent": "lidar_frame",
                "calibration_parent": "mount",
                "calibration_child": "lidar_base",
                "topic": "/lidar/points",
            },
        },
        "collections": {
            "002": {
                "transforms": copy.deepcopy(transforms),
                "data": {"cam": {**image, "data_file": "cam_002.jpg"}, "lidar": {**cloud, "data_file": "none.pcd"}},
                "labels": {
                    "board": {
                        "cam": {"detected": True, "idxs": corners(0, 2, 5)},
                        "lidar": {"detected": False, "idxs": [], "idxs_limit_points": []},
                    }
                },
            },
            "000": {
                "transforms": transforms,
                "joints": {"elbow": {"position": 0.5}},
                "additional_data": {},
                "data": {"cam": image, "lidar": cloud},
                "labels": {
                    "board": {
                        "cam": {"detected": True, "idxs": corners(5, 4, 3, 2, 1, 0)},
                        "lidar": {"detected": True, "idxs": [1, 3, 4, 7], "idxs_limit_points": [3, 1, 7]},
                    }
                },
            },
        },
    }


def version_2() -> Document:
    """The camera of `document` alone, as version 2.0 has it."""
    old = changed(document(), {"_metadata/version": "2.0"})
    config = old["calibration_config"]
    config["calibration_pattern"] = config.pop("calibration_patterns")["board"]
    config["anchored_sensor"] = ""
    for key in ("additional_tfs", "joints", "package_name", "version"):
        del config[key]
    del config["sensors"]["lidar"], old["sensors"]["lidar"]
    for collection in old["collections"].values():
        collection.pop("joints", None)
        del collection["data"]["lidar"]
        collection["labels"] = {"cam": collection["labels"]["board"]["cam"]}
    return old


def changed(original: Document, changes: dict[str, Any]) -> Document:
    """A copy with other values under some keys, ``a/b/0/c``; `MISSING` removes the key."""
    result = copy.deepcopy(original)
    for path, value in changes.items():
        *way, last = path.split("/")
        node: Any = result
        for key in way:
            node = node[int(key) if isinstance(node, list) else key]
        if value is MISSING:
            del node[last]
        else:
            node[int(last) if isinstance(node, list) else last] = value
    return result


def write(folder: Path, content: Document) -> Path:
    """Write ``dataset.json`` and the cloud of collection 000; the path of the JSON file."""
    folder.mkdir(exist_ok=True)
    write_points(folder / "lidar_000.pcd", CLOUD)
    path = folder / "dataset.json"
    path.write_text(json.dumps(content))
    return path
