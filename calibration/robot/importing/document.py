"""Document of an imported dataset: ATOM's ``dataset.json``, version 3.0."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from calibration.base.arrays import Array
from calibration.engine.dataset.configuration import Configuration, SensorConfiguration
from calibration.engine.dataset.edges import pose_document, transform_documents
from calibration.engine.dataset.frames import VELOCITIES_KEY, velocity_documents
from calibration.engine.dataset.modalities import MODALITIES
from calibration.engine.dataset.model import CHOSEN_MODELS, ESTIMATED_KEY, ROUGH_KEY, Edge, LensUncertainty
from calibration.engine.dataset.pattern import pattern_document
from calibration.engine.dataset.sensors import UNCERTAINTY_KEY, camera_document, uncertainty_document
from calibration.engine.geometry.cameras import Camera
from calibration.engine.geometry.frames import FrameTree
from calibration.robot.importing.bags.range_views import LabelledRange, RangeView
from calibration.robot.importing.image_views import FoundCorners, LabelledMoment
from calibration.robot.labelling.points import PatternPoints
from calibration.robot.simulation.sensors.sensor import range_label_document

RECORDING_USER = "calibration-ci"


@dataclass(frozen=True, eq=False)
class Imported:
    """Content of an imported dataset."""

    robot: str
    configuration: Configuration
    cameras: Mapping[str, Camera]
    estimated: Mapping[str, str]
    """Cameras whose intrinsics are an initial guess from the corners: why they have their lens model."""
    moments: Sequence[LabelledMoment]
    ranges: Sequence[Mapping[str, LabelledRange]]
    """Data of LiDARs and depth cameras, at each moment."""
    transforms: Mapping[Edge, Array]
    """(N, 4, 4): at each moment."""
    rough: bool
    """Whether the calibrated transforms are only an initial guess."""
    chosen: Collection[str] = ()
    """Those of them whose lens model import.yml has."""
    uncertainties: Mapping[str, LensUncertainty] = field(default_factory=dict)
    """How well the intrinsics are known, of cameras whose file says so."""
    poses: Mapping[tuple[str, str], Array] = field(default_factory=dict)
    """Measured poses ``T_sensor_pattern`` (N, 4, 4) at the moments, by sensor and pattern."""
    motions: Mapping[Edge, Array] = field(default_factory=dict)
    """(N, 3, 6): velocity, acceleration and jerk of frames that move, see `calibration.engine.dataset.frames`."""

    @property
    def seen(self) -> list[list[str]]:
        """Sensors with a detected pattern, at each moment."""
        return [
            [name for name, view in moment.views.items() if view.labelled]
            + [name for name, each in own.items() if any(isinstance(f, PatternPoints) for f in each.found.values())]
            for moment, own in zip(self.moments, self.ranges, strict=True)
        ]

    @property
    def keys(self) -> list[str]:
        """Keys of the collections, such as "000"."""
        return [f"{number:03d}" for number in range(len(self.moments))]


def _kinds_of_transforms(configuration: Configuration) -> dict[str, Any]:
    """Return whether each additional transform is one or one in each collection, whatever the guesses are."""
    return {
        f"{parent}-{child}": {
            "parent": parent,
            "child": child,
            "type": "multiple" if name in configuration.moving_tfs else "fixed",
        }
        for name, (parent, child) in configuration.additional_tfs.items()
    }


def data_file(sensor: str, key: str, source: str) -> str:
    """Return the name of an image in the dataset."""
    return f"{sensor.replace('/', '_')}_{key}{Path(source).suffix.lower()}"


def dataset_document(imported: Imported) -> dict[str, Any]:
    """Return the content of ``dataset.json``."""
    configuration = imported.configuration
    rows = {edge: transform_documents(edge, T) for edge, T in imported.transforms.items()}
    return {
        "_metadata": {
            "dataset_name": imported.robot,
            "package_name": "",
            "robot_name": imported.robot,
            "user": RECORDING_USER,
            "version": "3.0",
            ESTIMATED_KEY: list(imported.estimated),
            **({CHOSEN_MODELS: list(imported.chosen)} if imported.chosen else {}),
            ROUGH_KEY: imported.rough,
        },
        "additional_sensor_data": {},
        "calibration_config": configuration.to_document(),
        **({"transforms": _kinds_of_transforms(configuration)} if configuration.additional_tfs else {}),
        "sensors": {name: _sensor_entry(imported, sensor) for name, sensor in configuration.sensors.items()},
        "patterns": {name: pattern_document(p.pattern(), {}) for name, p in configuration.patterns.items()},
        "collections": {
            key: {
                "additional_data": {},
                "data": {
                    **{
                        name: _image_message(imported, name, data_file(name, key, view.file))
                        for name, view in moment.views.items()
                    },
                    **{name: _range_message(imported, name, key, each.view) for name, each in ranges.items()},
                    **{name: {"header": _message_header(imported, name)} for name, _ in imported.poses},
                },
                "joints": {},
                "labels": {
                    pattern: {
                        **{name: label_document(view.found[pattern]) for name, view in moment.views.items()},
                        **{name: range_label_document(each.found[pattern]) for name, each in ranges.items()},
                        **{
                            name: {"detected": True, "idxs": [pose_document(T[number])]}
                            for (name, measured), T in imported.poses.items()
                            if measured == pattern
                        },
                    }
                    for pattern in configuration.patterns
                },
                "transforms": {"-".join(edge): documents[number] for edge, documents in rows.items()},
                **({VELOCITIES_KEY: moving} if (moving := velocity_documents(imported.motions, number)) else {}),
            }
            for number, (key, moment, ranges) in enumerate(
                zip(imported.keys, imported.moments, imported.ranges, strict=True)
            )
        },
    }


def label_document(found: FoundCorners) -> dict[str, Any]:
    """Return the labels of one image in the dataset's form."""
    places = zip(found.pixels[::2], found.pixels[1::2], strict=True)
    rows = [{"id": i, "x": x, "y": y} for i, (x, y) in zip(found.ids, places, strict=True)]
    return {"detected": bool(rows), "idxs": rows}


