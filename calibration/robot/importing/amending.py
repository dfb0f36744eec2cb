"""Changes of a dataset that is there: the collections of another recording added, its images labelled again."""

import copy
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from calibration import __version__
from calibration.base import InputError, link_or_copy, write_atomically
from calibration.base.records import read, text_of
from calibration.ci.execution.tasks import Task, identity, run_tasks, workspace
from calibration.engine.dataset.configuration import PatternConfiguration, parse_configuration
from calibration.engine.dataset.document import Node, locate, read_json
from calibration.engine.dataset.model import ESTIMATED_KEY
from calibration.engine.dataset.reading import FILE_NAME, read_dataset
from calibration.engine.dataset.writing import write_document
from calibration.engine.evaluation.truth import TRUTH_FILE
from calibration.robot.importing.document import data_file, label_document
from calibration.robot.importing.image_views import LabelledMoment, contact_sheet, view_of_file
from calibration.robot.importing.recorded import check_seen
from calibration.robot.importing.results import LabelledSensor, LabelResults, RejectedView
from calibration.robot.labelling.corner_detector import corner_detector
from calibration.robot.simulation.dataset_folder import refuse_existing, replacing_dataset
from calibration.robot.simulation.record import CONTACT_SHEET_FILE as SHEET

OF_CAMERA = ("width", "height", "distortion_model", "D", "K")
"""Keys of a camera_info that say which camera it is."""


def add_collections(more: Path, to: Path) -> tuple[int, int]:
    """Add the collections of a dataset to another one, with their images and clouds; the others stay as they are.

    The ground truth of simulated ones is kept where both have the same.

    Args:
        more: folder of the dataset to add.
        to: folder of the one that receives it.

    Returns:
        The number of collections of the latter before, and of those added.

    Raises:
        InputError: a dataset is wrong, or they are of different robots: sensors, intrinsics, patterns, transforms.
        InfrastructureError: a file cannot be written.
    """
    if more.resolve() == to.resolve():
        raise InputError(f"{more}: found the same folder twice, expected another recording to add")
    for folder in (to, more):
        read_dataset(folder)
    first, second = (read_json(folder / FILE_NAME, what="a dataset") for folder in (to, more))
    _refuse_other_robot(first, second)
    document = copy.deepcopy(first.value)
    names = _names_of_added(first, second)
    with replacing_dataset(to, overwrite=True) as new:
        for file, _ in _data_files(first):
            link_or_copy(file, new / file.name)
        for key, name in names.items():
            document["collections"][name] = copy.deepcopy(second["collections"][key].value)
        for file, (key, sensor) in _data_files(second):
            document["collections"][names[key]]["data"][sensor]["data_file"] = data_file(sensor, names[key], file.name)
            link_or_copy(file, new / data_file(sensor, names[key], file.name))
        for pattern, entry in document["patterns"].items():
            initial = second["patterns"][pattern].mapping().get("transforms_initial", {})
            entry.setdefault("transforms_initial", {}).update(_renamed(initial, names))
        _write_truth(to, more, names, new)
        write_document(document, new / FILE_NAME)
        read_dataset(new)
    return len(first["collections"].value), len(names)


def _refuse_other_robot(first: Node, second: Node) -> None:
    """Refuse a dataset that is not of the same robot.

    Raises:
        InputError: names what differs.
    """
    estimated = first["_metadata"].mapping().get(ESTIMATED_KEY, ())
    for root in (first, second):
        if not (version := root["_metadata"]["version"]).text().startswith("3"):
            raise version.unexpected("a dataset of version 3")
    for key in ("sensors", "calibration_patterns", "additional_tfs", "joints", "world_link"):
        mine, other = (root["calibration_config"].mapping().get(key) for root in (first, second))
        if mine != other:
            raise InputError(f"{second.file}: calibration_config/{key}: differs from {first.file}: another robot")
    for name in first["sensors"].value:
        cameras = [root["sensors"][name].mapping().get("camera_info") or {} for root in (first, second)]
        for key in OF_CAMERA[: 2 if name in estimated else None]:  # an import estimates them by its own images
            mine, other = (camera.get(key) for camera in cameras)
            if mine != other:
                raise InputError(
                    f"{second.file}: sensors/{name}/camera_info/{key}: found {other}, expected {mine} as in "
                    f"{first.file}: another camera or resolution"
                )


