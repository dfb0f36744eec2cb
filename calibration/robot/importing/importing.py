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
from calibration.engine.dataset.configuration import PatternConfiguration
from calibration.engine.dataset.modalities import POSE
from calibration.engine.dataset.model import Edge
from calibration.engine.dataset.reading import FILE_NAME, read_dataset
from calibration.engine.dataset.writing import write_document
from calibration.engine.geometry.cameras import Camera
from calibration.robot.importing.bags import recordings
from calibration.robot.importing.bags.bag import Bag, open_bag
from calibration.robot.importing.bags.motion import MotionLog, MovingBoards
from calibration.robot.importing.bags.range_views import LabelledRange, RangeView
from calibration.robot.importing.bags.stillness import BagImage, BagMoment
from calibration.robot.importing.bags.survey import Survey, survey
from calibration.robot.importing.bags.video_packets import ImageReader
from calibration.robot.importing.cloud_files import CLOUD_ENDINGS, cloud_view
from calibration.robot.importing.description import (
    Bags,
    ImportDescription,
    MomentChoice,
    Videos,
    with_sides,
)
from calibration.robot.importing.document import Imported, data_file, dataset_document
from calibration.robot.importing.files.camera_files import KnownLens, known_model, read_lens
from calibration.robot.importing.files.pictures import Moment, Pictures, find_pictures, moments_of
from calibration.robot.importing.files.samples import Sample, read_samples, same_numbers
from calibration.robot.importing.image_views import LabelledMoment, View, check_copies, contact_sheet, view_of_file
from calibration.robot.importing.mounting import Mounting, described_mounting, recorded_mounting
from calibration.robot.importing.recorded import Recorded, best_moments, check_seen, check_views, imported_moments
from calibration.robot.importing.results import ImportResults, LeftOut, RejectedView, SensorResult
from calibration.robot.importing.videos import extracted_frames, frame_tasks, survey_videos
from calibration.robot.labelling.detection import Image, NotDetected
from calibration.robot.labelling.points import PatternPoints
from calibration.robot.simulation.dataset_folder import refuse_existing, replacing_dataset
from calibration.robot.simulation.record import CONTACT_SHEET_FILE as SHEET

