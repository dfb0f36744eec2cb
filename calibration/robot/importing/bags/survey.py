"""First pass over a bag: topics, stamps, intrinsics and motion. No image is decoded."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

import numpy as np

from calibration.base import InputError
from calibration.engine.dataset.modalities import DEPTH, LIDAR3D, MODALITIES, RGB, Modality
from calibration.engine.geometry.cameras import Camera
from calibration.robot.importing.bags.bag import (
    LIVOX_TYPES,
    NS_PER_S,
    TF_TYPES,
    VIDEO_TYPES,
    Bag,
    RawMessage,
)
from calibration.robot.importing.bags.messages import INSTALL_PYAV, CameraMessage, camera_of, frame_of, transform_of
from calibration.robot.importing.bags.motion import MotionLog, frames_of
from calibration.robot.importing.bags.video_packets import NO_KEY_FRAME, KeyFrames, is_pyav_installed
from calibration.robot.importing.description import ImportDescription, SensorDescription
from calibration.robot.importing.results import LeftOutCounts
from calibration.robot.robot_description import read_robot_description

_SENSOR_PACKAGE = "sensor_msgs/msg/"
IMAGE_TYPES = (f"{_SENSOR_PACKAGE}Image", f"{_SENSOR_PACKAGE}CompressedImage", *VIDEO_TYPES)
MODALITY_OF_MESSAGE = {
    **dict.fromkeys(IMAGE_TYPES, RGB),
    **{
        f"{_SENSOR_PACKAGE}{each.message}": each
        for each in MODALITIES.values()
        if each.points and each.message != RGB.message
    },
    **dict.fromkeys(LIVOX_TYPES, LIDAR3D),
}
"""Modalities by the types of the messages; images may be a depth camera's."""
CAMERA_INFO_TYPE, JOINT_STATE_TYPE = f"{_SENSOR_PACKAGE}CameraInfo", f"{_SENSOR_PACKAGE}JointState"
STRING_TYPE = "std_msgs/msg/String"
OTHER_MESSAGES = {
    "FFMPEGPacket": f": {INSTALL_PYAV}",
    "CompressedVideo": f": {INSTALL_PYAV}",
}
"""What to record in place of messages that are not read, by a part of their type."""
MAX_STEP_BACK = 0.1
"""s: limit of the decrease of a topic's stamps; a clock that is set back further makes two recordings of one."""
NOT_LATER = "its stamp is not later than that of the message before"
SAME_TIME = "it was recorded at the time of another message"
NO_POSE = "no pose: a number that is not finite, or a quaternion that is not one"
NO_POSITION = "no position: a number that is not finite"
NO_KEY_FRAME_YET = "packet of a video before the first key frame"
RECTIFIED_TWIN = "topic of rectified images beside the raw ones"


def is_rectified(topic: str) -> bool:
    """Return whether images are rectified, by the name of their topic, as image_proc names them."""
    return any(part.startswith("image_rect") for part in PurePosixPath(topic).parts)


@dataclass
class RecordedLens:
    """Intrinsics of a camera_info topic, the same in all of its messages but those that are not calibrated."""

    topic: str
    _found: CameraMessage | None = None
    _content: bytes = b""
    """First calibrated message, without its stamp."""

    def add(self, bag: Bag, message: RawMessage) -> None:
        """Add a message.

        Raises:
            InputError: it is invalid, or has other intrinsics than one before it.
        """
        content = bag.without_stamp(message)
        if content == self._content:
            return
        found = camera_of(bag.decode(message), f"{bag.path}: {self.topic}")
        if found is None:
            return
        if self._found is None:
            self._found, self._content = found, content
        elif found != self._found:
            raise InputError(
                f"{bag.place(message)}: found {_in_words(found.raw)}, before it "
                f"{_in_words(self._found.raw)}; expected intrinsics that do not change: cut the bag there, or give "
                "'intrinsics'"
            )

    def camera(self, rectified: bool) -> Camera | None:
        """Return the intrinsics of raw or of rectified images; None if no message is calibrated.

        Raises:
            InputError: images are rectified by a rotation of the camera's frame.
        """
        if self._found is None:
            return None
        return self._found.rectified(self.topic) if rectified else self._found.raw


def _in_words(camera: Camera) -> str:
    values = zip(camera.parameters, camera.intrinsics.tolist(), strict=True)
    return f"{camera.width} x {camera.height}, {', '.join(f'{name} {value:.6g}' for name, value in values)}"


