"""Adds the collections of a recording to a dataset of the same robot, after its own."""

import copy
import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from calibration.base import InputError, link_or_copy
from calibration.engine.dataset import truth
from calibration.engine.dataset.document import Node, locate, read_json
from calibration.engine.dataset.model import ESTIMATED_KEY
from calibration.engine.dataset.reading import FILE_NAME, read_dataset
from calibration.engine.dataset.writing import write_document
from calibration.robot.importing.document import data_file
from calibration.robot.simulation.collection.dataset_folder import replacing_dataset

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
    if not all((folder / truth.FILE_NAME).is_file() for folder in (to, more)):
        if (to / truth.FILE_NAME).is_file():
            raise InputError(f"{to / truth.FILE_NAME}: found ground truth, and none in {more}: add what has it too")
        return
    mine, other = (json.loads((folder / truth.FILE_NAME).read_bytes()) for folder in (to, more))
    for key in ("sensors", "pattern", "transforms", "joints"):
        if mine.get(key) != other.get(key):
            raise InputError(f"{more / truth.FILE_NAME}: {key}: differs from that of {to}: another robot")
    mine["patterns"] |= _renamed(other["patterns"], names)
    write_document(mine, new / truth.FILE_NAME)
