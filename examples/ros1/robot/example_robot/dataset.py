"""A dataset in ATOM's form, version 3.0: a folder with ``dataset.json`` and the images beside it."""

import json
import time
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from example_robot.camera import Camera
from example_robot.poses import along, chain, to_entry

FILE = "dataset.json"


@dataclass
class View:
    """What one camera saw."""

    image: np.ndarray
    message: dict
    """The sensor_msgs/Image without its data."""
    info: dict
    """The sensor_msgs/CameraInfo."""
    ids: np.ndarray
    pixels: np.ndarray
    """(K, 2): of the corners of these ids."""


class DatasetFolder:
    """The dataset that is collected; whole on the disk after every collection."""

    def __init__(self, folder, config, board):
        self.folder = Path(folder)
        self.folder.mkdir(parents=True, exist_ok=True)
        if (self.folder / FILE).exists():
            raise FileExistsError(f"{self.folder / FILE}: exists already; collect into another folder")
        self.config, self.board = config, board
        (self.pattern,) = config["calibration_patterns"]
        self.collections, self.initial = {}, {}

    def add(self, views, transforms):
        """Add a collection of what each sensor saw, and the transforms of that moment.

        Args:
            views: by sensor.
            transforms: by "parent-child", as the dataset has them.

        Returns:
            The key of the collection.
        """
        key = f"{len(self.collections):03d}"
        data, labels, sensors = {}, {}, {}
        for name, view in views.items():
            file = f"{name}_{key}.jpg"
            self._write(file, cv2.imencode(".jpg", view.image)[1].tobytes())
            data[name] = {**view.message, "data_file": file}
            corners = zip(view.ids.tolist(), view.pixels.tolist(), strict=True)
            idxs = [{"id": i, "x": round(x, 4), "y": round(y, 4)} for i, (x, y) in corners]
            labels[name] = {"detected": True, "idxs": idxs}
            sensors[name] = self._sensor(name, view.info, transforms)
        collection = {
            "additional_data": {},
            "data": data,
            "joints": {},
            "labels": {self.pattern: labels},
            "transforms": transforms,
        }
        collections = {**self.collections, key: collection}
        initial = {**self.initial, key: self._initial(views, transforms)}
        document = self._document(sensors, collections, initial)
        self._write(FILE, json.dumps(document, indent=2, sort_keys=True).encode())
        self.collections, self.initial = collections, initial  # now that they are on the disk
        return key

    def _write(self, name, content):
        """Write a file as a whole or not at all."""
        temporary = self.folder / f".{name}.new"
        temporary.write_bytes(content)
        temporary.replace(self.folder / name)

    def _sensor(self, name, info, transforms):
        config = self.config["sensors"][name]
        edges = [(entry["parent"], entry["child"]) for entry in transforms.values()]
        steps = chain(edges, self.config["world_link"], config["link"])
        return {
            "_name": name,
            "modality": config["modality"],
            "msg_type": "Image",
            "topic": config["topic_name"],
            "parent": config["link"],
            "calibration_parent": config["parent_link"],
            "calibration_child": config["child_link"],
            "chain": [{"parent": parent, "child": child, "key": f"{parent}-{child}"} for parent, child in steps],
            "camera_info_topic": config["topic_name"].rpartition("/")[0] + "/camera_info",
            "camera_info": info,
        }

    def _initial(self, views, transforms):
        """Where the first camera sees the board, through the transforms as they are."""
        pattern = self.config["calibration_patterns"][self.pattern]
        name, view = next(iter(views.items()))
        T_camera_board = Camera(view.info).board_pose(self.board.corners[view.ids], view.pixels)
        T_parent_camera = along(transforms, pattern["parent_link"], self.config["sensors"][name]["link"])
        entry = to_entry(pattern["parent_link"], pattern["link"], T_parent_camera @ T_camera_board)
        return {"detected": True, "sensor": name, **entry}

    def _document(self, sensors, collections, initial):
        return {
            "_metadata": {
                "dataset_name": self.folder.name,
                "date": time.ctime(),
                "package_name": self.config["package_name"],
                "robot_name": self.config["package_name"],
                "timestamp": str(time.time()),
                "user": "robot",
                "version": "3.0",
            },
            "additional_sensor_data": {},
            "calibration_config": self.config,
            "sensors": sensors,
            "patterns": {
                self.pattern: {
                    "corners": [{"id": i, "x": x, "y": y} for i, (x, y, _) in enumerate(self.board.corners.tolist())],
                    "transforms_initial": initial,
                }
            },
            "collections": collections,
        }
