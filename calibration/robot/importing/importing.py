"""Import of a recording as a dataset: associates the data, labels them, and writes them."""

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from calibration import __version__
from calibration.base import InputError, link_or_copy, read_yaml, write_atomically
from calibration.base.arrays import Array
from calibration.base.records import read, text_of
from calibration.ci.execution.tasks import Task, identity, run_tasks, workspace
from calibration.engine.dataset.configuration import Configuration, PatternConfiguration, SensorConfiguration
from calibration.engine.dataset.modalities import LIDAR3D, POSE, RGB, Modality
from calibration.engine.dataset.model import Edge
from calibration.engine.dataset.reading import FILE_NAME, read_dataset
from calibration.engine.dataset.writing import write_document
from calibration.engine.geometry.cameras import Camera
from calibration.engine.geometry.frames import FrameTree
from calibration.robot.importing.bags import recordings
from calibration.robot.importing.bags.bag import Bag, open_bag
from calibration.robot.importing.bags.motion import MotionLog, MovingBoards
from calibration.robot.importing.bags.range_views import LabelledRange, RangeView
from calibration.robot.importing.bags.stillness import BagMoment
from calibration.robot.importing.bags.survey import Survey, survey
from calibration.robot.importing.bags.video_packets import ImageReader
from calibration.robot.importing.cloud_files import CLOUD_ENDINGS, cloud_view
from calibration.robot.importing.description import (
    Bags,
    ImportDescription,
    SensorDescription,
    Videos,
    body_edges,
    carriers,
    moving_bodies,
    with_sides,
)
from calibration.robot.importing.document import Imported, data_file, dataset_document
from calibration.robot.importing.files.camera_files import KnownLens, known_model, read_lens, with_baselines
from calibration.robot.importing.files.pictures import Moment, Pictures, find_pictures, moments_of
from calibration.robot.importing.files.samples import Sample, read_samples, same_numbers
from calibration.robot.importing.files.target_files import pattern_configuration
from calibration.robot.importing.image_views import LabelledMoment, View, check_copies, contact_sheet, view_of_file
from calibration.robot.importing.near_miss import check_told_apart
from calibration.robot.importing.recorded import Recorded, best_moments, check_seen, check_views, imported_moments
from calibration.robot.importing.results import ImportResults, LeftOut, RejectedView, SensorResult
from calibration.robot.importing.videos import extracted_frames, frame_tasks, survey_videos
from calibration.robot.labelling.corner_detector import corner_detector
from calibration.robot.labelling.detection import NotDetected
from calibration.robot.labelling.points import PatternPoints
from calibration.robot.simulation.dataset_folder import refuse_existing, replacing_dataset
from calibration.robot.simulation.record import CONTACT_SHEET_FILE as SHEET

Done = Callable[[int, int, LabelledMoment | recordings.SeenImages], None]
"""Callback after each part: number of finished parts, number of all parts, and the result."""


def read_description(path: Path) -> ImportDescription:
    """Read import.yml.

    Raises:
        InputError: it cannot be read, or something in it is missing or wrong.
    """
    described = read(ImportDescription, read_yaml(path, "the description of an import"), str(path), path.parent)
    return with_sides(described)


def import_data(
    config: Path, output: Path, overwrite: bool = False, jobs: int | None = None, done: Done = lambda *_: None
) -> ImportResults:
    """Import a described recording into a folder.

    An interrupted import leaves no partial dataset, and the same call continues it.

    Args:
        config: import.yml.
        output: the folder of the dataset.
        overwrite: whether an existing dataset is replaced.
        jobs: number of processes; None for one per core.
        done: called after each moment; first for those already finished.

    Raises:
        InputError: an input is missing or wrong, or inconsistent with the others.
        InfrastructureError: a file cannot be written, or a process died.
    """
    refuse_existing(output, overwrite)
    described = read_description(config)
    robot = described.robot or config.resolve().parent.name
    lenses, models = described_lenses(config, described)
    if described.samples is not None and not any(each.images for each in described.sensors):
        samples = read_samples(described.samples, described.in_hand)
        if not any(each.image for each in samples) and samples[0].T_camera_pattern is not None:
            return _import_poses(described, robot, samples, output, overwrite)
    check_printed_patterns(config, described)
    with (
        _opened_source(described, lenses) as source,
        workspace(output, source.identity, text_of, source.decode) as work,
    ):
        tasks = [work.keeping(task) for task in source.tasks]
        seen = list(run_tasks(tasks, workers=jobs, find=work.find, done=done).values())
        recorded = replace(source.finish(seen, work.folder, jobs), models=models)
        check_views(recorded)
        imported = imported_moments(robot, recorded)
        write_dataset(imported, output, overwrite)
    return _import_results(imported, recorded)


