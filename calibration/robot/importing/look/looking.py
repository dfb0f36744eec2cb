"""Looks at a recording before anything of it is described, and says what it lacks for a calibration."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations
from pathlib import Path

import numpy as np

from calibration.robot.importing.bags.bag import BAG_ENDINGS, NS_PER_S, open_bag
from calibration.robot.importing.bags.stillness import MAX_ASSOCIATED_SECONDS
from calibration.robot.importing.bags.survey import IMAGE_TYPES, MAX_STEP_BACK, is_depth, no_images, what_to_record
from calibration.robot.importing.description import ImportDescription
from calibration.robot.importing.importing import read_description
from calibration.robot.importing.look.images import (
    ImageSource,
    LookedFor,
    Sample,
    described_images,
    described_pattern,
    images_at,
    is_still,
    measured,
    pattern_in,
    sample,
    topic_images,
)
from calibration.robot.importing.look.topics import NOT_CALIBRATED, BagContent, frames_summary, read_content
from calibration.robot.importing.results import CameraSummary, FramesSummary, LookResults, Missing, TopicSummary
from calibration.robot.simulation.record import image_cells

YOUR_DATA = "docs/your-data.md"
BAGS_PAGE = YOUR_DATA + "#a-bag-of-ros-1-or-ros-2"
MIN_POSES = 10
"""Least number of poses: with 6 the error is twice that with 15 (docs/recording.md)."""
MIN_SEEN = 0.25
"""Least share of a camera's images that show the pattern."""
MIN_CELLS = 6
"""Least number of the cells of the image in which corners are seen, of 12."""
MAX_BLUR_PX = 1.5
"""Limit of the blur: from there on corners lose their accuracy (docs/recording.md)."""
MIN_WHITE = 60
"""Least level of the white of the pattern, of 255."""
MAX_SATURATED = 0.2
"""Limit of the share of saturated pixels on the pattern, half of which is white."""
MIN_STILL = 0.1
"""Least share of images that stand still, of those that follow another."""
MAX_HOLE = 2.0
"""s: limit of the time between two images of a topic of some images a second."""
MIN_RATE = 2.0
"""Hz: from this rate on a hole is not a way to record."""


def missing_in_bag(
    content: BagContent, frames: FramesSummary, no_camera: str, only_intrinsics: bool
) -> Iterator[Missing]:
    """Yield what the topics and frames of a bag lack.

    Args:
        content: of the bag.
        frames: its frames.
        no_camera: what to say of a bag without a topic of images.
        only_intrinsics: whether intrinsics are all that can be wanted, by import.yml.
    """
    if not content.cameras:
        yield Missing("no topic of images", no_camera, BAGS_PAGE)
    for topic, kind in content.types.items():
        if remedy := what_to_record(kind):
            yield Missing(f"{topic} is {kind}, which is not read", remedy.removeprefix(": "), BAGS_PAGE)
    named = {each.topic for each in content.cameras}
    for camera in content.cameras:
        topic = camera.topic or ""
        if topic not in content.times or not content.times[topic].recorded:
            yield Missing(f"{topic} of '{camera.name}' has no message", "record it, or correct 'topic'", BAGS_PAGE)
        if fault := content.faults.get(camera.name):
            yield Missing(f"camera_info of '{camera.name}': {fault}", "give 'intrinsics' of this sensor", BAGS_PAGE)
        elif content.types.get(topic, "").endswith("Image") and content.intrinsics[camera.name] == "none":
            remedy = "record the camera_info of its images, or give 'intrinsics' or 'camera-info' in import.yml"
            yield Missing(f"no camera_info of '{camera.name}'", remedy)
        elif content.intrinsics[camera.name] == NOT_CALIBRATED:
            remedy = "its intrinsics can be calibrated too, from corners in every part of the image"
            yield Missing(f"the camera_info of '{camera.name}' is {NOT_CALIBRATED}", remedy, is_needed=False)
    sensors = {topic: each.stamps for topic, each in content.times.items() if each.stamps}
    yield from _missing_stamps(sensors, {topic for topic in sensors if topic in named})
    for topic in sensors:
        own = content.times[topic].summary("")
        if (own.rate_hz or 0) >= MIN_RATE and (own.largest_gap_s or 0) > MAX_HOLE:
            what = f"{topic} has a gap of {own.largest_gap_s:.1f} s at {own.rate_hz:.1f} Hz"
            yield Missing(what, "record on a faster disk or fewer topics: were messages dropped?", is_needed=False)
    yield from _missing_frames(content, frames, only_intrinsics)
    if content.is_cut:
        yield Missing("the recording is long", "only its begin was looked at", is_needed=False)


