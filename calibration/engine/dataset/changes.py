"""Datasets that hold only what a calibration has changed, beside a reference to the dataset that was calibrated.

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
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from calibration.base import InputError, read_bytes
from calibration.engine.dataset.document import MAX_BYTES, Node, parse_document
from calibration.engine.dataset.edges import read_transform
from calibration.engine.dataset.lens_uncertainty import UNCERTAINTY_KEY
from calibration.engine.dataset.sensors import LAG_KEY

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
