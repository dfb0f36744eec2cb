#!/usr/bin/env python3
"""The robot application: holds what the cameras see, and saves it when it is asked to.

The service ``/collect_data/save_collection`` (std_srvs/Trigger) waits for an image of every camera that was taken
after the request, finds the board in it, and adds a collection to the dataset. It answers whether it did, and why not.
"""

import sys
import threading
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import rospy
import yaml
from example_robot.board import Board
from example_robot.dataset import DatasetFolder, View
from example_robot.poses import chain
from sensor_msgs.msg import CameraInfo, Image
from std_srvs.srv import Trigger, TriggerResponse
from tf2_msgs.msg import TFMessage

PATIENCE = 5.0
"""So long an image is waited for, s."""
BUFFER = 1 << 24
"""Bytes: rospy falls behind where an image does not fit."""


class Rejected(Exception):  # noqa: N818
    """Why a collection is not saved."""


@dataclass
class Latest:
    """The last messages of all topics."""

    images: dict = field(default_factory=dict)
    infos: dict = field(default_factory=dict)
    transforms: dict = field(default_factory=dict)
    """By (parent, child)."""


class Collector:
    """Listens to every sensor of a configuration, and saves collections."""

    def __init__(self, config, output):
        (pattern,) = config["calibration_patterns"].values()
        self.config, self.board = config, Board(pattern)
        self.dataset = DatasetFolder(output, config, self.board)
        self.latest = Latest()
        self.news, self.saving = threading.Condition(), threading.Lock()
        for name, sensor in config["sensors"].items():
            info_topic = sensor["topic_name"].rpartition("/")[0] + "/camera_info"
            images, infos = self.latest.images, self.latest.infos
            self.listen(sensor["topic_name"], Image, lambda message, n=name, to=images: to.__setitem__(n, message))
            self.listen(info_topic, CameraInfo, lambda message, n=name, to=infos: to.__setitem__(n, message))
        for topic in ("/tf", "/tf_static"):
            self.listen(topic, TFMessage, self.hold_transforms)
        rospy.Service("~save_collection", Trigger, self.save)

    def listen(self, topic, kind, hold):
        """Hold every message of a topic."""

        def receive(message):
            with self.news:
                hold(message)
                self.news.notify_all()

        rospy.Subscriber(topic, kind, receive, queue_size=1 if kind is Image else 100, buff_size=BUFFER)

    def hold_transforms(self, message):
        """Hold the newest transform between any two frames."""
        for entry in message.transforms:
            self.latest.transforms[entry.header.frame_id, entry.child_frame_id] = entry

    def save(self, _request):
        """Answer the service."""
        asked = rospy.Time.now()
        try:
            with self.saving:
                key = self.collect(asked)
        except Rejected as reason:
            rospy.logwarn("not saved: %s", reason)
            return TriggerResponse(False, str(reason))
        except OSError as error:
            rospy.logerr("not saved: %s", error)
            return TriggerResponse(False, str(error))
        rospy.loginfo("collection %s saved", key)
        return TriggerResponse(True, f"collection {key}")

    def collect(self, asked):
        """Save one collection of what is seen after a time."""
        images, infos, transforms = self.wait_for_images(asked)
        for sensor in self.config["sensors"].values():
            if chain(transforms, self.config["world_link"], sensor["link"]) is None:
                raise Rejected(f"no transform on /tf leads from {self.config['world_link']} to {sensor['link']}")
        views, missing = {}, []
        for name, message in images.items():
            image = as_array(message)
            found = self.board.detect(image)
            if found is None:
                missing.append(name)
            else:
                views[name] = View(image, image_document(message), info_document(infos[name]), *found)
        if missing:
            raise Rejected(f"{' and '.join(missing)} did not detect the board")
        documents = {f"{p}-{c}": transform_document(p, c, entry) for (p, c), entry in transforms.items()}
        return self.dataset.add(views, documents)

    def wait_for_images(self, asked):
        """The first images after a time that all sensors took together, with what else is known at that moment."""
        deadline = rospy.get_time() + PATIENCE
        with self.news:
            while (problem := self.problem(asked)) is not None:
                left = deadline - rospy.get_time()
                if left <= 0 or rospy.is_shutdown():
                    raise Rejected(problem)
                self.news.wait(min(left, 0.1))
            latest = self.latest
            names = self.config["sensors"]  # in their order
            return (
                {name: latest.images[name] for name in names},
                {name: latest.infos[name] for name in names},
                dict(latest.transforms),
            )

    def problem(self, asked):
        """Why the last messages make no collection; None if they do."""
        for name, sensor in self.config["sensors"].items():
            if name not in self.latest.images:
                return f"{name}: no image on {sensor['topic_name']}"
            if name not in self.latest.infos:
                return f"{name}: no camera_info"
            if self.latest.images[name].header.stamp < asked:
                return f"{name}: no image that is newer than the request within {PATIENCE:g} s"
        stamps = [image.header.stamp.to_sec() for image in self.latest.images.values()]
        apart = 1000 * (max(stamps) - min(stamps))
        if apart > self.config["max_duration_between_msgs"]:
            return f"the images were taken {apart:.0f} ms apart"
        return None


def as_array(message):
    """The image (H, W, 3), blue first."""
    if message.encoding not in ("bgr8", "rgb8"):
        raise Rejected(f"found an image of encoding '{message.encoding}', expected bgr8 or rgb8")
    rows = np.frombuffer(message.data, np.uint8).reshape(message.height, message.step)
    image = rows[:, : 3 * message.width].reshape(message.height, message.width, 3)
    return np.ascontiguousarray(image if message.encoding == "bgr8" else image[..., ::-1])


def header_document(header):
    """A header as the dataset has it."""
    stamp = {"secs": header.stamp.secs, "nsecs": header.stamp.nsecs}
    return {"seq": header.seq, "stamp": stamp, "frame_id": header.frame_id}


def image_document(message):
    """An image's message without its data."""
    return {
        "header": header_document(message.header),
        "height": message.height,
        "width": message.width,
        "encoding": "bgr8",
        "is_bigendian": 0,
        "step": 3 * message.width,
    }


def info_document(message):
    """A camera's intrinsics."""
    roi = message.roi
    return {
        "header": header_document(message.header),
        "height": message.height,
        "width": message.width,
        "distortion_model": message.distortion_model,
        **{key: list(getattr(message, key)) for key in "DKRP"},
        "binning_x": message.binning_x,
        "binning_y": message.binning_y,
        "roi": {key: getattr(roi, key) for key in ("x_offset", "y_offset", "height", "width", "do_rectify")},
    }


def transform_document(parent, child, entry):
    """A transform of tf."""
    t, r = entry.transform.translation, entry.transform.rotation
    return {"parent": parent, "child": child, "trans": [t.x, t.y, t.z], "quat": [r.x, r.y, r.z, r.w]}


def main():
    """Collect until ROS shuts down."""
    rospy.init_node("collect_data")
    try:
        config = yaml.safe_load(Path(rospy.get_param("~config")).read_text(encoding="utf-8"))
        collector = Collector(config, rospy.get_param("~output"))
    except OSError as error:
        sys.exit(f"collect_data: {error}")
    rospy.loginfo("collect_data ready: saves into %s", collector.dataset.folder)
    rospy.spin()


if __name__ == "__main__":
    main()