def _missing_frames(content: BagContent, frames: FramesSummary, only_intrinsics: bool) -> Iterator[Missing]:
    if not frames.frames:
        why = "" if frames.robot_description == "read" else f" (robot_description: {frames.robot_description})"
        record = "record /tf and /tf_static, or joint states with /robot_description"
        if content.log.joints:
            record = "joints are recorded: name the robot's URDF, 'robot-description' of bags, or record /tf"
        several = len(content.cameras) > 1
        alone = "the cameras are calibrated, relative to each other" if several else "intrinsics are calibrated"
        is_needed = not several and not only_intrinsics
        yield Missing(f"no frames{why}", f"{record}, unless only {alone}", is_needed=is_needed)
        return
    if len(frames.roots) > 1:
        roots = ", ".join(f"'{root}'" for root in frames.roots)
        remedy = "record /tf_static from the start, with all that is published once: only frames of one tree connect"
        yield Missing(f"frames hang on {len(frames.roots)} roots: {roots}", remedy, BAGS_PAGE, is_needed=False)
    known = {frame for edge in content.log.edges for frame in edge}
    for name, frame in content.frames.items():
        if frame and frame not in known:
            remedy = "publish it in /tf_static or the robot description, or name it: 'frame' or 'parent' of the sensor"
            yield Missing(f"the frame of '{name}', '{frame}', is in no transform", remedy, BAGS_PAGE, is_needed=False)
    if frames.stays is not None and frames.stays < MIN_POSES:
        what = f"the robot stands still {frames.stays} times while images are taken, of {MIN_POSES} at least"
        yield Missing(what, "stop for half a second at each of 15 to 30 poses")


def _missing_stamps(sensors: Mapping[str, Sequence[int]], cameras: set[str]) -> Iterator[Missing]:
    """Yield what is wrong with the stamps of the topics of sensors, ns."""
    recorded = "'stamps: recorded' of the sensor takes the times of recording; better synchronise the clocks"
    for topic, stamps in sensors.items():
        steps = np.diff(stamps)
        if len(steps) and steps.min() < -MAX_STEP_BACK * NS_PER_S:
            back = f"{topic}: the stamps jump back by {-steps.min() / NS_PER_S:.3f} s"
            yield Missing(back, f"cut the bag there, or {recorded}", BAGS_PAGE)
        elif equal := int((steps <= 0).sum()):
            what = f"{topic}: {equal} of {len(stamps)} stamps are not later than the one before"
            yield Missing(what, "these images are left out: mend the driver's stamps", BAGS_PAGE, is_needed=False)
    for one, other in combinations(sensors, 2):
        if not {one, other} & cameras:
            continue
        a, b = np.sort(sensors[one]), np.sort(sensors[other])
        if a[0] > b[-1] or b[0] > a[-1]:
            yield Missing(f"the stamps of {one} and {other} do not overlap", recorded, BAGS_PAGE)
            continue
        after = np.clip(np.searchsorted(b, a), 1, max(len(b) - 1, 1))
        near = np.minimum(abs(b[np.minimum(after, len(b) - 1)] - a), abs(b[after - 1] - a))
        if {one, other} <= cameras and (apart := float(np.median(near)) / NS_PER_S) > MAX_ASSOCIATED_SECONDS:
            what = f"images of {one} and {other} are {apart:.2f} s apart"
            yield Missing(what, f"trigger them together, within {MAX_ASSOCIATED_SECONDS:g} s where all stands still")


def missing_in_images(
    name: str, camera: CameraSummary, white: float, pattern: str | None, instead: str | None
) -> Iterator[Missing]:
    """Yield what the images of a camera lack.

    Args:
        name: of the camera.
        camera: what was measured.
        white: level of the white of the pattern, median over the images.
        pattern: that was looked for.
        instead: the pattern that the images show, where it is not that one.
    """
    if camera.fault:
        yield Missing(f"'{name}' cannot be read", camera.fault, YOUR_DATA)
    if camera.other_size:
        what = f"'{name}' has images of {camera.width} x {camera.height} and of {camera.other_size} pixels"
        yield Missing(what, "record one size: another one is another camera")
    if not camera.looked_at:
        return
    seen, of = camera.with_pattern, f"of {camera.looked_at} images of '{name}'"
    if not seen:
        found = "no known pattern is" if pattern is None else f"the pattern ({pattern}) is not"
        found += f" in any {of}" + (f", but {instead}" if instead else "")
        yield Missing(found, "show the whole board, large and sharp; or describe it (--pattern)")
    elif seen < MIN_SEEN * camera.looked_at:
        yield Missing(f"the pattern is in {seen} {of}", "keep the board in view while you record")
    if camera.images < MIN_POSES:
        yield Missing(f"'{name}' has {camera.images} images, of {MIN_POSES} at least", "take 15 to 30 poses")
    if seen and len(camera.cells) < MIN_CELLS:
        what = f"'{name}' sees the pattern in {len(camera.cells)} of 12 parts of its image"
        yield Missing(what, "move the board to every part of the image, its corners too")
    if camera.blur_px is not None and camera.blur_px > MAX_BLUR_PX:
        what = f"'{name}' is blurred by {camera.blur_px:.1f} px, more than {MAX_BLUR_PX:g}"
        yield Missing(what, "focus at the board's distance, fix the focus, and expose briefly")
    if white < MIN_WHITE:
        yield Missing(f"'{name}' is dark, its white at {white:.0f} of 255", "more light, or a longer exposure")
    if seen and camera.saturated > MAX_SATURATED:
        what = f"'{name}' has {camera.saturated:.0%} of saturated pixels on the pattern"
        yield Missing(what, "expose less, so that the white of the board is below 255")
    if camera.compared and camera.still < MIN_STILL * camera.compared:
        what = f"the pattern moves in {camera.compared - camera.still} of {camera.compared} images of '{name}'"
        yield Missing(what, "stop for half a second at each pose: a moving corner smears")