def described_lenses(config: Path, described: ImportDescription) -> tuple[dict[str, KnownLens], dict[str, str]]:
    """Return the known intrinsics, and the lens models that are chosen for the others, by camera.

    Raises:
        InputError: a file of intrinsics or the name of a model is wrong.
    """
    cameras = described.sensors
    lenses = {
        each.name: read_lens(each.intrinsics, each.camera, each.model, each.distortion)
        for each in cameras
        if each.intrinsics
    }
    models = {each.name: known_model(config, each.model) for each in cameras if each.model and not each.intrinsics}
    return lenses, models


def check_printed_patterns(config: Path, described: ImportDescription) -> None:
    """Refuse patterns that cannot be detected in images.

    Raises:
        InputError: names the first.
    """
    for pattern in described.patterns:
        if not pattern.is_printed:
            raise InputError(f"{config}: patterns/{pattern.name}: missing key 'type', or 'target': images are given")


def write_dataset(imported: Imported, output: Path, overwrite: bool) -> None:
    """Write a dataset with its images and clouds, and a sheet of them."""
    views = [
        (key, name, view)
        for key, moment in zip(imported.keys, imported.moments, strict=True)
        for name, view in moment.views.items()
    ]
    with replacing_dataset(output, overwrite) as new:
        for key, name, view in views:
            link_or_copy(Path(view.file), new / data_file(name, key, view.file))
        for key, ranges in zip(imported.keys, imported.ranges, strict=True):
            for name, each in ranges.items():
                if each.view.file is not None:
                    link_or_copy(each.view.file, new / data_file(name, key, each.view.file.name))
        shown = [(f"{key} {name}", view) for key, name, view in views]
        write_atomically(new / SHEET, contact_sheet(shown, imported.configuration.patterns))
        write_document(dataset_document(imported), new / FILE_NAME)
        read_dataset(new)


def _import_poses(
    described: ImportDescription,
    robot: str,
    samples: Sequence[Sample],
    output: Path,
    overwrite: bool,
) -> ImportResults:
    """Import pairs of poses, of an arm and of the pattern measured by a camera."""
    patterns = pattern_configurations(described)
    (sensor, *other), (pattern, *more) = described.sensors, patterns
    if other or more or described.samples is None:
        raise InputError(
            f"{samples[0].where}: has poses of one pattern before one sensor, found {len(described.sensors)} sensors "
            f"and {len(patterns)} patterns in the description"
        )
    if sensor.intrinsics is not None:
        raise InputError(f"{samples[0].where}: found poses, no images: leave out 'intrinsics' of '{sensor.name}'")
    configuration = _calibration_configuration(described, patterns, POSE)
    arm = {(described.samples.base, described.samples.tool): np.stack([each.T_base_tool for each in samples])}
    imported = Imported(
        robot=robot,
        configuration=configuration,
        cameras={},
        estimated={},
        moments=[LabelledMoment({}) for _ in samples],
        ranges=[{} for _ in samples],
        transforms=_with_known_patterns(_tree_of_frames(configuration, arm, len(samples)), described, configuration),
        rough=True,
        poses={(sensor.name, pattern): np.stack([T for s in samples if (T := s.T_camera_pattern) is not None])},
    )
    with replacing_dataset(output, overwrite) as new:
        write_document(dataset_document(imported), new / FILE_NAME)
        read_dataset(new)
    N = len(samples)
    found = SensorResult(images=N, labelled=N, corners=0, intrinsics="none", camera={})
    return ImportResults(robot, N, N, N, 0, 0.0, {sensor.name: found})