def _names_of_added(first: Node, second: Node) -> dict[str, str]:
    """Return the names of the added collections: numbers that go on after those that are there."""
    known, names, number = set(first["collections"].value), {}, len(first["collections"].value)
    for key in second["collections"].value:
        while (name := f"{number:03}") in known:
            number += 1
        names[key] = name
        number += 1
    return names


def _data_files(root: Node) -> Iterator[tuple[Path, tuple[str, str]]]:
    """Yield the files beside a dataset that its collections name, with collection and sensor."""
    for key, collection in root["collections"].items():
        for sensor, message in data.items() if (data := collection.get("data")) else ():
            name = message.get("data_file") if isinstance(message.value, dict) else None
            if name is not None and (file := Path(locate(name))).is_file():
                yield file, (key, sensor)


def _renamed(by_key: Mapping[str, Any], names: Mapping[str, str]) -> dict[str, Any]:
    return {names[key]: value for key, value in by_key.items() if key in names}


def _write_truth(to: Path, more: Path, names: Mapping[str, str], new: Path) -> None:
    """Write the ground truth of both; none where only one has it.

    Raises:
        InputError: they have others.
    """
    if not all((folder / TRUTH_FILE).is_file() for folder in (to, more)):
        if (to / TRUTH_FILE).is_file():
            raise InputError(f"{to / TRUTH_FILE}: found ground truth, and none in {more}: add what has it too")
        return
    mine, other = (json.loads((folder / TRUTH_FILE).read_bytes()) for folder in (to, more))
    for key in ("sensors", "pattern", "transforms", "joints"):
        if mine.get(key) != other.get(key):
            raise InputError(f"{more / TRUTH_FILE}: {key}: differs from that of {to}: another robot")
    mine["patterns"] |= _renamed(other["patterns"], names)
    write_document(mine, new / TRUTH_FILE)


Done = Callable[[int, int, LabelledMoment], None]


def label_dataset(
    path: Path,
    output: Path,
    again: bool = False,
    overwrite: bool = False,
    jobs: int | None = None,
    done: Done = lambda *_: None,
) -> LabelResults:
    """Label the images of every camera of a dataset into another folder; labels of other sensors are unchanged.

    Args:
        path: the dataset's folder.
        output: the folder of the labelled dataset.
        again: whether images with labels are labelled again.
        overwrite: whether an existing dataset in the output is replaced.
        jobs: number of processes; None for one per core.
        done: called after each collection.

    Raises:
        InputError: the dataset or an image is wrong, there is nothing to label, or a camera never sees a pattern.
        InfrastructureError: a file cannot be written, or a process died.
    """
    refuse_existing(output, overwrite)
    if output.resolve() == path.resolve():
        raise InputError(f"{output}: is the dataset itself; write into another folder, an input is never changed")
    root = read_json(path / FILE_NAME, what="a dataset")
    configuration = parse_configuration(root["calibration_config"])
    patterns = configuration.patterns
    cameras = [name for name, sensor in configuration.sensors.items() if sensor.has_corners]
    if not cameras:
        names = ", ".join(configuration.sensors)
        raise InputError(f"{path}: found no camera among the sensors ({names}), expected one with images to label")
    single = next(iter(patterns)) if str(root["_metadata"]["version"].value).startswith("2") else None
    files = {key: _images_to_label(node, cameras, patterns, single, again) for key, node in root["collections"].items()}
    if not any(files.values()):
        raise InputError(f"{path}: found labels for all images of {', '.join(cameras)}; add --again")
    detectors = {name: corner_detector(pattern) for name, pattern in patterns.items()}

    def label(own: Mapping[str, Path]) -> LabelledMoment:
        return LabelledMoment({name: view_of_file(file, detectors) for name, file in own.items()})

    stats = [(str(file), file.stat().st_mtime_ns) for own in files.values() for file in own.values()]
    depends_on = identity(f"{__version__} {np.__version__} {cv2.__version__} {patterns} {stats}".encode())
    with workspace(output, depends_on, text_of, _read_finished) as work:
        tasks = [work.keeping(Task.call(key, partial(label, own))) for key, own in files.items() if own]
        moments = run_tasks(tasks, workers=jobs, find=work.find, done=done)
        _check_seen(root, moments, cameras, patterns)
        document = copy.deepcopy(root.value)
        for key, moment in moments.items():
            _set_labels(document["collections"][key], moment, single)
        with replacing_dataset(output, overwrite) as new:
            _copy_files(root, new)
            views = [(f"{key} {name}", view) for key, each in moments.items() for name, view in each.views.items()]
            write_atomically(new / SHEET, contact_sheet(views, patterns))
            write_document(document, new / FILE_NAME)
            read_dataset(new)
    return _label_results(files, moments, cameras)


