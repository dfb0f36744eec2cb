"""Write datasets: ATOM's JSON, version 3.0, which reads back as the same dataset."""

from collections.abc import Mapping
from contextlib import suppress
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from calibration.dataset.configuration import FIRST_PATTERN
from calibration.dataset.document import Node
from calibration.dataset.edges import is_constant, read_transforms, transform_documents
from calibration.dataset.joints import joint_document
from calibration.dataset.model import Dataset, Edge
from calibration.dataset.pattern import Pattern, pattern_document
from calibration.dataset.payload import locate
from calibration.dataset.reading import FILE_NAME
from calibration.dataset.sensors import camera_document, read_camera
from calibration.errors import InputError
from calibration.files import link_or_copy, write_atomically
from calibration.geometry.types import Array
from calibration.json_text import Shared, json_text


def write_document(document: Mapping[str, Any], path: Path | str, shared: Shared | None = None) -> None:
    """Write a document as ATOM does: JSON, keys sorted, indented by 2; the file is replaced in one step.

    Args:
        document: the document.
        path: the file.
        shared: objects in the document whose text is kept for other documents.

    Raises:
        InputError: the document is nested too deeply.
        InfrastructureError: the file cannot be written.
    """
    try:
        text = json_text(document, shared=shared)
    except RecursionError:
        raise InputError(f"{path}: cannot be written: the document is nested too deeply") from None
    write_atomically(path, f"{text}\n")


def write_dataset(dataset: Dataset, path: Path | str, images: bool = True) -> Path:
    """Write a dataset into a folder as ``dataset.json``, or into a file whose name ends in ``.json``.

    Transforms, intrinsics and the choice of collections are those of ``dataset``; everything else is copied from the
    document that was read. Version 2.0 becomes 3.0 with explicit corner coordinates, so that poses keep their
    meaning. If transforms have changed, the original ones are added to each collection as ``transforms_ini``. The point
    clouds and depth images are placed next to the output, and the images if requested: as hard links if the file system
    supports them, else as copies.

    Returns:
        The path of the JSON file.

    Raises:
        InputError: the path is the dataset's own file, or a transform is not finite.
        InfrastructureError: a file cannot be written.
    """
    return DatasetWriter(dataset).write(dataset, path, images)


def dataset_document(dataset: Dataset) -> dict[str, Any]:
    """Return the version 3.0 document of a dataset; unchanged parts are shared with the document that was read.

    Raises:
        InputError: a transform is not finite.
    """
    return DatasetWriter(dataset).document(dataset)


class DatasetWriter:
    """Writer of several datasets made from one document; the text of what they share is made once."""

    def __init__(self, dataset: Dataset) -> None:
        self._source = dataset.document
        self._keys = dataset.keys
        collections = self._source["collections"]
        self._collections = {key: collections[key] for key in dataset.keys}
        nodes = [Node(dataset.path, ("collections", key), each) for key, each in self._collections.items()]
        self._transforms = read_transforms(nodes)
        self._initial = {key: _initial_transforms(each["transforms"]) for key, each in self._collections.items()}

    @cached_property
    def _shared(self) -> Shared:
        parts = [*self._source.values(), *self._source.get("sensors", {}).values(), *self._initial.values()]
        for each in self._collections.values():
            parts += [*each.values(), *each["transforms"].values()]
        return Shared(parts)

    def write(self, dataset: Dataset, path: Path | str, images: bool = True) -> Path:
        """Write a dataset; see `write_dataset`."""
        path = Path(path)
        if path.suffix != ".json":
            path = path / FILE_NAME
        if path.resolve() == dataset.path.resolve():
            raise InputError(f"{path}: is the dataset itself; write into another folder, an input is never changed")
        document = self.document(dataset)
        _bring_payload(dataset, path.parent, images)
        write_document(document, path, self._shared)
        return path

    def document(self, dataset: Dataset) -> dict[str, Any]:
        """Return the document of a dataset; see `dataset_document`."""
        if dataset.document is not self._source or dataset.keys != self._keys:
            return DatasetWriter(dataset).document(dataset)
        source = self._source
        changed = self._changed(dataset)
        return {
            "additional_sensor_data": {},
            **source,
            "_metadata": {"package_name": "", **source["_metadata"], "version": "3.0"},
            "calibration_config": _configuration(dataset),
            "sensors": {name: _sensor(dataset, name, entry) for name, entry in source.get("sensors", {}).items()},
            "patterns": {name: _pattern(dataset, pattern) for name, pattern in dataset.patterns.items()},
            "transforms": {
                **{"-".join(edge): _kind(dataset, edge) for edge in dataset.transforms},
                **(source.get("transforms") or {}),
            },
            "collections": {key: self._collection(dataset, i, changed) for i, key in enumerate(dataset.keys)},
        }

    def _changed(self, dataset: Dataset) -> dict[Edge, list[dict[str, Any] | None]]:
        """Return the changed edges, with the entry for each collection; None where a collection lacks it."""
        missing = np.full((len(dataset.keys), 4, 4), np.nan)
        changed = {}
        for edge, T in dataset.transforms.items():
            if np.array_equal(T, self._transforms.get(edge, missing), equal_nan=True):
                continue
            present = ~np.isnan(T[:, 0, 0])
            if not np.isfinite(T[present]).all():
                raise InputError(f"{dataset.path}: transform '{'-'.join(edge)}' is not finite; it is not written")
            changed[edge] = _entries(edge, T)
        return changed

    def _collection(
        self, dataset: Dataset, i: int, changed: Mapping[Edge, list[dict[str, Any] | None]]
    ) -> dict[str, Any]:
        key = dataset.keys[i]
        read = self._collections[key]
        now = {"-".join(edge): entries[i] for edge, entries in changed.items()}
        transforms = {key: entry for key, entry in {**read["transforms"], **now}.items() if entry is not None}
        collection = {"additional_data": {}, "joints": {}, **read, "transforms": transforms}
        if changed:
            collection["transforms_ini"] = self._initial[key]
        if dataset.joints:
            joints = {name: joint_document(joint, read["joints"][name], i) for name, joint in dataset.joints.items()}
            collection["joints"] = {**read["joints"], **joints}
        if dataset.version == "2.0":
            collection["labels"] = {next(iter(dataset.patterns)): read["labels"]}
        return collection