@dataclass(frozen=True, eq=False)
class _Source:
    """Recording to process, in parts."""

    identity: str
    """Hash of the inputs of the labels."""
    tasks: Sequence[Task[Any]]
    decode: Callable[[bytes], Any]
    """Function that decodes a stored part."""
    finish: Callable[[Sequence[Any], Path, int | None], Recorded]
    """Function that returns the moments of all parts; images from a bag are written into a folder by this many
    processes."""


@contextmanager
def _opened_source(described: ImportDescription, lenses: Mapping[str, KnownLens]) -> Iterator[_Source]:
    """Return the images of a description; a bag is open as long as they are read."""
    if described.bags is not None:
        with open_bag(described.bags.files) as bag:
            yield _from_bags(bag, described.bags, described, lenses)
    else:
        yield (_from_videos if described.has_videos else _from_images)(described, lenses)


def pattern_configurations(described: ImportDescription, root: str | None = None) -> dict[str, PatternConfiguration]:
    """Return the patterns by name.

    Raises:
        InputError: a description is wrong, or two cannot be told apart.
    """
    bodies = [each.name for each in described.bodies]
    patterns = {
        each.name: replace(
            pattern_configuration(each, described.root, root),
            known_pose=each.pose is not None and each.parent in bodies,
        )
        for each in described.patterns
    }
    check_told_apart(patterns)
    return patterns


def _from_images(described: ImportDescription, lenses: Mapping[str, KnownLens]) -> _Source:
    patterns = pattern_configurations(described)
    configuration = _calibration_configuration(described, patterns)
    pictures = _pictures_of(described)
    moments, transforms, left_out = _moments_and_transforms(described, configuration, pictures)
    detectors = {name: corner_detector(pattern) for name, pattern in patterns.items()}

    def label(moment: Moment) -> LabelledMoment:
        images = {name: file for name, file in moment.files.items() if configuration.sensors[name].has_corners}
        return LabelledMoment({name: view_of_file(file, detectors) for name, file in images.items()})

    def finish(seen: Sequence[LabelledMoment], folder: Path, _: int | None) -> Recorded:
        for name in configuration.sensors:
            check_copies(name, [moment.views[name] for moment in seen if name in moment.views])
        ranges = [
            _clouds_of_moment(moment, i, folder, configuration)
            if any(view.labelled for view in labelled.views.values())
            else {}
            for i, (moment, labelled) in enumerate(zip(moments, seen, strict=True))
        ]
        recorded = _recorded_images(described, configuration, lenses, moments, seen, transforms)
        return replace(recorded, ranges=ranges, left_out=tuple(left_out))

    return _Source(
        _hash_of_label_inputs(patterns, [path for moment in moments for path in moment.files.values()]),
        [Task.call(f"{i}", partial(label, each)) for i, each in enumerate(moments)],
        lambda text: read(LabelledMoment, json.loads(text), "a finished moment"),
        finish,
    )


def recorded_views(
    described: ImportDescription,
    lenses: Mapping[str, KnownLens],
    pictures: Sequence[Pictures],
    views: Mapping[Path, View],
) -> Recorded:
    """Return what was recorded by cameras whose images are labelled already.

    Args:
        described: the description of the cameras and patterns.
        lenses: known intrinsics.
        pictures: images of each camera, sorted by number.
        views: the labels of each of them.

    Raises:
        InputError: images of the cameras do not belong together, or not to the samples.
    """
    configuration = _calibration_configuration(described, pattern_configurations(described))
    moments, transforms, _ = _moments_and_transforms(described, configuration, pictures)
    seen = [LabelledMoment({name: views[file] for name, file in moment.files.items()}) for moment in moments]
    return _recorded_images(described, configuration, lenses, moments, seen, transforms)


def _recorded_images(
    described: ImportDescription,
    configuration: Configuration,
    lenses: Mapping[str, KnownLens],
    moments: Sequence[Moment],
    seen: Sequence[LabelledMoment],
    transforms: Mapping[Edge, Array],
) -> Recorded:
    known = _given_poses(described, configuration, 1)
    placed = with_baselines(_with_known_patterns(transforms, described, configuration), configuration, lenses, known)
    lag = max(moment.lag for moment in moments)
    return Recorded(configuration, lenses, seen, placed, rough=True, searched=len(seen), lag=lag)


