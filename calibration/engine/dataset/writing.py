"""Write datasets: ATOM's JSON, version 3.0, which reads back as the same dataset.

The text is that of `json.dumps(document, indent=2, sort_keys=True)`, in a third of the time. Python's encoder is fast
only without an indent. So flat objects and lists, which are nearly all of a dataset's text, are left to it, with
separators that already contain the line ends and the indent. A dataset of 0.7 MB takes 10 ms instead of 30; in a cell
of a matrix, which shares all but its transforms with the others, 1 ms.
"""

import json
from collections.abc import Iterable, Mapping
from contextlib import suppress
from functools import cached_property, lru_cache
from itertools import chain
from json.encoder import encode_basestring_ascii
from pathlib import Path
from typing import Any

import numpy as np

from calibration.base import InputError, link_or_copy, write_atomically
from calibration.base.arrays import Array
from calibration.engine.dataset.configuration import FIRST_PATTERN
from calibration.engine.dataset.document import Node, locate
from calibration.engine.dataset.edges import is_constant, read_transforms, transform_documents
from calibration.engine.dataset.frames import joint_document, joint_values
from calibration.engine.dataset.model import Dataset, Edge
from calibration.engine.dataset.pattern import Pattern, pattern_document
from calibration.engine.dataset.reading import CHANGES_KEY, FILE_NAME, reference_to
from calibration.engine.dataset.sensors import LAG_KEY, UNCERTAINTY_KEY, camera_document, read_camera

CONTAINER_TYPES = frozenset({dict, list, tuple})
MAX_KEPT_CHARACTERS = 64 * 1024**2
"""Limit of the texts that `SharedTexts` keeps."""
INDENT_TEXT = "  "


class SharedTexts:
    """Objects that several documents contain; the text of each is made once. They must not change."""

    def __init__(self, objects: Iterable[Any]) -> None:
        # The objects are kept too, so that no other one gets the id of one that is gone.
        self._objects = {id(value): value for value in objects if type(value) in CONTAINER_TYPES}
        self._texts: dict[tuple[int, str], str] = {}
        self._room = MAX_KEPT_CHARACTERS

    def text_of(self, value: Any, line_start: str) -> str:
        """Return the text of an object or a list at a depth; that of one of the objects is kept, if there is room."""
        key = (id(value), line_start)
        if (text := self._texts.get(key)) is None:
            text = _format_container(value, line_start, self)
            if id(value) in self._objects and len(text) <= self._room:
                self._room -= len(text)
                self._texts[key] = text
        return text


def document_text(document: Mapping[str, Any], shared: SharedTexts | None = None) -> str:
    """Format a document like ``json.dumps(document, indent=2, sort_keys=True)``; keys must be text.

    Raises:
        RecursionError: it is nested too deeply.
    """
    return _format_value(document, "\n", shared or SharedTexts(()))


def _format_value(value: Any, line_start: str, shared: SharedTexts) -> str:
    """Format a value; its lines begin with ``line_start``, a line end and the indent."""
    if not value or type(value) not in CONTAINER_TYPES:
        return _sorted_encoder(", ").encode(value)
    return shared.text_of(value, line_start)


def _format_container(value: Any, line_start: str, shared: SharedTexts) -> str:
    """Format a container that is not empty."""
    inner = line_start + INDENT_TEXT
    children = value.values() if isinstance(value, dict) else value
    if _are_flat(children):
        text = _encode_flat(value, inner)
        return f"{text[0]}{inner}{text[1:-1]}{line_start}{text[-1]}"
    if isinstance(value, dict):
        lines = [f"{encode_basestring_ascii(key)}: {_format_value(value[key], inner, shared)}" for key in sorted(value)]
        return f"{{{inner}{f',{inner}'.join(lines)}{line_start}}}"
    if all(value) and set(map(type, value)) == {dict} and _are_flat(chain.from_iterable(map(dict.values, value))):
        # JSON strings contain no line ends, so only the end of an object can match.
        deep = inner + INDENT_TEXT
        text = _encode_flat(value, deep)[2:-2].replace(f"}},{deep}{{", f"{inner}}},{inner}{{{deep}")
        return f"[{inner}{{{deep}{text}{inner}}}{line_start}]"
    return f"[{inner}{f',{inner}'.join([_format_value(child, inner, shared) for child in value])}{line_start}]"