def look(recording: Path, pattern: Path | None = None) -> LookResults:
    """Look at a recording: a bag, a folder of images or of folders of them, a video, or an import.yml.

    Args:
        recording: the recording.
        pattern: import.yml that describes the pattern; by default the recording, or whatever is found in the images.

    Raises:
        InputError: it is none of them, or damaged.
    """
    described = read_description(recording) if recording.suffix.lower() in (".yml", ".yaml") else None
    with_pattern = read_description(pattern) if pattern else described
    looked_for = described_pattern(with_pattern) if with_pattern else None
    if described is not None and described.bags is not None:
        seen = _look_at_bag(described.bags.files, described)
    elif recording.suffix.lower() in BAG_ENDINGS or (recording / "metadata.yaml").is_file():
        seen = _look_at_bag([recording], None)
    else:
        seen = _look_at_files(described_images(described) if described else images_at(recording), described)
    lines, cameras = list(seen.missing), {}
    for name, source in seen.images.items():
        own = sample(source)
        looked_for = looked_for or pattern_in(own.images)
        cameras[name], white = _look_at_camera(source, own, looked_for, seen.intrinsics.get(name, "none"))
        other = None if cameras[name].with_pattern or with_pattern is None else pattern_in(own.images)
        sought, instead = looked_for.name if looked_for else None, other.name if other else None
        lines += missing_in_images(name, cameras[name], white, sought, instead)
    return LookResults(
        str(recording),
        looked_for.name if looked_for else None,
        seen.topics,
        seen.frames,
        cameras,
        tuple(sorted(lines, key=lambda each: not each.is_needed)),
    )


@dataclass(frozen=True, eq=False)
class _Seen:
    """What is known of a recording before an image is decoded."""

    images: Mapping[str, ImageSource]
    intrinsics: Mapping[str, str]
    """In words, by camera."""
    topics: Mapping[str, TopicSummary] = field(default_factory=dict)
    frames: FramesSummary | None = None
    missing: Sequence[Missing] = ()


def _look_at_bag(files: Sequence[Path], described: ImportDescription | None) -> _Seen:
    with open_bag(files) as bag:
        content = read_content(bag, described)
        no_camera = "" if content.cameras else no_images(bag)
    patterns = described.patterns if described else ()
    frames = frames_summary(content, [each.parent for each in patterns if each.parent])
    only_intrinsics = described is not None and not any(each.parent or each.fixed for each in patterns)
    images = {
        each.name: topic_images(files, topic, content.times[topic].recorded, content.key_frames)
        for each in content.cameras
        if content.types.get(topic := each.topic or "") in IMAGE_TYPES and content.times[topic].recorded
        if not (is_depth(topic) if each.modality is None else each.modality == "depth")
    }
    missing = missing_in_bag(content, frames, no_camera, only_intrinsics)
    topics = {topic: content.times[topic].summary(kind) for topic, kind in content.types.items()}
    return _Seen(images, content.intrinsics, topics, frames, list(missing))


def _look_at_files(images: Mapping[str, ImageSource], described: ImportDescription | None) -> _Seen:
    sensors = described.sensors if described else ()
    return _Seen(images, {each.name: each.intrinsics.name for each in sensors if each.intrinsics})


def _look_at_camera(
    source: ImageSource, own: Sample, pattern: LookedFor | None, intrinsics: str
) -> tuple[CameraSummary, float]:
    """Return what is measured on a camera's images, and the median level of white."""
    each = [measured(image, pattern) for image in own.images]
    seen = [one for one in each if len(one.corners.ids)]
    height, width = own.images[0].shape if own.images else (0, 0)
    judged = seen or each
    blurs = [one.blur_px for one in judged if one.blur_px is not None]
    compared = [is_still(each[i].corners, each[j].corners) for i, j in own.pairs]
    summary = CameraSummary(
        place=source.place,
        images=source.count,
        looked_at=len(each),
        width=width,
        height=height,
        intrinsics=intrinsics,
        brightness=_median_or_zero([one.brightness for one in each]),
        saturated=round(_median_or_zero([one.saturated for one in judged]), 4),
        blur_px=round(_median_or_zero(blurs), 2) if blurs else None,
        with_pattern=len(seen),
        cells=tuple(image_cells(width, height, [one.corners for one in seen])),
        compared=sum(found is not None for found in compared),
        still=sum(found is True for found in compared),
        other_size=own.other_size,
        fault=own.fault,
    )
    return summary, _median_or_zero([one.white for one in judged])


def _median_or_zero(values: Sequence[float]) -> float:
    return float(np.median(values)) if values else 0.0