def _from_videos(described: ImportDescription, lenses: Mapping[str, KnownLens]) -> _Source:
    patterns = pattern_configurations(described)
    configuration, sampled = _calibration_configuration(described, patterns), described.videos or Videos()
    chosen = sampled.moments
    videos = survey_videos(described.sensors)
    detectors = {name: corner_detector(pattern) for name, pattern in patterns.items()}

    def finish(seen: Sequence[recordings.SeenImages], folder: Path, jobs: int | None) -> Recorded:
        images = recordings.images_by_camera({name: video.stamps for name, video in videos.items()}, seen)
        for name, own in images.items():
            video, frames = videos[name], [image.recorded for image in own]
            check_seen(
                name,
                patterns,
                [image.view for image in own],
                lambda i, video=video, frames=frames: video.frame(frames[i]),  # type: ignore[misc]
            )

        def of_cameras(some: Sequence[BagMoment]) -> Recorded:
            """Return the cameras' data of some moments, without image files."""
            views = [LabelledMoment({name: image.view for name, image in each.images.items()}) for each in some]
            given = _given_poses(described, configuration, len(some))
            transforms = _tree_of_frames(configuration, given, len(some))
            placed = with_baselines(
                _with_known_patterns(transforms, described, configuration), configuration, lenses, given
            )
            return Recorded(configuration, lenses, views, placed, rough=True, lag=max(each.lag for each in some))

        log = MotionLog()
        every = recordings.chosen_moments(
            chosen, images, log, (), ", ".join(str(each.path) for each in videos.values())
        )
        moments, evenly = best_moments(every, chosen.most, of_cameras)
        log.left_out.add(f"more than {chosen.most} moments ('most')", "moments", count=len(every) - len(moments))
        return replace(
            of_cameras(moments),
            moments=extracted_frames(videos, moments, folder, jobs),
            searched=len(every),
            evenly=evenly,
            left_out=log.left_out.results(),
            boards=None if chosen.only_standstill else MovingBoards(images, moments),
        )

    return _Source(
        _hash_of_label_inputs(patterns, [path for video in videos.values() for path in video.files], str(sampled.step)),
        frame_tasks(videos, sampled.step, detectors),
        recordings.decoded_images,
        finish,
    )


def _clouds_of_moment(moment: Moment, number: int, folder: Path, configuration: Configuration) -> dict[str, RangeView]:
    """Return the point clouds of a moment, each as a file in a folder."""
    lidars = {name: file for name, file in moment.files.items() if not configuration.sensors[name].has_corners}
    return {name: cloud_view(file, folder / f"{name.replace('/', '_')}_{number}") for name, file in lidars.items()}


@dataclass(frozen=True, eq=False)
class SurveyedBag:
    """Bag after its first pass: sensors, frames, and what has moved."""

    described: ImportDescription
    """With the root of its frames."""
    patterns: Mapping[str, PatternConfiguration]
    found: Survey
    mounted: recordings.Mounting
    lenses: Mapping[str, KnownLens]
    """Those that are described."""

    def recorded(self, moments: Sequence[BagMoment]) -> Recorded:
        """Return the cameras' data of some moments, without image files."""
        count, times = len(moments), [moment.time for moment in moments]
        configuration, edges = self.mounted.configuration, self.mounted.edges
        of_bag = {
            name: KnownLens(self._first_file, camera.camera, has_size=True)
            for name, camera in self.found.sensors.items()
            if camera.camera is not None
        }
        given = _given_poses(self.described, configuration, count)
        given = {edge: T for edge, T in given.items() if edge not in edges}
        placed = {**self.mounted.transforms(self.found.log, times), **given}
        placed = _with_known_patterns(placed, self.described, configuration)
        return Recorded(
            configuration,
            {**of_bag, **self.lenses},
            [LabelledMoment({name: image.view for name, image in moment.images.items()}) for moment in moments],
            with_baselines(placed, configuration, self.lenses, (*edges, *given)),
            rough=not edges,
            lag=max(moment.lag for moment in moments),
        )

    @property
    def _first_file(self) -> Path:
        if self.described.bags is None:
            raise AssertionError("it is of a bag")
        return self.described.bags.files[0]