def _encode_flat(value: Any, line_start: str) -> str:
    return _sorted_encoder(f",{line_start}").encode(value)


def _are_flat(values: Any) -> bool:
    return CONTAINER_TYPES.isdisjoint(map(type, values))


@lru_cache(maxsize=64)
def _sorted_encoder(separator: str) -> json.JSONEncoder:
    return json.JSONEncoder(sort_keys=True, check_circular=False, separators=(separator, ": "))


def write_document(document: Mapping[str, Any], path: Path | str) -> None:
    """Write a document as ATOM does: JSON, keys sorted, indented by 2; the file is replaced in one step.

    Args:
        document: the document.
        path: the file.

    Raises:
        InputError: the document is nested too deeply.
        InfrastructureError: the file cannot be written.
    """
    write_atomically(path, _text(document, path, None))


def _text(document: Mapping[str, Any], path: Path | str, shared: SharedTexts | None) -> str:
    """Return the text of a document; the path is for messages."""
    try:
        return f"{document_text(document, shared)}\n"
    except RecursionError:
        raise InputError(f"{path}: cannot be written: the document is nested too deeply") from None


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
    """Writer of several datasets made from one; what they have in common is converted, and becomes text, once."""

    def __init__(self, dataset: Dataset) -> None:
        self._given = dataset
        self._file = dataset.path.resolve()
        self._structure = _structure(dataset)
        source = dataset.document
        self._collections = {key: source["collections"][key] for key in dataset.keys}
        nodes = [Node(dataset.path, ("collections", key), each) for key, each in self._collections.items()]
        self._read = read_transforms(nodes)
        self._initial = {key: _initial_transforms(each["transforms"]) for key, each in self._collections.items()}
        self._changes = {edge: self._change(dataset, edge) for edge in dataset.transforms}
        self._kinds = {edge: _kind(dataset, edge) for edge in dataset.transforms}
        self._configuration = _configuration(dataset)
        self._sensors = {name: _sensor(dataset, name) for name in source.get("sensors", {})}
        self._patterns = {name: _geometry(dataset, pattern) for name, pattern in dataset.patterns.items()}

    @cached_property
    def _shared(self) -> SharedTexts:
        parts = [*self._given.document.values(), self._configuration, *self._sensors.values(), *self._kinds.values()]
        for pattern in self._patterns.values():
            parts += pattern.values()
        for collection in self._collections.values():
            parts += [*collection.values(), *collection["transforms"].values()]
        return SharedTexts([*parts, *self._initial.values()])

    def write(self, dataset: Dataset, path: Path | str, images: bool = True) -> Path:
        """Write a dataset; see `write_dataset`."""
        text, path = self.text(dataset), self._path(path)
        bring_payload(dataset, path.parent, images)
        write_atomically(path, text)
        return path

    def write_text(self, text: str, path: Path | str) -> Path:
        """Write the text of a dataset or of its changes, without the files that it refers to; see `write_dataset`."""
        path = self._path(path)
        write_atomically(path, text)
        return path

    def _path(self, path: Path | str) -> Path:
        """Return the path of the file to write; refuse the given dataset's own."""
        path = Path(path)
        if path.suffix != ".json":
            path = path / FILE_NAME
        if path.resolve() == self._file:
            raise InputError(f"{path}: is the dataset itself; write into another folder, an input is never changed")
        return path

    def text(self, dataset: Dataset) -> str:
        """Return the text of a dataset's file.

        Raises:
            InputError: a transform is not finite, or the document is nested too deeply.
        """
        return _text(self.document(dataset), dataset.path, self._shared)

    def document(self, dataset: Dataset) -> dict[str, Any]:
        """Return the document of a dataset; see `dataset_document`."""
        if not self._fits(dataset):
            return DatasetWriter(dataset).document(dataset)
        source, new, changes = dataset.document, self._new(dataset), self._changed(dataset)
        kinds = {edge: _kind(dataset, edge) if edge in new else self._kinds[edge] for edge in dataset.transforms}
        sensors = {name for name, sensor in dataset.sensors.items() if sensor is not self._given.sensors[name]}
        return {
            "additional_sensor_data": {},
            **source,
            "_metadata": {"package_name": "", **source["_metadata"], "version": "3.0"},
            "calibration_config": self._configuration,
            "sensors": {**self._sensors, **{name: _sensor(dataset, name) for name in sensors}},
            "patterns": {name: self._pattern(dataset, pattern) for name, pattern in dataset.patterns.items()},
            "transforms": {
                **{"-".join(edge): kind for edge, kind in kinds.items()},
                **(source.get("transforms") or {}),
            },
            "collections": {key: self._collection(dataset, i, changes) for i, key in enumerate(dataset.keys)},
        }

    def changes_text(self, dataset: Dataset) -> str:
        """Return the text of a file with only what differs from the document that was read; see `dataset.reading`.

        Raises:
            InputError: a transform is not finite.
        """
        if not self._fits(dataset):
            return DatasetWriter(dataset).changes_text(dataset)
        common: dict[str, Any] = {}
        own: dict[str, Any] = {}
        for edge, entries in self._changed(dataset).items():
            if all(entry == entries[0] for entry in entries):
                common["-".join(edge)] = entries[0]
                continue
            for key, entry in zip(dataset.keys, entries, strict=True):
                own.setdefault(key, {"transforms": {}})["transforms"]["-".join(edge)] = entry
        sensors = {name: _sensor(dataset, name) for name in self._sensors}
        changes = {
            **self.reference,
            "transforms": common,
            "collections": own,
            "joints": {name: joint_values(joint) for name, joint in dataset.joints.items()},
            "sensors": {
                name: {key: document[key] for key in ("camera_info", LAG_KEY) if key in document}
                for name, document in sensors.items()
                if document is not dataset.document["sensors"][name]
            },
        }
        return _text({CHANGES_KEY: changes}, dataset.path, None)

    @cached_property
    def reference(self) -> dict[str, str]:
        """Reference to the file of the dataset, as it is now.

        Raises:
            InputError: it cannot be read.
        """
        return reference_to(self._given.path)

    def _fits(self, dataset: Dataset) -> bool:
        """Whether a dataset differs from the given one only in transforms, intrinsics, and values of joints."""
        return dataset.document is self._given.document and _structure(dataset) == self._structure

    def _new(self, dataset: Dataset) -> set[Edge]:
        """Return the edges whose transforms are not those of the given dataset."""
        return {edge for edge, T in dataset.transforms.items() if T is not self._given.transforms.get(edge)}

    def _changed(self, dataset: Dataset) -> dict[Edge, list[dict[str, Any] | None]]:
        """Return the edges whose transforms are not those of the document, with their entries."""
        found = {**self._changes, **{edge: self._change(dataset, edge) for edge in self._new(dataset)}}
        return {edge: change for edge in dataset.transforms if (change := found[edge])}

    def _change(self, dataset: Dataset, edge: Edge) -> list[dict[str, Any] | None] | None:
        """Return the entries of an edge for each collection, None where it lacks the edge; None if they are as read."""
        T, read = dataset.transforms[edge], self._read.get(edge)
        if np.array_equal(T, np.full_like(T, np.nan) if read is None else read, equal_nan=True):
            return None
        present = ~np.isnan(T[:, 0, 0])
        if not np.isfinite(T[present]).all():
            raise InputError(f"{dataset.path}: transform '{'-'.join(edge)}' is not finite; it is not written")
        return _entries(edge, T)

    def _pattern(self, dataset: Dataset, pattern: Pattern) -> dict[str, Any]:
        """Return the document of a pattern."""
        known = pattern is self._given.patterns.get(pattern.name)
        geometry = self._patterns[pattern.name] if known else _geometry(dataset, pattern)
        return {**geometry, "transforms_initial": _initial_poses(dataset, pattern)}

    def _collection(
        self, dataset: Dataset, i: int, changes: Mapping[Edge, list[dict[str, Any] | None]]
    ) -> dict[str, Any]:
        key = dataset.keys[i]
        read = self._collections[key]
        now = {"-".join(edge): entries[i] for edge, entries in changes.items()}
        transforms = {key: entry for key, entry in {**read["transforms"], **now}.items() if entry is not None}
        collection = {"additional_data": {}, "joints": {}, **read, "transforms": transforms}
        if changes:
            collection["transforms_ini"] = self._initial[key]
        if dataset.joints:
            joints = {name: joint_document(joint, read["joints"][name], i) for name, joint in dataset.joints.items()}
            collection["joints"] = {**read["joints"], **joints}
        if dataset.version == "2.0":
            collection["labels"] = {next(iter(dataset.patterns)): read["labels"]}
        return collection