BagImages = Mapping[str, Sequence[BagImage]]
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
    mounted = described_mounting(described, {}, POSE)
    (sensor, *other), (pattern, *more) = described.sensors, mounted.configuration.patterns
    if other or more or described.samples is None:
        raise InputError(
            f"{samples[0].where}: has poses of one pattern before one sensor, found {len(described.sensors)} sensors "
            f"and {len(described.patterns)} patterns in the description"
        )
    if sensor.intrinsics is not None:
        raise InputError(f"{samples[0].where}: found poses, no images: leave out 'intrinsics' of '{sensor.name}'")
    arm = {(described.samples.base, described.samples.tool): np.stack([each.T_base_tool for each in samples])}
    imported = Imported(
        robot=robot,
        configuration=mounted.configuration,
        cameras={},
        estimated={},
        moments=[LabelledMoment({}) for _ in samples],
        ranges=[{} for _ in samples],
        transforms=mounted.placed(arm, len(samples)),
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


def _from_images(described: ImportDescription, lenses: Mapping[str, KnownLens]) -> _Source:
    mounted = described_mounting(described, lenses)
    sensors = mounted.configuration.sensors
    moments, transforms, left_out = _moments_and_transforms(described, mounted, _pictures_of(described))
    detectors = mounted.detectors

    def label(moment: Moment) -> LabelledMoment:
        images = {name: file for name, file in moment.files.items() if sensors[name].has_corners}
        return LabelledMoment({name: view_of_file(file, detectors) for name, file in images.items()})

    def finish(seen: Sequence[LabelledMoment], folder: Path, _: int | None) -> Recorded:
        for name in sensors:
            check_copies(name, [moment.views[name] for moment in seen if name in moment.views])
        ranges: list[dict[str, RangeView]] = []
        for i, (moment, labelled) in enumerate(zip(moments, seen, strict=True)):
            is_seen = any(view.labelled for view in labelled.views.values())
            clouds = {name: file for name, file in moment.files.items() if is_seen and not sensors[name].has_corners}
            stems = {name: folder / f"{name.replace('/', '_')}_{i}" for name in clouds}
            ranges.append({name: cloud_view(file, stems[name]) for name, file in clouds.items()})
        recorded = _recorded_images(mounted, moments, seen, transforms)
        return replace(recorded, ranges=ranges, left_out=tuple(left_out))

    return _Source(
        _hash_of_label_inputs(
            mounted.configuration.patterns, [path for moment in moments for path in moment.files.values()]
        ),
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
    mounted = described_mounting(described, lenses)
    moments, transforms, _ = _moments_and_transforms(described, mounted, pictures)
    seen = [LabelledMoment({name: views[file] for name, file in moment.files.items()}) for moment in moments]
    return _recorded_images(mounted, moments, seen, transforms)


def _recorded_images(
    mounted: Mounting, moments: Sequence[Moment], seen: Sequence[LabelledMoment], transforms: Mapping[Edge, Array]
) -> Recorded:
    lag = max(moment.lag for moment in moments)
    return Recorded(mounted.configuration, mounted.lenses, seen, transforms, rough=True, searched=len(seen), lag=lag)


def _chosen_moments(
    choice: MomentChoice, images: BagImages, mounted: Mounting, log: MotionLog, where: str
) -> tuple[list[BagMoment], Recorded]:
    """Return the best moments, and the cameras' data of them, without image files."""
    every = recordings.chosen_moments(choice, images, log, mounted.edges, where)
    moments, evenly = best_moments(every, choice.most, partial(mounted.recorded, log=log))
    log.left_out.add(f"more than {choice.most} moments ('most')", "moments", count=len(every) - len(moments))
    return moments, replace(mounted.recorded(moments, log), searched=len(every), evenly=evenly)


def _check_patterns_seen(mounted: Mounting, images: BagImages, read: Callable[[str, int], Image]) -> None:
    """Refuse a camera that sees no pattern; ``read`` returns an image by what locates it."""
    for name, own in images.items():
        recorded = [image.recorded for image in own]
        image_of = partial(_image_of, read, name, recorded)
        check_seen(name, mounted.configuration.patterns, [image.view for image in own], image_of)


def _image_of(read: Callable[[str, int], Image], name: str, recorded: Sequence[int], position: int) -> Image:
    return read(name, recorded[position])


def _from_videos(described: ImportDescription, lenses: Mapping[str, KnownLens]) -> _Source:
    mounted, sampled = described_mounting(described, lenses), described.videos or Videos()
    videos = survey_videos(described.sensors)

    def finish(seen: Sequence[recordings.SeenImages], folder: Path, jobs: int | None) -> Recorded:
        images = recordings.images_by_camera({name: video.stamps for name, video in videos.items()}, seen)
        _check_patterns_seen(mounted, images, lambda name, number: videos[name].frame(number))
        log, where = MotionLog(), ", ".join(str(each.path) for each in videos.values())
        moments, recorded = _chosen_moments(sampled.moments, images, mounted, log, where)
        return replace(
            recorded,
            moments=extracted_frames(videos, moments, folder, jobs),
            left_out=log.left_out.results(),
            boards=None if sampled.moments.only_standstill else MovingBoards(images, moments),
        )

    files = [path for video in videos.values() for path in video.files]
    identity_of = _hash_of_label_inputs(mounted.configuration.patterns, files, str(sampled.step))
    tasks = frame_tasks(videos, sampled.step, mounted.detectors)
    return _Source(identity_of, tasks, recordings.decoded_images, finish)


@dataclass(frozen=True, eq=False)
class SurveyedBag:
    """Bag after its first pass: sensors, frames, and what has moved."""

    found: Survey
    mounted: Mounting

    def recorded(self, moments: Sequence[BagMoment]) -> Recorded:
        """Return the cameras' data of some moments, without image files."""
        return self.mounted.recorded(moments, self.found.log)


def surveyed_bag(bag: Bag, described: ImportDescription, lenses: Mapping[str, KnownLens]) -> SurveyedBag:
    """Survey a bag, and place its sensors.

    Args:
        bag: the bag.
        described: the import; it names the bag.
        lenses: known intrinsics.

    Raises:
        InputError: a topic or a frame is missing or wrong, see `survey` and `recorded_mounting`.
    """
    found = survey(bag, described)
    return SurveyedBag(found, recorded_mounting(described, lenses, found))


def _from_bags(bag: Bag, bags: Bags, described: ImportDescription, lenses: Mapping[str, KnownLens]) -> _Source:
    surveyed = surveyed_bag(bag, described, lenses)
    found, mounted, reader = surveyed.found, surveyed.mounted, ImageReader(bag, surveyed.found.key_frames)

    def finish(seen: Sequence[recordings.SeenImages], folder: Path, jobs: int | None) -> Recorded:
        images = recordings.images_by_camera({name: camera.stamps for name, camera in found.cameras.items()}, seen)
        _check_patterns_seen(
            mounted, images, lambda name, at: recordings.image_at(bag, found.cameras[name].topic, at, reader)
        )
        rejected = recordings.images_without_pattern(found, images, found.log)
        moments, recorded = _chosen_moments(bags.moments, images, mounted, found.log, str(bags.files[0]))
        motions = mounted.motions(found.log, [moment.time for moment in moments])
        boards = MovingBoards(images, moments, mounted.edges, motions)
        return replace(
            recorded,
            motions=motions,
            moments=recordings.extracted_images(bag, found, moments, folder, jobs),
            boards=None if bags.moments.only_standstill else boards,
            ranges=recordings.extracted_ranges(bag, found, moments, folder),
            rejected=rejected,
            left_out=found.log.left_out.results(),
            notes=(f"the robot description is left out: {fault}",) if (fault := found.log.robot_fault) else (),
        )

    files = [path for each in bags.files for path in ([each] if each.is_file() else each.iterdir())]
    identity_of = _hash_of_label_inputs(mounted.configuration.patterns, files)
    return _Source(
        identity_of, recordings.detection_tasks(bag, found, mounted.detectors), recordings.decoded_images, finish
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


def _pictures_of(described: ImportDescription) -> list[Pictures]:
    """Return the images of the cameras and the clouds of the LiDARs."""
    pictures = [find_pictures(each.name, each.images) for each in described.sensors if each.images]
    return pictures + [
        find_pictures(each.name, each.clouds, CLOUD_ENDINGS, "point cloud") for each in described.sensors if each.clouds
    ]


def _moments_and_transforms(
    described: ImportDescription, mounted: Mounting, pictures: Sequence[Pictures]
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
    return moments, mounted.placed(arm, len(moments)), left_out


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
