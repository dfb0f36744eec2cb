"""Read datasets: ATOM's JSON, versions 2.0 and 3.0, checked completely before any computation.

A file may hold only what a calibration has changed, beside a reference to the dataset that was calibrated:
``{"changes": {"of": PATH, "sha256": HASH, "transforms": ..., "collections": ..., "joints": ..., "sensors": ...}}``:
transforms that are the same in all collections, those of single collections (null: it has none), the parameters of
joints, the intrinsics of cameras. The path is relative to the working folder of the calibration, in a workflow that of
the repository: the file may be moved, as an artifact that another job downloads, and the dataset may not.

Such a file may come from anybody, and must not make a program read what its user would not expect. The reference is
therefore followed only to the dataset that the caller names, or else to a file below the working folder, symbolic links
resolved; whether there is anything elsewhere is not looked at. The file there must have the very bytes that were
calibrated, so that an error message tells nothing of a file whose content the author of the reference did not have.
"""

import hashlib
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from calibration.base import InputError, read_bytes
from calibration.base.arrays import Array
from calibration.base.process import no_collector
from calibration.engine.dataset.configuration import Configuration, parse_configuration
from calibration.engine.dataset.document import MAX_BYTES, Node, parse_document, read_json, shown
from calibration.engine.dataset.edges import is_constant, read_transform, read_transforms
from calibration.engine.dataset.frames import check_frames, read_joints, read_velocities
from calibration.engine.dataset.labels import read_labels
from calibration.engine.dataset.model import Dataset, Edge
from calibration.engine.dataset.pattern import Pattern, with_explicit_geometry
from calibration.engine.dataset.sensors import LAG_KEY, UNCERTAINTY_KEY, read_sensors

CHANGES_KEY = "changes"
_REMEDY = "or calibrate with datasets: full"


def reference_to(path: Path) -> dict[str, str]:
    """Return a reference to a dataset's file: its path, relative to the working folder if it is below, and its hash.

    Raises:
        InputError: the file cannot be read.
    """
    file, here = path.resolve(), Path.cwd().resolve()
    of = file.relative_to(here).as_posix() if file.is_relative_to(here) else str(file)
    return {"of": of, "sha256": hashlib.sha256(_json_bytes(file)).hexdigest()}


def changed_document(changes: Node, given: Path | None) -> Node:
    """Return the document of the dataset that was calibrated, with the changes.

    Args:
        changes: the value of `CHANGES_KEY`.
        given: the file of the dataset that was calibrated; None to look for it below the working folder.

    Raises:
        InputError: it is not there, or is another one; or something in the changes is missing or wrong.
    """
    root = _read_calibrated_dataset(changes, given)
    document, collections = dict(root.value), dict(root["collections"].mapping())
    common = _transform_entries(changes["transforms"])
    own = {key: _transform_entries(node["transforms"]) for key, node in changes["collections"].items()}
    joints = {name: node.mapping() for name, node in changes["joints"].items()}
    if other := own.keys() - collections.keys():
        raise changes["collections"].fault(f"found collection '{min(other)}', which {root.file} does not have")
    for key, collection in root["collections"].items():
        transforms = {**collection["transforms"].mapping(), **common, **own.get(key, {})}
        collections[key] = {
            **collection.mapping(),
            "transforms": {name: entry for name, entry in transforms.items() if entry is not None},
        }
        if joints:
            read = collection["joints"]
            collections[key]["joints"] = {
                **read.mapping(),
                **{name: {**read[name].mapping(), **values} for name, values in joints.items()},
            }
    sensors = {name: _changed_sensor(root["sensors"][name], node) for name, node in changes["sensors"].items()}
    document |= {"collections": collections, "sensors": {**root["sensors"].mapping(), **sensors}}
    return Node(root.file, (), document)


def _changed_sensor(read: Node, changes: Node) -> dict[str, Any]:
    """Return a sensor with its changed lag and intrinsics, without the uncertainty of those that were read."""
    sensor = dict(read.mapping())
    if lag := changes.get(LAG_KEY):
        sensor[LAG_KEY] = lag.value
    if info := changes.get("camera_info"):
        known = read["camera_info"].mapping()
        sensor["camera_info"] = {key: known[key] for key in known if key != UNCERTAINTY_KEY} | info.mapping()
    return sensor


def _read_calibrated_dataset(changes: Node, given: Path | None) -> Node:
    """Read the dataset that was calibrated."""
    of, expected = changes["of"], changes["sha256"].text()
    here = Path.cwd().resolve()
    try:
        file = (here / of.text() if given is None else given).resolve()
        inside = given is not None or file.is_relative_to(here)
        there = inside and file.is_file()
    except (OSError, ValueError, RuntimeError):  # a NUL or a lone surrogate; too long; a loop of links
        inside = there = False
    if not inside:
        raise of.fault(f"the dataset that was calibrated is not below {here}: run this in a folder above it, {_REMEDY}")
    if not there:
        raise of.fault(f"there is no {file}, the dataset that was calibrated: bring it there, {_REMEDY}")
    data = _json_bytes(file)
    if hashlib.sha256(data).hexdigest() != expected:
        raise changes["sha256"].fault(
            f"{file} is not the dataset that was calibrated, or has changed since: bring that one, {_REMEDY}"
        )
    root = parse_document(data, file)
    if CHANGES_KEY in root.value:
        raise of.fault(f"{file} holds only changes itself, expected a whole dataset")
    return root


def _json_bytes(file: Path) -> bytes:
    return read_bytes(file, MAX_BYTES, "a JSON document")


def _transform_entries(node: Node) -> Mapping[str, Any]:
    """Return the entries of transforms by their keys; None where a collection has none."""
    for key, entry in node.items():
        if entry.value is not None and "-".join(read_transform(entry)[0]) != key:
            raise entry.fault("its frames are not those of its key")
    return node.mapping()


def refuse_changes(path: Path, dataset: Path) -> None:
    """Refuse a dataset that was read from changes as the one that changes refer to.

    Args:
        path: the folder or the file that was read.
        dataset: the path of the dataset that came of it.

    Raises:
        InputError: they are not the same.
    """
    if dataset.resolve() not in (path.resolve(), (path / dataset.name).resolve()):
        raise InputError(f"{path}: datasets: found changes, which need a whole dataset to refer to: say datasets: full")


FILE_NAME = "dataset.json"


def read_dataset(path: Path | str, data: Path | None = None, given: Path | None = None) -> Dataset:
    """Read a dataset from a folder with ``dataset.json``, or from a JSON file.

    A file that holds only what a calibration has changed (see above) becomes the dataset that was
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
