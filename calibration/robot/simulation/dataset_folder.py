"""Folder of a simulated dataset, which is replaced completely or not at all, and the documents in it.

They are ATOM's ``dataset.json``, version 3.0, and its ground truth. Numbers are rounded (poses to a nanometre and a
nanoradian, estimated ones to 10 micrometres and microradians, labels to a ten-thousandth of a pixel), so that the
rounding errors of a machine's arithmetic have no effect.
"""

import filecmp
import json
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path, PurePosixPath
from typing import Any

from calibration.base import InfrastructureError, InputError, link_or_copy, temporary_folder, write_atomically
from calibration.engine.dataset.configuration import SensorConfiguration
from calibration.engine.dataset.model import Edge
from calibration.engine.dataset.pattern import pattern_document
from calibration.engine.dataset.reading import FILE_NAME
from calibration.engine.dataset.sensors import camera_document
from calibration.engine.dataset.writing import write_document
from calibration.engine.evaluation.truth import TRUTH_FILE
from calibration.engine.geometry.cameras import Camera
from calibration.engine.geometry.frames import JOINT_PARAMETERS
from calibration.robot.simulation.kinematics import Play
from calibration.robot.simulation.motion import motion_document
from calibration.robot.simulation.record import (
    POSE_DECIMALS,
    Record,
    corner_rms,
    message_header,
    pose_document,
)
from calibration.robot.simulation.system import MOTION_FILE, System

RECORDING_USER = "calibration-ci"
RECORDING_DATE = "Thu Jan  1 00:00:00 1970"
RECORDING_TIMESTAMP = "0.0"
"""Constant, so that the same input gives the same bytes."""


def dataset_document(system: System, kept: Sequence[Record]) -> dict[str, Any]:
    """Return the content of ``dataset.json``, with the transforms of the nominal robot."""
    configuration = system.configuration
    return {
        "_metadata": {
            "dataset_name": system.name,
            "date": RECORDING_DATE,
            "package_name": configuration.package_name,
            "robot_name": system.robot.name,
            "timestamp": RECORDING_TIMESTAMP,
            "user": RECORDING_USER,
            "version": "3.0",
        },
        "additional_sensor_data": {},
        "calibration_config": configuration.to_document(),
        "sensors": {name: _sensor_document(system, sensor) for name, sensor in configuration.sensors.items()},
        "patterns": {
            name: pattern_document(pattern, {record.key: dict(record.initial[name]) for record in kept})
            for name, pattern in system.patterns.items()
        },
        "transforms": _edge_documents(system),
        "collections": {record.key: record.collection for record in kept},
    }


def truth_document(play: Play, kept: Sequence[Record]) -> dict[str, Any]:
    """Return the content of ``ground_truth.json``: the values that a calibration of the dataset should find."""
    system = play.system
    config = system.configuration

    def constant(edge: Edge) -> dict[str, Any]:
        return pose_document(edge, play.true.transforms[edge][0])

    noises = [sensor.noise for sensor in system.sensors.values() if sensor.modality.family == "lidar"]
    constants = [edge for edge in config.additional_tfs.values() if edge not in system.unknown_motions]
    fixed = [(pattern.parent_link, pattern.link) for pattern in system.patterns.values() if pattern.fixed]
    return {
        "sensors": {name: constant((s.parent_link, s.child_link)) for name, s in config.sensors.items()},
        "patterns": {r.key: list(r.truth) if len(r.truth) > 1 else r.truth[0] for r in kept},
        **({"pattern": constant(fixed[0])} if len(fixed) == 1 else {}),
        "transforms": [constant(edge) for edge in (*constants, *fixed)],
        **({"joints": _true_joints(system)} if config.joints else {}),
        "seed": play.seed,
        "corner_rms_px": corner_rms(kept),
        "lidar_sigma": max([0.0, *noises]),
    }


def _true_joints(system: System) -> dict[str, dict[str, float]]:
    """Return the true values of the calibrated parameters of joints, m and rad."""
    joints = {}
    for name, parameters in system.configuration.joints.items():
        values = system.nominal.movable[name].values(system.joint_errors.get(name)).tolist()
        by_name = dict(zip(JOINT_PARAMETERS, values, strict=True))
        joints[name] = {p: round(value, POSE_DECIMALS) + 0.0 for p, value in by_name.items() if p in parameters}
    return joints


def _sensor_document(system: System, sensor: SensorConfiguration) -> dict[str, Any]:
    simulated = system.sensors[sensor.name]
    steps = system.robot.tree.path(system.configuration.world_link, sensor.link)
    document: dict[str, Any] = {
        "_name": sensor.name,
        "calibration_child": sensor.child_link,
        "calibration_parent": sensor.parent_link,
        "chain": [{"parent": s.parent, "child": s.child, "key": f"{s.parent}-{s.child}"} for s in steps],
        "modality": sensor.modality,
        "msg_type": simulated.modality.message,
        "parent": sensor.link,
        "topic": sensor.topic_name,
    }
    if simulated.intrinsics:
        document["camera_info_topic"] = str(PurePosixPath(sensor.topic_name).parent / "camera_info")
        document["camera_info"] = _camera_info(simulated.intrinsics, sensor.link)
    return document


