"""Read datasets: ATOM's JSON, versions 2.0 and 3.0, checked completely before any computation."""

import os
from collections.abc import Mapping, Sequence
from pathlib import Path

from calibration.base import InputError
from calibration.base.arrays import Array
from calibration.base.process import no_collector
from calibration.engine.dataset.changes import CHANGES_KEY, changed_document
from calibration.engine.dataset.configuration import Configuration, parse_configuration
from calibration.engine.dataset.document import Node, read_json, shown
from calibration.engine.dataset.edges import is_constant, read_transforms
from calibration.engine.dataset.frames import check_frames, read_joints, read_velocities
from calibration.engine.dataset.labels import read_labels
from calibration.engine.dataset.model import Dataset, Edge
from calibration.engine.dataset.pattern import Pattern, with_explicit_geometry
from calibration.engine.dataset.sensors import read_sensors

FILE_NAME = "dataset.json"


def read_dataset(path: Path | str, data: Path | None = None, given: Path | None = None) -> Dataset:
    """Read a dataset from a folder with ``dataset.json``, or from a JSON file.

    A file that holds only what a calibration has changed (`dataset.changes`) becomes the dataset that was
    calibrated, with these changes; its path is that of the latter.

    Labels that refer to a missing point cloud or depth image are left out (`Dataset.missing_files`); so is
    a sensor without other labels, which then keeps the pose of the robot's description.

    Every label of the result belongs to a known corner or point, every number is finite, every
    sensor's calibrated transform is in the chain from the world to its frame, and no transform in
    that chain or the chain to a pattern's parent is missing in any collection. A missing pattern
    transform is NaN. The arrays are read-only.

    Args:
        path: the folder, or the file.
        data: the folder of its point clouds and depth images; None if they are in the dataset's folder.
        given: the folder or the file of the dataset that was calibrated, if the file holds only changes; None to look
            for it below the working folder.

    Raises:
        InputError: the file does not exist, or something in it is missing or wrong; the message
            names the file, the keys that lead there, what was found and what was expected.
    """
    with no_collector():
        return _read_document(_dataset_file(Path(path)), data, given and _dataset_file(given))


def _dataset_file(path: Path) -> Path:
    inside = os.path.isdir(path)  # noqa: PTH112 (Path.is_dir raises where a folder may not be looked into)
    return path / FILE_NAME if inside else path


def _read_document(path: Path, data: Path | None, given: Path | None) -> Dataset:
    root = read_json(path, what="a dataset")
    if CHANGES_KEY in root.value:
        root = changed_document(root[CHANGES_KEY], given)
        path = root.file
    version = _major_version(root["_metadata"]["version"])
    configuration = parse_configuration(root["calibration_config"])
    sensors = read_sensors(root["sensors"], configuration.sensors)
    if described := root.get("transforms"):
        described.mapping()
    patterns = _read_patterns(root, configuration, version)
    collections = _ordered_collections(root["collections"])
    transforms = read_transforms(collections)
    read, missing = read_labels(collections, sensors, patterns, version, data)
    labelled = {sensor for collection in read for _, sensor in collection.labels}
    sensors = {name: sensor for name, sensor in sensors.items() if name in labelled or name not in missing}
    additional = tuple(configuration.additional_tfs.values())
    velocities, accelerations = read_velocities(collections)
    dataset = Dataset(
        path=path,
        version=version,
        world=configuration.world_link,
        sensors=sensors,
        patterns=patterns,
        anchored=anchored if (anchored := configuration.anchored_sensor) in sensors else None,
        additional_transforms=additional,
        transforms=transforms,
        collections=read,
        document=root.value,
        moving_transforms=frozenset(edge for edge in additional if _is_moving(edge, transforms, described)),
        joints=read_joints(root["calibration_config"], collections),
        velocities=velocities,
        accelerations=accelerations,
        missing_files=missing,
    )
    if not labelled and missing:
        raise InputError(f"{path}: no label is left: {'; '.join(map(dataset.missing_files_of, missing))}")
    if not labelled:
        raise root["collections"].fault(f"none of the {len(collections)} collections has a detected pattern")
    check_frames(dataset, root, collections)
    _check_image_sizes(dataset, collections)
    return dataset


def _check_image_sizes(dataset: Dataset, collections: Sequence[Node]) -> None:
    """Refuse labelled images whose messages have another size than the camera."""
    for node, collection in zip(collections, dataset.collections, strict=True):
        for _, name in collection.labels:
            camera = dataset.sensors[name].camera  # the size of a depth camera's images is checked when they are read
            data = node.get("data")
            if camera and dataset.sensors[name].modality.has_corners and data and (message := data.get(name)):
                for key, size in (("width", camera.width), ("height", camera.height)):
                    if (found := message.get(key)) and found.number() != size:
                        raise found.unexpected(f"{size} as in sensors/{name}/camera_info")


def _is_moving(edge: Edge, transforms: Mapping[Edge, Array], described: Node | None) -> bool:
    """Whether an additional transform differs between collections: as the file states, else by its values."""
    entry = described.get("-".join(edge)) if described else None
    if kind := entry and entry.get("type"):
        if kind.text() not in ("fixed", "multiple"):
            raise kind.unexpected("'fixed' or 'multiple'")
        return bool(kind.value == "multiple")
    return edge in transforms and not is_constant(transforms[edge])


def _major_version(node: Node) -> str:
    major = str(node.value).partition(".")[0]
    if type(node.value) not in (str, int, float) or major not in ("2", "3"):
        raise node.unexpected("version 2.0 or 3.0")
    return f"{major}.0"


def _read_patterns(root: Node, configuration: Configuration, version: str) -> dict[str, Pattern]:
    if version == "2.0" and len(configuration.patterns) != 1:
        raise root["calibration_config"]["calibration_patterns"].unexpected("one pattern in a dataset of version 2.0")
    explicit = root.get("patterns")
    patterns = {}
    for name, entry in configuration.patterns.items():
        patterns[name] = entry.pattern(version)
        if explicit and (node := explicit.get(name)):
            patterns[name] = with_explicit_geometry(patterns[name], node)
    return patterns


def _ordered_collections(node: Node) -> list[Node]:
    """Return the collections in the order of their numbers."""
    numbered: dict[int, Node] = {}
    for key, collection in node.items():
        if not (key.isascii() and key.isdigit() and len(key) <= 18):
            raise collection.fault(f"found the key {shown(key)}, expected a number such as '000'")
        other = numbered.setdefault(int(key), collection)
        if other is not collection:
            raise collection.fault(f"found number {int(key)} twice, expected it once (other key: '{other.keys[-1]}')")
    if not numbered:
        raise node.unexpected("at least one collection")
    return [numbered[number] for number in sorted(numbered)]