@dataclass(frozen=True, eq=False)
class SensorTopic:
    """Sensor of a bag."""

    described: SensorDescription
    topic: str
    modality: Modality
    frame: str
    """Frame of its data, by their headers."""
    stamps: Mapping[int, int]
    """Stamp of every message, ns, by its recording time, ns."""
    camera: Camera | None
    """Intrinsics by camera_info; None without one, or if it is not calibrated."""


@dataclass(frozen=True, eq=False)
class Survey:
    """Content of a bag."""

    sensors: Mapping[str, SensorTopic]
    log: MotionLog
    key_frames: Mapping[str, Sequence[int]]
    """Recording times of the key frames of each topic with video, ns."""

    @property
    def cameras(self) -> Mapping[str, SensorTopic]:
        """Sensors with images."""
        return {name: each for name, each in self.sensors.items() if each.modality.has_corners}

    @property
    def range_sensors(self) -> Mapping[str, SensorTopic]:
        """Sensors with clouds, scans or depth images."""
        return {name: each for name, each in self.sensors.items() if each.modality.points}


def survey(bag: Bag, described: ImportDescription) -> Survey:
    """Survey a bag.

    Raises:
        InputError: a topic is missing or has no message, a clock jumps back, the stamps of two cameras do not
            overlap, or a message is wrong.
    """
    sensors = described.sensors or _at_least_one_camera(bag)
    for sensor in sensors:
        _check_topic(bag, sensor)
    kinds = {sensor.name: modality_of_topic(bag, sensor) for sensor in sensors}
    if not any(kind.has_corners for kind in kinds.values()):
        raise InputError(f"{bag.path}: found no camera among the sensors, expected one that sees where the pattern is")
    own = [sensor for sensor in sensors if sensor.intrinsics is None and kinds[sensor.name].has_intrinsics]
    infos = {sensor.name: info_topic(bag, sensor) for sensor in own}
    of_topic = {sensor.topic or "": sensor for sensor in sensors}
    first: dict[str, RawMessage] = {}
    lenses = {topic: RecordedLens(topic) for topic in infos.values() if topic is not None}
    stamps: dict[str, dict[int, int]] = {sensor.name: {} for sensor in sensors}
    key_frames = KeyFrames(bag)
    log = MotionLog()
    for topic in () if described.sensors else _rectified_twins(bag):
        log.left_out.add(RECTIFIED_TWIN, topic)
    moving = motion_topics(bag)
    for message in bag.messages({*of_topic, *lenses, *moving}):
        if (described_sensor := of_topic.get(message.topic)) is not None:
            first.setdefault(message.topic, message)
            if key_frames.add(message):
                _add_stamp(bag, message, described_sensor, stamps[described_sensor.name], log.left_out)
            else:
                log.left_out.add(NO_KEY_FRAME_YET, described_sensor.name, bag.stamp(message))
        elif message.topic in moving:
            add_motion(bag, message, log)
        else:
            lenses[message.topic].add(bag, message)
    add_described_robot(described, log)
    topics = {}
    for sensor in sensors:
        topic, info = sensor.topic or "", infos.get(sensor.name)
        if topic not in first:
            raise InputError(f"{bag.path}: {topic}: found no message, expected the data of '{sensor.name}'")
        if not stamps[sensor.name]:
            raise InputError(f"{bag.path}: {topic}: {NO_KEY_FRAME}")
        frame = sensor.frame or frame_of(bag.decode(first[topic])) or sensor.link
        camera = None if info is None else lenses[info].camera(is_rectified(topic))
        kind = kinds[sensor.name]
        if kind.points and kind.has_intrinsics and sensor.intrinsics is None and camera is None:
            raise InputError(
                f"{bag.path}: found no camera_info for the depth images of {topic}, expected one beside them, or "
                f"'intrinsics' of '{sensor.name}'; topics of that type: "
                f"{', '.join(bag.of_type(CAMERA_INFO_TYPE)) or 'none'}"
            )
        topics[sensor.name] = SensorTopic(sensor, topic, kind, frame, stamps[sensor.name], camera)
    _check_overlap(bag, list(topics.values()))
    return Survey(topics, log, key_frames.recorded)