def _camera_info(camera: Camera, frame: str) -> dict[str, Any]:
    fx, fy, cx, cy = (round(value, 9) for value in (camera.fx, camera.fy, camera.cx, camera.cy))
    return {
        "header": message_header(frame, 0),
        **camera_document(replace(camera, fx=fx, fy=fy, cx=cx, cy=cy)),
        "R": [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        "binning_x": 0,
        "binning_y": 0,
        "roi": {"x_offset": 0, "y_offset": 0, "height": 0, "width": 0, "do_rectify": False},
    }


def _edge_documents(system: System) -> dict[str, Any]:
    """Return the attributes of every edge of the tree; "multiple" if it differs between collections."""
    calibrated = {(s.parent_link, s.child_link) for s in system.configuration.sensors.values()}
    calibrated |= set(system.configuration.additional_tfs.values())
    return {
        f"{joint.parent}-{joint.child}": {
            "parent": joint.parent,
            "child": joint.child,
            "type": "multiple" if joint.is_movable else "fixed",
            "joint_name": joint.name,
            "joint_params_calibrated": list(system.configuration.joints.get(joint.name, ())),
            "is_transformation_calibrated": joint.edge in calibrated or joint.name in system.configuration.joints,
            "from_bag": joint.is_movable,
            "weight": 1,
        }
        for joint in system.robot.joints
    }


def write_dataset(new: Path, play: Play, kept: Sequence[Record], files: Path) -> None:
    """Write a collected dataset into a new folder: JSON, truth, motion, and the system's description.

    So it is also the folder of a system, from which the dataset can be collected again.

    Args:
        new: the folder, which must exist.
        play: the played motion.
        kept: the collections, at least one.
        files: the folder with the images and clouds that their records name; they are linked or copied.

    Raises:
        InfrastructureError: something cannot be written.
    """
    for name, content in play.system.sources.items():
        write_atomically(new / name, content)
    for record in kept:
        for message in record.collection["data"].values():
            name = message.get("data_file")  # the ranges of a 2D LiDAR are in the dataset itself
            if name and (files / name).exists():
                link_or_copy(files / name, new / name)
    write_document(motion_document(play.motion), new / MOTION_FILE)
    write_document(truth_document(play, kept), new / TRUTH_FILE)
    write_document(dataset_document(play.system, kept), new / FILE_NAME)


def refuse_existing(folder: Path, overwrite: bool) -> None:
    """Check that a dataset may be written into a folder, which need not exist.

    Raises:
        InputError: it has a dataset and must not be overwritten, or is not a folder.
    """
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{folder}: is a file, expected a folder for the dataset")
    if not overwrite and (folder / FILE_NAME).exists():
        raise InputError(f"{folder / FILE_NAME}: exists already; --overwrite replaces the dataset")


@contextmanager
def replacing_dataset(folder: Path, overwrite: bool) -> Iterator[Path]:
    """A temporary folder for a new dataset, whose files move to ``folder`` when all are written.

    The dataset's JSON is moved last, and an old one is removed first, with the files that it names: so
    a reader finds the old dataset, none, or the new one at any time. After any failure, an
    interruption too, the folder is unchanged. The temporary one is inside it, as it may be a volume of
    its own.
    """
    refuse_existing(folder, overwrite)
    created = _make_with_parents(folder)
    try:
        with temporary_folder(prefix=".collecting-", parent=folder) as temporary:
            new, old = temporary / "new", temporary / "old"
            new.mkdir()
            old.mkdir()
            yield new
            if not overwrite:
                _refuse_other_files(folder, new)
            _exchange_datasets(folder, new, old)
    except OSError as error:
        raise InfrastructureError(f"{folder}: cannot be written: {error.strerror or error}") from error
    finally:
        for path in created:
            with suppress(OSError):  # not empty: something was written meanwhile
                path.rmdir()


def _make_with_parents(folder: Path) -> list[Path]:
    """Make a folder and its parents; return the new ones, innermost first."""
    missing = [path for path in (folder, *folder.parents) if not path.exists()]
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InfrastructureError(f"{folder}: cannot be made: {error.strerror or error}") from error
    return missing


def _refuse_other_files(folder: Path, new: Path) -> None:
    """Refuse to replace files that are not part of a dataset, such as a recorded motion."""
    for path in sorted(new.iterdir()):
        old = folder / path.name
        if old.exists() and not (old.is_file() and filecmp.cmp(path, old, shallow=False)):
            raise InputError(f"{old}: exists already and differs; --overwrite replaces it")


def _exchange_datasets(folder: Path, new: Path, old: Path) -> None:
    """Exchange the old dataset for the new one; all or nothing."""
    arriving = sorted((path.name for path in new.iterdir()), key=lambda name: name == FILE_NAME)
    leaving = [FILE_NAME, *sorted({*arriving, *_data_files_of(folder / FILE_NAME)} - {FILE_NAME})]
    try:
        for name in leaving:
            if (folder / name).exists():
                (folder / name).rename(old / name)
        for name in arriving:
            (new / name).rename(folder / name)
    except BaseException:
        for name in arriving:
            if not (new / name).exists():
                (folder / name).unlink(missing_ok=True)
        for path in old.iterdir():
            path.rename(folder / path.name)
        raise


def _data_files_of(dataset: Path) -> set[str]:
    """Return the data files that a dataset's collections name; empty if it cannot be read."""
    try:
        collections = json.loads(dataset.read_bytes())["collections"].values()
        named = {data["data_file"] for c in collections for data in c["data"].values() if "data_file" in data}
    except (OSError, ValueError, LookupError, TypeError, AttributeError, RecursionError):
        return set()
    return {name for name in named if isinstance(name, str) and Path(name).name == name}
