"""A bag's topics, frames and intrinsics, without decoding an image."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from calibration.base import InputError
from calibration.engine.dataset.model import Edge
from calibration.robot.importing.bags import survey
from calibration.robot.importing.bags.bag import NS_PER_S, Bag, RawMessage
from calibration.robot.importing.bags.messages import frame_of
from calibration.robot.importing.bags.motion import STILL_M, STILL_RAD, MotionLog
from calibration.robot.importing.bags.video_packets import KeyFrames
from calibration.robot.importing.description import ImportDescription, SensorDescription
from calibration.robot.importing.look.images import MAX_CAMERAS
from calibration.robot.importing.results import FramesSummary, TopicSummary

MAX_BYTES = 20_000_000_000
"""Limit of the content of the messages that are read; of a longer recording only its begin is looked at."""
MAX_MESSAGES = 3_000_000
"""Limit of their number."""
NOT_CALIBRATED = "not calibrated (focal length 0)"
STAY_STEP = 0.2
"""s: step of the times at which standstill is looked for."""
MAX_STAY_TIMES = 3000
"""Limit of their number; of a longer recording the steps are longer."""


@dataclass
class TopicTimes:
    """Times of the messages of one topic, ns."""

    recorded: list[int] = field(default_factory=list)
    stamps: list[int] = field(default_factory=list)
    """Of their headers; of cameras and LiDARs only."""

    def summary(self, kind: str) -> TopicSummary:
        """Return them as a result."""
        steps = np.diff(sorted(self.recorded)) / NS_PER_S
        span = float(steps.sum())
        rate = len(steps) / span if span > 0 else None
        return TopicSummary(
            kind,
            len(self.recorded),
            None if rate is None else round(rate, 3),
            round(float(steps.max()), 3) if len(steps) else None,
        )


@dataclass(frozen=True, eq=False)
class BagContent:
    """What a bag holds."""

    times: Mapping[str, TopicTimes]
    """By topic, of all topics."""
    types: Mapping[str, str]
    cameras: Sequence[SensorDescription]
    intrinsics: Mapping[str, str]
    """What is known of each camera's intrinsics, in words, by name."""
    faults: Mapping[str, str]
    """Why they cannot be read, likewise."""
    frames: Mapping[str, str]
    """Frame of each camera's images, likewise; empty if it is not known."""
    key_frames: Mapping[str, Sequence[int]]
    """Recording times of the key frames of each topic with video, ns."""
    log: MotionLog
    is_cut: bool
    """Whether only the begin was read."""


def read_content(bag: Bag, described: ImportDescription | None) -> BagContent:
    """Read all messages of a bag once.

    Raises:
        InputError: it is damaged, or a message of frames or joints is.
    """
    found = described.sensors if described else ()
    cameras = (found or survey.cameras_of(bag))[:MAX_CAMERAS]
    times = {topic: TopicTimes() for topic in bag.topics}
    infos, faults = _info_topics(bag, cameras)
    lenses = {topic: survey.RecordedLens(topic) for topic in infos.values()}
    info_faults: dict[str, str] = {}
    moving, stamped = survey.motion_topics(bag), {*bag.of_type(*survey.MODALITY_OF_MESSAGE)}
    key_frames, shown = KeyFrames(bag), {each.topic for each in cameras}
    by_recording = {each.topic for each in cameras if each.stamps == "recorded"}
    log, first, size, count, is_cut = MotionLog(), dict[str, RawMessage](), 0, 0, False
    for message in bag.messages(times):
        count, size = count + 1, size + len(message.data)
        if is_cut := count > MAX_MESSAGES or size > MAX_BYTES:
            break
        own = times[message.topic]
        own.recorded.append(message.recorded)
        if message.topic in stamped:
            own.stamps.append(message.recorded if message.topic in by_recording else bag.stamp(message))
            first.setdefault(message.topic, message)
            if message.topic in shown:
                key_frames.add(message)
        elif message.topic in moving:
            survey.add_motion(bag, message, log)
        elif message.topic in lenses and message.topic not in info_faults:
            try:
                lenses[message.topic].add(bag, message)
            except InputError as error:
                info_faults[message.topic] = str(error)
    if described:
        survey.add_described_robot(described, log)
    words = {}
    for camera in cameras:
        topic = infos.get(camera.name, "")
        if topic in info_faults:
            faults[camera.name] = info_faults[topic]
        words[camera.name] = _lens_in_words(camera, lenses.get(topic), times.get(topic))
    frames = {}
    for camera in cameras:
        message_ = first.get(camera.topic or "")
        frames[camera.name] = camera.frame or (frame_of(bag.decode(message_)) if message_ else "")
    stripped = {name: frame.lstrip("/") for name, frame in frames.items()}
    videos = key_frames.recorded
    return BagContent(times, bag.topics, cameras, words, faults, stripped, videos, log, is_cut)