def _at_least_one_camera(bag: Bag) -> tuple[SensorDescription, ...]:
    """Return `cameras_of` a bag, at least one."""
    if not (cameras := cameras_of(bag)):
        raise InputError(f"{bag.path}: {no_images(bag)}")
    return cameras


def no_images(bag: Bag) -> str:
    """Return in words that a bag has no topic of images, and what to do."""
    kinds = ", ".join(f"{topic} ({kind})" for topic, kind in bag.topics.items()) or "none"
    depth = [topic for topic in image_topics(bag) if is_depth(topic)]
    hint = f"; {depth[0]} is taken for depth by its name: name it in 'sensors', with modality: rgb" if depth else ""
    hint = hint or next((hint for kind in bag.topics.values() if (hint := what_to_record(kind))), "")
    return f"found no topic of images, expected one{hint}; topics: {kinds}"


def cameras_of(bag: Bag) -> tuple[SensorDescription, ...]:
    """Return every topic of colour images that is not rectified beside the raw one."""
    twins = _rectified_twins(bag)
    topics = [topic for topic in image_topics(bag) if not is_depth(topic) and topic not in twins]
    names = {topic: topic.strip("/").split("/")[0] for topic in topics}
    if len(set(names.values())) < len(names):
        names = {topic: topic.strip("/").replace("/", "_") for topic in topics}
    return tuple(SensorDescription(name, topic=topic) for topic, name in names.items())


def image_topics(bag: Bag) -> list[str]:
    """Return every topic of images; of raw, compressed ones and video of the same images, the first of these."""
    raw, compressed = bag.of_type(IMAGE_TYPES[0]), bag.of_type(IMAGE_TYPES[1])
    videos = bag.of_type(*VIDEO_TYPES) if is_pyav_installed() else []
    images = {*raw, *(_raw_topic(topic) for topic in compressed)}
    return [
        *raw,
        *(topic for topic in compressed if _raw_topic(topic) not in raw),
        *(topic for topic in videos if _raw_topic(topic) not in images),
    ]


def _raw_topic(topic: str) -> str:
    """Return the topic of the raw images, of one of image_transport ("/camera/image_raw/ffmpeg")."""
    return str(PurePosixPath(topic).parent)


def _rectified_twins(bag: Bag) -> list[str]:
    """Return the topics of rectified images in whose namespace the images as they were taken are, too."""
    rectified: dict[str, bool] = {topic: is_rectified(topic) for topic in image_topics(bag)}
    cameras = {_camera_namespace(topic) for topic, is_one in rectified.items() if not is_one and not is_depth(topic)}
    return [topic for topic, is_one in rectified.items() if is_one and _camera_namespace(topic) in cameras]


def _camera_namespace(topic: str) -> str:
    """Return the topic's part before "image_raw", "image_rect_color" and the like."""
    parts = PurePosixPath(topic).parts
    ends = [i for i, part in enumerate(parts) if part.startswith("image")]
    return "/".join(parts[: ends[0]]) if ends else topic


def what_to_record(kind: str | None) -> str:
    """Return what to record in place of messages of a type, to be appended to an error; empty if it is read."""
    return next((hint for name, hint in OTHER_MESSAGES.items() if kind and name in kind), "")


def _check_topic(bag: Bag, sensor: SensorDescription) -> None:
    unread = () if is_pyav_installed() else VIDEO_TYPES
    known = bag.of_type(*(kind for kind in MODALITY_OF_MESSAGE if kind not in unread))
    if sensor.topic not in known:
        kind = bag.topics.get(sensor.topic or "")
        problem = f"found '{sensor.topic}' as {kind}" if kind else f"found no topic '{sensor.topic}'"
        raise InputError(
            f"{bag.path}: {problem}, expected the data of '{sensor.name}'{what_to_record(kind)}; "
            f"topics of cameras and LiDARs: {', '.join(known) or 'none'}"
        )


def modality_of_topic(bag: Bag, sensor: SensorDescription) -> Modality:
    """Return the modality by the type of its messages, and for images by the name of the topic."""
    kind = MODALITY_OF_MESSAGE[bag.topics[sensor.topic or ""]]
    if kind != RGB:
        return kind
    if sensor.modality:
        return MODALITIES[sensor.modality]
    return DEPTH if is_depth(sensor.topic or "") else RGB


def is_depth(topic: str) -> bool:
    """Return whether a topic of images is one of depth, by its name."""
    return "depth" in topic.lower()


