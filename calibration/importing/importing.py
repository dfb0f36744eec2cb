"""A recording becomes a dataset: what belongs together is found, labelled, and written."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import cv2
import numpy as np

from calibration import __version__
from calibration.dataset.configuration import Configuration, PatternConfiguration, SensorConfiguration
from calibration.dataset.model import Edge
from calibration.dataset.reading import FILE_NAME, read_dataset
from calibration.dataset.writing import write_document
from calibration.errors import InputError
from calibration.execution.tasks import Task, run_tasks
from calibration.execution.workspace import identity, workspace
from calibration.files import place
from calibration.geometry.cameras import Camera
from calibration.geometry.frames import FrameTree
from calibration.geometry.types import Array
from calibration.importing.camera_files import KnownLens, read_lens
from calibration.importing.description import ImportDescription, SensorDescription
from calibration.importing.document import Imported, data_file, dataset_document
from calibration.importing.looking import LabelledMoment, View, check_copies, check_sizes, look
from calibration.importing.near_miss import check_board, never_seen
from calibration.importing.pictures import Moment, Pictures, find_pictures, moments_of
from calibration.importing.results import ImportResults, RejectedView, SensorResult
from calibration.importing.samples import Sample, read_samples
from calibration.importing.starting_intrinsics import starting_intrinsics
from calibration.importing.target_files import pattern_configuration
from calibration.labelling.corner_detector import corner_detector
from calibration.records import read, text_of
from calibration.simulation.collection.collecting import single_threaded_opencv
from calibration.simulation.collection.dataset_folder import refuse_existing, replacing_dataset
from calibration.yaml_file import read_yaml

Done = Callable[[int, int, LabelledMoment], None]
"""Called after each moment with how many are done, how many there are, and what was found."""


@dataclass(frozen=True, eq=False)
class Recording:
    """What was recorded, before anybody looks at it."""

    moments: Sequence[Moment]
    transforms: Mapping[Edge, Array]
    """(N, 4, 4): of the moments."""


def read_description(path: Path) -> ImportDescription:
    """Read import.yml.

    Raises:
        InputError: it cannot be read, or something in it is missing or wrong.
    """
    return read(ImportDescription, read_yaml(path, "the description of an import"), str(path), path.parent)


def import_data(
    config: Path, output: Path, overwrite: bool = False, jobs: int | None = None, done: Done = lambda *_: None
) -> ImportResults:
    """Import what a file describes into a folder.

    An import that is killed leaves no half dataset, and the same call goes on where it was.

    Args:
        config: import.yml.
        output: the folder of the dataset.
        overwrite: whether a dataset that it has is replaced.
        jobs: processes; None for one a core.
        done: called after each moment; first for those that were done before.

    Raises:
        InputError: something that was given is missing or wrong, or does not fit the rest.
        WorldError: a file cannot be written, or a process died.
    """
    refuse_existing(output, overwrite)
    described = read_description(config)
    robot = described.robot or config.resolve().parent.name
    patterns = {each.name: pattern_configuration(each, described.world) for each in described.patterns}
    detectors = {name: corner_detector(pattern) for name, pattern in patterns.items()}
    lenses = {each.name: read_lens(each.intrinsics, each.camera) for each in described.sensors if each.intrinsics}
    configuration = _configuration(described, patterns)
    recording = _recording(described, configuration)
    with workspace(output, _identity(patterns, recording), text_of, _decoded) as work, single_threaded_opencv():

        def label(moment: Moment) -> LabelledMoment:
            return LabelledMoment({name: look(file, detectors) for name, file in moment.files.items()})

        tasks = [work.keeping(Task.call(f"{i}", partial(label, each))) for i, each in enumerate(recording.moments)]
        labelled = list(run_tasks(tasks, workers=jobs, find=work.find, done=done).values())
        imported = _imported(robot, configuration, lenses, labelled, recording)
        with replacing_dataset(output, overwrite) as new:
            for key, moment in zip(imported.keys, imported.moments, strict=True):
                for name, view in moment.views.items():
                    place(Path(view.file), new / data_file(name, key, view.file))
            write_document(dataset_document(imported), new / FILE_NAME)
            read_dataset(new)
    return _results(imported, labelled)


def _decoded(text: bytes) -> LabelledMoment:
    import json

    return read(LabelledMoment, json.loads(text), "a finished moment")


def _identity(patterns: Mapping[str, PatternConfiguration], recording: Recording) -> str:
    """What the labels depend on: the patterns, and the images as they are now."""
    files = [path for moment in recording.moments for path in moment.files.values()]
    stats = [(str(path), path.stat().st_size, path.stat().st_mtime_ns) for path in files]
    return identity(f"{__version__} {np.__version__} {cv2.__version__} {patterns} {stats}".encode())


def _configuration(described: ImportDescription, patterns: Mapping[str, PatternConfiguration]) -> Configuration:
    """What is calibrated: the pose of each sensor on its parent."""
    sensors = {each.name: _sensor(each, described.world) for each in described.sensors}
    mounted = {pattern.parent_link for pattern in patterns.values() if pattern.fixed}
    if described.samples is not None:
        tool = described.samples.tool
        if tool not in mounted and all(sensor.parent_link != tool for sensor in sensors.values()):
            raise InputError(
                f"samples: neither a sensor nor a pattern is mounted on the tool, '{tool}': give one of them "
                f"'parent: {tool}'"
            )
    moves = described.samples is None and not mounted
    anchored = described.anchored or (next(iter(sensors)) if moves else None)
    return Configuration(world_link=described.world, sensors=sensors, patterns=patterns, anchored_sensor=anchored)


def _sensor(described: SensorDescription, world: str) -> SensorConfiguration:
    parent = described.parent or world
    return SensorConfiguration(described.name, "rgb", described.link, parent, described.link)


def _recording(described: ImportDescription, configuration: Configuration) -> Recording:
    pictures = [find_pictures(each.name, each.images) for each in described.sensors if each.images]
    arm: dict[Edge, Array] = {}
    if described.samples is None:
        moments = moments_of(pictures, described.pairs)
    else:
        samples = read_samples(described.samples.file)
        moments, samples = _at_samples(described, pictures, samples)
        arm[described.samples.base, described.samples.tool] = np.stack([each.T_base_tool for each in samples])
    return Recording(moments, _transforms(configuration, arm, len(moments)))


def _at_samples(
    described: ImportDescription, pictures: Sequence[Pictures], samples: Sequence[Sample]
) -> tuple[list[Moment], list[Sample]]:
    """The images that belong to each pose: those that the samples name, else as many in the same order."""
    named = [sample for sample in samples if sample.image is not None]
    if named:
        if len(named) < len(samples):
            lacking = next(sample for sample in samples if sample.image is None)
            raise InputError(f"{lacking.where}: found no image, expected one as the other poses have")
        if len(described.sensors) > 1:
            raise InputError(f"{named[0].where}: names one image, expected none where there are several sensors")
        sensor = described.sensors[0].name
        return [Moment(each.where, {sensor: each.image}) for each in named if each.image], named
    if not pictures:
        raise InputError(f"{samples[0].where}: found no image, expected one, or a sensor with a folder: images")
    moments = moments_of(pictures, described.pairs)
    if len(moments) != len(samples):
        raise InputError(
            f"{pictures[0].place}: found {len(moments)} images, expected {len(samples)}: one for each pose of the "
            "samples"
        )
    return moments, list(samples)


def _transforms(configuration: Configuration, arm: Mapping[Edge, Array], count: int) -> dict[Edge, Array]:
    """The tree of frames: what is known of the arm, and the identity for what is calibrated or just a name."""
    world = configuration.world_link
    unknown = np.broadcast_to(np.eye(4), (count, 4, 4))
    transforms = dict(arm)
    for sensor in configuration.sensors.values():
        transforms.setdefault((sensor.parent_link, sensor.child_link), unknown)
    children = {child for _, child in transforms}
    parents = dict.fromkeys(
        [*(parent for parent, _ in transforms), *(pattern.parent_link for pattern in configuration.patterns.values())]
    )
    for frame in parents:
        if frame != world and frame not in children:
            transforms[world, frame] = unknown
    FrameTree(transforms)
    return transforms


def _imported(
    robot: str,
    configuration: Configuration,
    lenses: Mapping[str, KnownLens],
    labelled: Sequence[LabelledMoment],
    recording: Recording,
) -> Imported:
    """The collections: moments in which at least one sensor sees a pattern.

    Raises:
        InputError: the images of a camera do not fit together, or its intrinsics; it sees a pattern nowhere; or what
            it sees gives no intrinsics.
    """
    cameras: dict[str, Camera] = {}
    for name in configuration.sensors:
        views = [moment.views[name] for moment in labelled if name in moment.views]
        if not views:
            raise InputError(f"'{name}' has no image in any moment")
        check_sizes(name, views)
        check_copies(name, views)
        _check_seen(name, configuration, views)
        cameras[name] = _camera(name, lenses.get(name), configuration, views)
    kept = [i for i, moment in enumerate(labelled) if any(view.labelled for view in moment.views.values())]
    return Imported(
        robot=robot,
        configuration=configuration,
        cameras=cameras,
        estimated=tuple(name for name in configuration.sensors if name not in lenses),
        moments=[labelled[i] for i in kept],
        transforms={edge: T[kept] for edge, T in recording.transforms.items()},
    )


def _check_seen(name: str, configuration: Configuration, views: Sequence[View]) -> None:
    """Refuse a camera that sees none of the patterns, or one that is not as described."""
    patterns = configuration.patterns
    if not any(view.labelled for view in views):
        raise never_seen(name, next(iter(patterns.values())), views)
    for pattern in patterns.values():
        check_board(name, pattern, views)


def _camera(name: str, lens: KnownLens | None, configuration: Configuration, views: Sequence[View]) -> Camera:
    """The intrinsics that are given, or a start from the corners."""
    width, height = views[0].width, views[0].height
    if lens is None:
        seen = [
            (configuration.patterns[pattern], labels)
            for view in views
            for pattern, found in view.found.items()
            if (labels := found.labels) is not None
        ]
        return starting_intrinsics(name, (width, height), seen)
    if lens.has_size and (lens.camera.width, lens.camera.height) != (width, height):
        raise InputError(
            f"{views[0].file}: found an image of {width} x {height} pixels, expected {lens.camera.width} x "
            f"{lens.camera.height} as {lens.path} has for '{name}'"
        )
    return replace(lens.camera, width=width, height=height)


def _results(imported: Imported, labelled: Sequence[LabelledMoment]) -> ImportResults:
    sensors = {}
    for name in imported.configuration.sensors:
        views = [moment.views[name] for moment in labelled if name in moment.views]
        rejected = [
            RejectedView(view.file, "; ".join(dict.fromkeys(found.reason for found in view.found.values())))
            for view in views
            if not view.labelled
        ]
        corners = sum(len(found.ids) for view in views for found in view.found.values())
        sensors[name] = SensorResult(
            images=len(views),
            labelled=len(views) - len(rejected),
            corners=corners,
            intrinsics="estimated" if name in imported.estimated else "given",
            camera=document_of_camera(imported.cameras[name]),
            rejected=tuple(rejected),
        )
    together = sum(1 for moment in imported.moments if sum(view.labelled for view in moment.views.values()) > 1)
    return ImportResults(imported.robot, len(labelled), len(imported.moments), together, sensors)


def document_of_camera(camera: Camera) -> dict[str, float]:
    """The intrinsics by their names."""
    return dict(zip(camera.parameters, camera.intrinsics.tolist(), strict=True))