def _initial_transforms(read: Mapping[str, Any]) -> dict[str, Any]:
    """Return the original transforms of a collection, under names of their own."""
    return {
        key: {**entry, "parent": f"{entry['parent']}_ini", "child": f"{entry['child']}_ini"}
        for key, entry in read.items()
    }


def _configuration(dataset: Dataset) -> dict[str, Any]:
    source = dict(dataset.document["calibration_config"])
    single = source.pop("calibration_pattern", None)
    if not source.get("calibration_patterns"):
        source["calibration_patterns"] = {FIRST_PATTERN: single}
    defaults = {"package_name": "", "joints": None, "additional_tfs": None}
    anchored = dataset.anchored
    if (read := source.get("anchored_sensor")) in dataset.missing_files:
        anchored = read
    return {**defaults, **source, "anchored_sensor": anchored, "version": 3.0}


def _sensor(dataset: Dataset, name: str, read: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return the document of a sensor, with its current intrinsics if they have changed."""
    camera = dataset.sensors[name].camera if name in dataset.sensors else None
    if camera is None or camera == read_camera(
        Node(dataset.path, ("sensors", name, "camera_info"), read["camera_info"])
    ):
        return read
    return {**read, "camera_info": {**read["camera_info"], **camera_document(camera)}}


def _pattern(dataset: Dataset, pattern: Pattern) -> dict[str, Any]:
    """Return the document of a pattern, with missing parts added."""
    read = (dataset.document.get("patterns") or {}).get(pattern.name) or {}
    given = {key: value for key, value in read.items() if value}
    initial = given.get("transforms_initial")
    if isinstance(initial, dict):
        initial = {key: initial[key] for key in dataset.keys if key in initial}
    else:
        initial = _initial_poses(dataset, pattern)
    full = pattern_document(pattern, initial)
    frame = {**full["frame"], **{key: value for key, value in given.get("frame", {}).items() if value}}
    return {**full, **given, "frame": frame, "transforms_initial": initial}


def _initial_poses(dataset: Dataset, pattern: Pattern) -> dict[str, Any]:
    """Return the current poses of a pattern as its initial ones, with the camera that saw it."""
    edge = (pattern.parent_link, pattern.link)
    poses: dict[str, Any] = {}
    if edge not in dataset.transforms:
        return {key: {"detected": False} for key in dataset.keys}
    for collection, entry in zip(dataset.collections, _entries(edge, dataset.transforms[edge]), strict=True):
        cameras = [s for p, s in collection.labels if p == pattern.name and dataset.sensors[s].modality.has_corners]
        if cameras and entry is not None:
            poses[collection.key] = {"detected": True, "sensor": cameras[0], **entry}
        else:
            poses[collection.key] = {"detected": False}
    return poses


def _entries(edge: Edge, T: Array) -> list[dict[str, Any] | None]:
    """Return the document entries of an edge's transforms (N, 4, 4); None where they are not finite."""
    finite = np.flatnonzero(np.isfinite(T).all(axis=(1, 2))).tolist()
    found = dict(zip(finite, transform_documents(edge, T[finite]), strict=True))
    return [found.get(i) for i in range(len(T))]


def _kind(dataset: Dataset, edge: Edge) -> dict[str, Any]:
    """Return ATOM's attributes of a transform: whether it is calibrated, and constant in all collections."""
    calibrated = {*(sensor.edge for sensor in dataset.sensors.values()), *dataset.additional_transforms}
    joint = next((joint for joint in dataset.joints.values() if joint.edge == edge), None)
    return {
        "parent": edge[0],
        "child": edge[1],
        "type": "multiple"
        if edge in dataset.moving_transforms or not is_constant(dataset.transforms[edge])
        else "fixed",
        "is_transformation_calibrated": edge in calibrated,
        "from_bag": False,
        "joint_name": joint.name if joint else "",
        "joint_params_calibrated": list(joint.parameters) if joint else [],
        "weight": 1,
    }


def _bring_payload(dataset: Dataset, folder: Path, images: bool) -> None:
    """Link or copy the existing data files of the collections into the folder."""
    for key in dataset.keys:
        data = dataset.document["collections"][key].get("data")
        for sensor, message in data.items() if isinstance(data, dict) else ():
            if sensor in dataset.sensors and (images or dataset.sensors[sensor].modality.points):
                with suppress(InputError):  # a fault here concerns files without labels, which reading did not need
                    _bring(Node(dataset.path, ("collections", key, "data", sensor), message)["data_file"], folder)


def _bring(name: Node, folder: Path) -> None:
    source, target = Path(locate(name)).resolve(), folder / name.text()
    if source.is_file() and source != target.resolve():
        link_or_copy(source, target)