def _structure(dataset: Dataset) -> tuple[object, ...]:
    """Return what all datasets of a writer have in common beside their document."""
    joints = [(joint.name, joint.edge, joint.parameters) for joint in dataset.joints.values()]
    edges = {sensor.edge for sensor in dataset.sensors.values()}
    moving = dataset.moving_transforms
    return dataset.keys, edges, dataset.additional_transforms, moving, joints, dataset.anchored, dataset.missing_files


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


def _sensor(dataset: Dataset, name: str) -> Mapping[str, Any]:
    """Return the document of a sensor, with its current intrinsics and lag if they have changed."""
    read: Mapping[str, Any] = dataset.document["sensors"][name]
    if name in dataset.sensors and dataset.sensors[name].lag != read.get(LAG_KEY, 0.0):
        read = {**read, LAG_KEY: dataset.sensors[name].lag}
    camera = dataset.sensors[name].camera if name in dataset.sensors else None
    if camera is None or camera == read_camera(
        Node(dataset.path, ("sensors", name, "camera_info"), read["camera_info"])
    ):
        return read
    # its uncertainty was that of the intrinsics that were read
    info = {key: value for key, value in read["camera_info"].items() if key != UNCERTAINTY_KEY}
    return {**read, "camera_info": {**info, **camera_document(camera)}}


def _geometry(dataset: Dataset, pattern: Pattern) -> dict[str, Any]:
    """Return the document of a pattern without its initial poses, with missing parts added."""
    given = _given(dataset, pattern)
    full = pattern_document(pattern, {})
    frame = {**full["frame"], **{key: value for key, value in given.get("frame", {}).items() if value}}
    return {**full, **given, "frame": frame}


def _given(dataset: Dataset, pattern: Pattern) -> dict[str, Any]:
    """Return the parts of a pattern's document that the input has."""
    read = (dataset.document.get("patterns") or {}).get(pattern.name) or {}
    return {key: value for key, value in read.items() if value}


def _initial_poses(dataset: Dataset, pattern: Pattern) -> dict[str, Any]:
    """Return the initial poses of a pattern: the input's, else the current ones with the camera that saw it."""
    initial = _given(dataset, pattern).get("transforms_initial")
    if isinstance(initial, dict):
        return {key: initial[key] for key in dataset.keys if key in initial}
    edge = pattern.edge
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


def bring_payload(dataset: Dataset, folder: Path, images: bool) -> None:
    """Link or copy the existing data files of the collections into the folder.

    Raises:
        InfrastructureError: a file cannot be written.
    """
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