def _read_finished(text: bytes) -> LabelledMoment:
    return read(LabelledMoment, json.loads(text), "a finished collection")


def _labels_of_pattern(labels: Node, pattern: str, single: str | None) -> Node | None:
    """Return the labels of a pattern by sensor; ``single`` is that of a version 2 dataset, which names none."""
    return labels if single is not None else labels.get(pattern)


def _images_to_label(
    collection: Node,
    cameras: Sequence[str],
    patterns: Mapping[str, PatternConfiguration],
    single: str | None,
    again: bool,
) -> dict[str, Path]:
    """Return the images of a collection to label, by camera; ``single`` as for `_labels_of_pattern`."""
    data, labels, found = collection.get("data"), collection.get("labels"), {}
    for camera in cameras:
        message = data.get(camera) if data else None
        name = message.get("data_file") if message else None
        if name is None:
            continue
        own = [_labels_of_pattern(labels, pattern, single) for pattern in patterns] if labels else []
        known = [entry for by_sensor in own if by_sensor and (entry := by_sensor.get(camera))]
        if again or not any(entry.mapping().get("detected") for entry in known):
            found[camera] = Path(locate(name))
            if not found[camera].is_file():
                raise name.unexpected("the image beside the dataset")
    return found


def _check_seen(
    root: Node,
    moments: Mapping[str, LabelledMoment],
    cameras: Sequence[str],
    patterns: Mapping[str, PatternConfiguration],
) -> None:
    for camera in cameras:
        views = [moment.views[camera] for moment in moments.values() if camera in moment.views]
        whole = len(views) == len(root["collections"].mapping())
        if views and whole:
            check_seen(camera, patterns, views)


def _set_labels(collection: dict[str, Any], moment: LabelledMoment, single: str | None) -> None:
    labels = collection.get("labels") or {}
    for name, view in moment.views.items():
        for pattern, found in view.found.items():
            by_sensor = labels if single is not None else labels.setdefault(pattern, {})
            by_sensor[name] = label_document(found)
    collection["labels"] = labels


def _copy_files(root: Node, new: Path) -> None:
    """Link or copy every file that the collections name to the new dataset."""
    for key in root["collections"].mapping():
        collection = root["collections"][key]
        data = collection.get("data")
        for _, message in data.items() if data else ():
            if name := message.get("data_file"):
                source = Path(locate(name))
                if source.is_file():
                    link_or_copy(source, new / name.text())


def _label_results(
    files: Mapping[str, Mapping[str, Path]], moments: Mapping[str, LabelledMoment], cameras: Sequence[str]
) -> LabelResults:
    sensors = {}
    for camera in cameras:
        views = [moment.views[camera] for moment in moments.values() if camera in moment.views]
        rejected = [RejectedView(view.file, view.reason) for view in views if not view.labelled]
        sensors[camera] = LabelledSensor(len(views), len(views) - len(rejected), tuple(rejected))
    return LabelResults(len(files), sensors)