def _image_message(imported: Imported, sensor: str, file: str) -> dict[str, Any]:
    camera = imported.cameras[sensor]
    return {
        "data_file": file,
        "encoding": "bgr8",
        "header": _message_header(imported, sensor),
        "height": camera.height,
        "is_bigendian": 0,
        "step": 3 * camera.width,
        "width": camera.width,
    }


def _range_message(imported: Imported, sensor: str, key: str, view: RangeView) -> dict[str, Any]:
    file = {} if view.file is None else {"data_file": data_file(sensor, key, view.file.name)}
    return {**view.message, **file, "header": _message_header(imported, sensor)}


def _message_header(imported: Imported, sensor: str) -> dict[str, Any]:
    frame = imported.configuration.sensors[sensor].link
    return {"frame_id": frame, "seq": 0, "stamp": {"nsecs": 0, "secs": 0}}


def _sensor_entry(imported: Imported, sensor: SensorConfiguration) -> dict[str, Any]:
    steps = FrameTree(imported.transforms).path(imported.configuration.world_link, sensor.link)
    return {
        "_name": sensor.name,
        "calibration_child": sensor.child_link,
        "calibration_parent": sensor.parent_link,
        **(_camera_info(imported, sensor.name) if sensor.name in imported.cameras else {}),
        "chain": [{"parent": s.parent, "child": s.child, "key": f"{s.parent}-{s.child}"} for s in steps],
        "modality": sensor.modality,
        "msg_type": MODALITIES[sensor.modality].message,
        "parent": sensor.link,
        "topic": sensor.topic_name,
    }


def _camera_info(imported: Imported, sensor: str) -> dict[str, Any]:
    camera, known = imported.cameras[sensor], imported.uncertainties.get(sensor)
    info = {**camera_document(camera), "R": np.eye(3).ravel().tolist(), "binning_x": 0, "binning_y": 0}
    if known is not None:
        info[UNCERTAINTY_KEY] = uncertainty_document(known)
    return {"camera_info": info, "camera_info_topic": ""}