def surveyed_bag(bag: Bag, described: ImportDescription, lenses: Mapping[str, KnownLens], where: str) -> SurveyedBag:
    """Survey a bag, and place its sensors.

    Args:
        bag: the bag.
        described: the import.
        lenses: known intrinsics.
        where: the bag, for messages.

    Raises:
        InputError: a topic or a frame is missing or wrong, see `survey` and `mounting`.
    """
    found = survey(bag, described)
    root = recordings.root_of(described, found)
    patterns = pattern_configurations(described, root)
    described = replace(described, world=root)
    return SurveyedBag(described, patterns, found, recordings.mounting(described, patterns, found, where), lenses)


def _from_bags(bag: Bag, bags: Bags, described: ImportDescription, lenses: Mapping[str, KnownLens]) -> _Source:
    where = str(bags.files[0])
    surveyed = surveyed_bag(bag, described, lenses, where)
    patterns, found, mounted = surveyed.patterns, surveyed.found, surveyed.mounted

    def finish(seen: Sequence[recordings.SeenImages], folder: Path, jobs: int | None) -> Recorded:
        images = recordings.images_by_camera({name: camera.stamps for name, camera in found.cameras.items()}, seen)
        for name, own in images.items():
            at = partial(recordings.image_at, bag, found.cameras[name].topic, reader=ImageReader(bag, found.key_frames))
            views, recorded = [image.view for image in own], [image.recorded for image in own]
            check_seen(name, patterns, views, lambda i, at=at, recorded=recorded: at(recorded[i]))  # type: ignore[misc]
        rejected = recordings.images_without_pattern(found, images, found.log)
        every = recordings.chosen_moments(bags.moments, images, found.log, mounted.edges, where)
        moments, evenly = best_moments(every, bags.moments.most, surveyed.recorded)
        found.log.left_out.add(
            f"more than {bags.moments.most} moments ('most')", "moments", count=len(every) - len(moments)
        )
        motions = mounted.motions(found.log, [moment.time for moment in moments])
        boards = MovingBoards(images, moments, mounted.edges, motions)
        return replace(
            surveyed.recorded(moments),
            motions=motions,
            moments=recordings.extracted_images(bag, found, moments, folder, jobs),
            boards=None if bags.moments.only_standstill else boards,
            ranges=recordings.extracted_ranges(bag, found, moments, folder),
            searched=len(every),
            evenly=evenly,
            rejected=rejected,
            left_out=found.log.left_out.results(),
            notes=(f"the robot description is left out: {fault}",) if (fault := found.log.robot_fault) else (),
        )

    return _Source(
        _hash_of_label_inputs(
            patterns, [path for each in bags.files for path in ([each] if each.is_file() else each.iterdir())]
        ),
        recordings.detection_tasks(bag, found, {name: corner_detector(pattern) for name, pattern in patterns.items()}),
        recordings.decoded_images,
        finish,
    )


def _hash_of_label_inputs(patterns: Mapping[str, PatternConfiguration], files: Sequence[Path], choice: str = "") -> str:
    """Return a hash of the inputs of the labels: the patterns, the current files, and the choice of their images.

    Raises:
        InputError: a file does not exist.
    """
    try:
        stats = [(str(path), path.stat().st_size, path.stat().st_mtime_ns) for path in files]
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else error
        name = error.filename if isinstance(error, OSError) else ""
        raise InputError(f"{name}: an image was expected, but it cannot be read: {reason}") from None
    return identity(f"{__version__} {np.__version__} {cv2.__version__} {patterns} {stats} {choice}".encode())


