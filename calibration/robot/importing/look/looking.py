"""Looks at a recording before anything of it is described."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from calibration.robot.importing.bags.bag import BAG_ENDINGS, open_bag
from calibration.robot.importing.bags.survey import IMAGE_TYPES, is_depth, no_images
from calibration.robot.importing.description import ImportDescription
from calibration.robot.importing.importing import read_description
from calibration.robot.importing.look.images import Sample, is_still, measured, sample
from calibration.robot.importing.look.missing import missing_in_bag, missing_in_images
from calibration.robot.importing.look.patterns import LookedFor, described_pattern, pattern_in
from calibration.robot.importing.look.results import CameraSummary, FramesSummary, LookResults, Missing, TopicSummary
from calibration.robot.importing.look.sources import ImageSource, described_images, images_at, topic_images
from calibration.robot.importing.look.topics import frames_summary, read_content
from calibration.robot.simulation.collection.record import image_cells


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