def info_topic(bag: Bag, sensor: SensorDescription) -> str | None:
    """Return the topic of a camera's intrinsics: the named one, else the one next to its images."""
    known = bag.of_type(CAMERA_INFO_TYPE)
    if sensor.camera_info is not None:
        if sensor.camera_info not in known:
            raise InputError(
                f"{bag.path}: found no camera_info '{sensor.camera_info}' for '{sensor.name}'; topics of that type: "
                f"{', '.join(known) or 'none'}"
            )
        return sensor.camera_info
    above = PurePosixPath(sensor.topic or "").parents
    return next((str(path / "camera_info") for path in above if str(path / "camera_info") in known), None)


def _add_stamp(
    bag: Bag, message: RawMessage, sensor: SensorDescription, stamps: dict[int, int], left_out: LeftOutCounts
) -> None:
    """Add the stamp of a message; of those that are not later than the one before, none."""
    stamp = message.recorded if sensor.stamps == "recorded" else bag.stamp(message)
    last = next(reversed(stamps.values()), None)
    if last is not None and stamp < last - MAX_STEP_BACK * NS_PER_S:
        raise InputError(
            f"{bag.path}: {message.topic}: the clock jumps back by {(last - stamp) / NS_PER_S:.3f} s at "
            f"{last / NS_PER_S:.3f}; expected rising stamps: cut the bag there, or 'stamps: recorded' for "
            f"'{sensor.name}'"
        )
    if message.recorded in stamps:
        left_out.add(SAME_TIME, sensor.name, stamp)
    elif last is not None and stamp <= last:
        left_out.add(NOT_LATER, sensor.name, stamp)
    else:
        stamps[message.recorded] = stamp


def motion_topics(bag: Bag) -> set[str]:
    """Return the topics of frames, joints and robot descriptions."""
    texts = [topic for topic in bag.of_type(STRING_TYPE) if topic.endswith("robot_description")]
    return {*bag.of_type(*TF_TYPES), *bag.of_type(JOINT_STATE_TYPE), *texts}


def add_described_robot(described: ImportDescription, log: MotionLog) -> None:
    """Add the robot description that import.yml names, if it does, to a log.

    Raises:
        InputError: it cannot be read.
    """
    if described.bags is not None and (urdf := described.bags.robot_description):
        log.add_robot(read_robot_description(urdf, described.bags.xacro), urdf)


def add_motion(bag: Bag, message: RawMessage, log: MotionLog) -> None:
    """Add the frames, joints or robot description of a message to a log.

    Raises:
        InputError: it cannot be decoded.
    """
    kind, content = bag.topics[message.topic], bag.decode(message)
    if kind in TF_TYPES:
        for each in content.transforms:
            edge, T = transform_of(each)
            stamp = int(each.header.stamp.sec) * NS_PER_S + int(each.header.stamp.nanosec) or message.recorded
            if T is None:
                log.left_out.add(NO_POSE, frames_of(edge), stamp)
            elif message.topic.endswith("tf_static"):
                log.static[edge] = T
            else:
                log.add_transform(edge, stamp, T)
    elif kind == JOINT_STATE_TYPE:
        for name, position in zip(content.name, content.position, strict=False):
            if np.isfinite(position):
                log.add_joint_position(str(name), bag.stamp(message), float(position))
            else:
                log.left_out.add(NO_POSITION, str(name), bag.stamp(message))
    elif log.robot is None and not log.robot_fault:
        try:
            log.add_robot(str(content.data).encode(), Path(f"{bag.path}:{message.topic}"))
        except InputError as error:
            log.robot_fault = str(error)


def _check_overlap(bag: Bag, cameras: Sequence[SensorTopic]) -> None:
    spans = {each.topic: (min(each.stamps.values()), max(each.stamps.values())) for each in cameras}
    for topic, (start, end) in spans.items():
        for other, (first, last) in spans.items():
            if start > last:
                raise InputError(
                    f"{bag.path}: the stamps of {topic} ({start / NS_PER_S:.3f} to {end / NS_PER_S:.3f}) and of "
                    f"{other} "
                    f"({first / NS_PER_S:.3f} to {last / NS_PER_S:.3f}) do not overlap: are their clocks synchronised? "
                    "'stamps: recorded' of a sensor takes the times at which it was recorded"
                )