def _calibration_configuration(
    described: ImportDescription, patterns: Mapping[str, PatternConfiguration], modality: Modality = RGB
) -> Configuration:
    """Return the calibration configuration: the pose of each sensor on its parent."""
    sensors = {
        each.name: _sensor_configuration(each, described.root, LIDAR3D if each.clouds else modality)
        for each in described.sensors
    }
    mounted = carriers(described, [pattern.parent_link for pattern in patterns.values() if pattern.fixed])
    if described.samples is not None:
        tool = described.samples.tool
        if tool not in mounted and all(sensor.parent_link != tool for sensor in sensors.values()):
            raise InputError(
                f"samples: neither a sensor nor a pattern is mounted on the tool, '{tool}': give one of them "
                f"'parent: {tool}'"
            )
    moves = described.samples is None and not mounted
    anchored = described.anchored or (next(iter(sensors)) if moves else None)
    return Configuration(
        world_link=described.root,
        sensors=sensors,
        patterns=patterns,
        anchored_sensor=anchored,
        additional_tfs=body_edges(described),
        moving_tfs=moving_bodies(described),
    )


def _sensor_configuration(described: SensorDescription, world: str, modality: Modality) -> SensorConfiguration:
    parent = described.parent or world
    return SensorConfiguration(described.name, modality.name, described.link, parent, described.link)


def _pictures_of(described: ImportDescription) -> list[Pictures]:
    """Return the images of the cameras and the clouds of the LiDARs."""
    pictures = [find_pictures(each.name, each.images) for each in described.sensors if each.images]
    return pictures + [
        find_pictures(each.name, each.clouds, CLOUD_ENDINGS, "point cloud") for each in described.sensors if each.clouds
    ]


def _moments_and_transforms(
    described: ImportDescription, configuration: Configuration, pictures: Sequence[Pictures]
) -> tuple[Sequence[Moment], Mapping[Edge, Array], Sequence[LeftOut]]:
    """Return the images of each moment, the transforms (N, 4, 4) at that time, and what is left out."""
    arm: dict[Edge, Array] = {}
    left_out: Sequence[LeftOut] = ()
    if described.samples is None:
        moments = moments_of(pictures, described.pairs)
    else:
        samples = read_samples(described.samples, described.in_hand)
        moments, samples, left_out = _at_samples(described, pictures, samples)
        arm[described.samples.base, described.samples.tool] = np.stack([each.T_base_tool for each in samples])
    given = _given_poses(described, configuration, len(moments))
    return moments, _tree_of_frames(configuration, {**arm, **given}, len(moments)), left_out


def _given_poses(described: ImportDescription, configuration: Configuration, count: int) -> dict[Edge, Array]:
    """Return ``T_parent_sensor`` (N, 4, 4) of the sensors that have one in the description."""
    return {
        (sensor.parent_link, sensor.child_link): np.broadcast_to(each.pose.transform, (count, 4, 4))
        for each in described.sensors
        if each.pose is not None and (sensor := configuration.sensors[each.name])
    }


def _at_samples(
    described: ImportDescription, pictures: Sequence[Pictures], samples: Sequence[Sample]
) -> tuple[list[Moment], list[Sample], Sequence[LeftOut]]:
    """Return the images of each pose: those that the samples name, of the same numbers, or in the same order."""
    named = [sample for sample in samples if sample.image is not None]
    if named:
        if len(named) < len(samples):
            lacking = next(sample for sample in samples if sample.image is None)
            raise InputError(f"{lacking.where}: found no image, expected one as the other poses have")
        if len(described.sensors) > 1:
            raise InputError(f"{named[0].where}: names one image, expected none where there are several sensors")
        sensor = described.sensors[0].name
        in_folder = {file.name: file for each in pictures for file in each.files}
        files = [(each.where, _image_of_sample(each.image, in_folder)) for each in named if each.image]
        return [Moment(where, {sensor: file}) for where, file in files], named, ()
    if not pictures:
        raise InputError(f"{samples[0].where}: found no image, expected one, or a sensor with a folder: images")
    moments = moments_of(pictures, described.pairs)
    of_moments = [next(iter(moment.files.values())) for moment in moments]
    if paired := same_numbers([each.file for each in samples], of_moments, ("poses", "images")):
        return [moments[i] for _, i in paired[0]], [samples[i] for i, _ in paired[0]], paired[1]
    if len(moments) != len(samples):
        raise InputError(
            f"{pictures[0].place}: found {len(moments)} images, expected {len(samples)}: one for each pose of the "
            "samples"
        )
    return moments, list(samples), ()