def _info_topics(bag: Bag, cameras: Collection[SensorDescription]) -> tuple[dict[str, str], dict[str, str]]:
    """Return the topic of each camera's intrinsics, by name, and why a described one is not there."""
    infos, faults = {}, {}
    for camera in cameras:
        try:
            if camera.intrinsics is None and (topic := survey.info_topic(bag, camera)):
                infos[camera.name] = topic
        except InputError as error:
            faults[camera.name] = str(error)
    return infos, faults


def _lens_in_words(camera: SensorDescription, lens: survey.RecordedLens | None, times: TopicTimes | None) -> str:
    if camera.intrinsics is not None:
        return Path(camera.intrinsics).name
    if lens is None or times is None or not times.recorded:
        return "none"
    try:
        known = lens.camera(survey.is_rectified(camera.topic or ""))
    except InputError as error:
        return str(error)
    if known is None:
        return NOT_CALIBRATED
    centre = f"principal point {known.cx:.0f}, {known.cy:.0f}"
    return f"{known.width} x {known.height}, {type(known.distortion).__name__}, f {known.fx:.0f}, {centre}"


def frames_summary(content: BagContent, parents: Collection[str]) -> FramesSummary:
    """Return the frames and joints as a result.

    Args:
        content: of the bag.
        parents: frames that carry patterns.
    """
    log = content.log
    children = {child for _, child in log.edges}
    frames = dict.fromkeys(frame for edge in log.edges for frame in edge)
    robot = "read" if log.robot is not None else log.robot_fault or "none"
    return FramesSummary(
        tuple(frame for frame in frames if frame not in children),
        len(frames),
        tuple(sorted(edge[1] for edge, track in log.moving.items() if _largest_difference(track.values) > STILL_M)),
        tuple(sorted(name for name, track in log.joints.items() if _largest_difference(track.values) > STILL_RAD)),
        robot,
        _count_standstills(content, parents),
    )


def _largest_difference(values: Sequence[np.ndarray]) -> float:
    """Return the largest difference of a number of some arrays."""
    return float(np.ptp(np.stack(values), axis=0).max()) if values else 0.0


def _count_standstills(content: BagContent, parents: Collection[str]) -> int | None:
    """Return how often everything on the way to a camera or a pattern stands still; None if nothing there moves.

    Of a camera and a pattern that nothing is known to move, all counts that moves, but what never stands still, such as
    wheels.
    """
    log = content.log
    followed = {joint.edge: joint.driver for joint in log.robot.joints} if log.robot else {}
    recorded = [edge for edge in log.edges if edge in log.moving or followed.get(edge) in log.joints]
    above: dict[str, Edge] = {edge[1]: edge for edge in reversed(log.edges)}
    used: dict[Edge, None] = {}
    for frame in (*content.frames.values(), *parents):
        while (edge := above.get(frame)) is not None and edge not in used:
            used[edge] = None
            frame = edge[0]
    moving = [edge for edge in recorded if edge in used]
    images = [time for each in content.cameras for time in content.times.get(each.topic or "", TopicTimes()).stamps]
    if not recorded or not images:
        return None
    count = int(min((max(images) - min(images)) / NS_PER_S / STAY_STEP + 1, MAX_STAY_TIMES))
    times = np.linspace(min(images), max(images), count)
    still = np.array([[_is_still(log, edge, time) for time in times.tolist()] for edge in moving or recorded])
    if not moving and still.any():
        still = still[still.any(-1)]
    together = np.concatenate([[False], still.all(0)])
    return int((together[1:] & ~together[:-1]).sum())


def _is_still(log: MotionLog, edge: Edge, time: float) -> bool:
    try:
        return log.is_still([edge], time)
    except InputError:  # nothing was recorded near that time
        return False