def _image_of_sample(named: Path, in_folder: Mapping[str, Path]) -> Path:
    """Return the image that a table of poses names: beside it, or in the folder of the sensor's images."""
    return in_folder.get(named.name, named) if not named.is_file() else named


def _tree_of_frames(configuration: Configuration, arm: Mapping[Edge, Array], count: int) -> dict[Edge, Array]:
    """Return the tree of frames: the arm's known transforms, and the identity for calibrated and auxiliary ones."""
    world = configuration.world_link
    unknown = np.broadcast_to(np.eye(4), (count, 4, 4))
    transforms = dict(arm)
    for sensor in configuration.sensors.values():
        transforms.setdefault((sensor.parent_link, sensor.child_link), unknown)
    for edge in configuration.additional_tfs.values():
        transforms.setdefault(edge, unknown)
    children = {child for _, child in transforms}
    parents = dict.fromkeys(
        [*(parent for parent, _ in transforms), *(pattern.parent_link for pattern in configuration.patterns.values())]
    )
    for frame in parents:
        if frame != world and frame not in children:
            transforms[world, frame] = unknown
    FrameTree(transforms)
    return transforms


def _with_known_patterns(
    transforms: Mapping[Edge, Array], described: ImportDescription, configuration: Configuration
) -> dict[Edge, Array]:
    """Return the transforms (N, 4, 4) with the poses of the patterns that the description states."""
    count = len(next(iter(transforms.values())))
    stated = {each.name: each.pose.transform for each in described.patterns if each.pose is not None}
    known = {
        (pattern.parent_link, pattern.link): np.broadcast_to(stated[name], (count, 4, 4))
        for name, pattern in configuration.patterns.items()
        if name in stated
    }
    return {**transforms, **known}


def _import_results(imported: Imported, recorded: Recorded) -> ImportResults:
    labelled = recorded.moments
    sensors = {}
    for name, configured in imported.configuration.sensors.items():
        if not configured.has_corners:
            sensors[name] = _range_result([each[name] for each in imported.ranges if name in each])
            continue
        views = [moment.views[name] for moment in labelled if name in moment.views]
        unlabelled = [RejectedView(view.file, view.reason) for view in views if not view.labelled]
        corners = sum(len(found.ids) for view in views for found in view.found.values())
        sensors[name] = SensorResult(
            images=len(views),
            labelled=sum(view.labelled for view in views),
            corners=corners,
            intrinsics="estimated" if name in imported.estimated else "given",
            lens=imported.estimated.get(name),
            camera=document_of_camera(imported.cameras[name]),
            rejected=tuple(recorded.rejected.get(name, unlabelled)),
        )
    together = sum(1 for seen in imported.seen if len(seen) > 1)
    lag = round(1e3 * recorded.lag, 3)
    return ImportResults(
        imported.robot,
        recorded.searched,
        len(labelled),
        len(imported.moments),
        together,
        lag,
        sensors,
        recorded.evenly,
        _left_out(imported, recorded),
        recorded.notes,
    )


def _left_out(imported: Imported, recorded: Recorded) -> tuple[LeftOut, ...]:
    """Return what was left out, with the moments at which no camera sees a pattern."""
    unseen = len(recorded.moments) - len(imported.moments)
    rule = LeftOut("no camera sees a pattern then", "moments", unseen)
    return (*recorded.left_out, *([rule] if unseen else []))


def document_of_camera(camera: Camera) -> dict[str, float]:
    """Return the intrinsics by name."""
    return dict(zip(camera.parameters, camera.intrinsics.tolist(), strict=True))


def _range_result(views: Sequence[LabelledRange]) -> SensorResult:
    found = [each for view in views for each in view.found.values()]
    points = [each for each in found if isinstance(each, PatternPoints)]
    missed = [each for each in found if isinstance(each, NotDetected)]
    return SensorResult(
        images=len(views),
        labelled=sum(any(isinstance(each, PatternPoints) for each in view.found.values()) for view in views),
        corners=sum(len(each.on_pattern) for each in points),
        intrinsics="none",
        camera={},
        rejected=tuple(RejectedView("", each.reason) for each in missed),
    )
