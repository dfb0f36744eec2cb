"""Labels of all collections: the detections of patterns by sensors, checked and converted in one pass."""

from collections.abc import Iterator, Mapping, Sequence
from itertools import chain
from pathlib import Path
from typing import NamedTuple

import numpy as np

from calibration.base.arrays import Array, BoolArray, IntArray
from calibration.engine.dataset.document import MissingFileError, Node, NotNumbersError, integers
from calibration.engine.dataset.edges import read_pose
from calibration.engine.dataset.modalities import IndexedPoints, PointData
from calibration.engine.dataset.model import Collection, CornerLabels, Labels, PointLabels, PoseLabels, Sensor
from calibration.engine.dataset.pattern import Pattern, read_corners

MAX_POINTS = 1 << 40
"""Limit of the number of points of a cloud, scan or depth image."""
MAX_RANGE_M = 1e4
"""m: limit of a sensor's range."""
OUTSIDE_SHARE = 0.1
"""Limit of the share of a camera's corners outside of its image: a few are errors of a detector."""


class _Detection(NamedTuple):
    """Detection of one pattern by one sensor in one collection."""

    collection: int
    pattern: str
    sensor: str
    label: Node
    idxs: Node


class ReadLabels(NamedTuple):
    """Labels of a dataset, and the missing data files."""

    collections: tuple[Collection, ...]
    missing_files: Mapping[str, tuple[str, ...]]
    """By sensor: missing files that its labels refer to. These labels are left out."""


def read_labels(
    collections: Sequence[Node],
    sensors: Mapping[str, Sensor],
    patterns: Mapping[str, Pattern],
    version: str,
    data: Path | None = None,
) -> ReadLabels:
    """Read the labels of all collections, in the same order; data files are searched in ``data`` if it is given.

    Raises:
        InputError: something in the labels or in a labelled point cloud, scan or depth image is missing or wrong.
        InfrastructureError: OpenCV, which decodes depth images, is missing.
    """
    corners: list[_Detection] = []
    points: list[_Detection] = []
    poses: list[_Detection] = []
    for i, collection in enumerate(collections):
        for pattern, by_sensor in _by_pattern(collection["labels"], patterns, version):
            for sensor, label in by_sensor.items():
                if sensor not in sensors:
                    raise label.fault(f"no sensor '{sensor}' in the dataset (sensors: {', '.join(sensors)})")
                if label["detected"].flag() and (idxs := label["idxs"]).sequence():
                    modality = sensors[sensor].modality
                    kind = corners if modality.has_corners else poses if modality.has_poses else points
                    kind.append(_Detection(i, pattern, sensor, label, idxs))
    found: list[dict[tuple[str, str], Labels]] = [{} for _ in collections]
    missing: dict[str, dict[str, None]] = {}
    everything: list[tuple[_Detection, Labels | MissingFileError]] = [
        *zip(corners, _read_corners(corners, patterns, sensors), strict=True),
        *zip(points, _read_points(points, collections, sensors, data), strict=True),
        *((each, _read_pose(each.idxs)) for each in poses),
    ]
    for detection, labels in everything:
        if isinstance(labels, MissingFileError):
            missing.setdefault(detection.sensor, {})[str(labels)] = None
        else:
            found[detection.collection][detection.pattern, detection.sensor] = labels
    return ReadLabels(
        tuple(Collection(node.keys[-1], labels) for node, labels in zip(collections, found, strict=True)),
        {sensor: tuple(files) for sensor, files in missing.items()},
    )


def _by_pattern(labels: Node, patterns: Mapping[str, Pattern], version: str) -> Iterator[tuple[str, Node]]:
    """Iterate over patterns with their labels by sensor; version 2 has one pattern and does not name it."""
    if version == "2.0":
        yield next(iter(patterns)), labels
        return
    for pattern, by_sensor in labels.items():
        if pattern not in patterns:
            raise by_sensor.fault(f"no pattern '{pattern}' in the dataset (patterns: {', '.join(patterns)})")
        yield pattern, by_sensor


def _read_corners(
    detections: Sequence[_Detection], patterns: Mapping[str, Pattern], sensors: Mapping[str, Sensor]
) -> Iterator[CornerLabels]:
    if not detections:
        return
    numbers, pixels = read_corners(detection.idxs for detection in detections)
    batch = _Batch([len(detection.idxs.value) for detection in detections])
    known = [len(patterns[detection.pattern].corners) for detection in detections]
    if (wrong := batch.outside(numbers, known)) is not None:
        i, position = wrong
        raise _element_at(detections[i].idxs, position)["id"].unexpected(
            f"the id of a corner of pattern '{detections[i].pattern}', 0 to {known[i] - 1}"
        )
    ids = numbers.astype(np.int64)
    if (again := batch.repeated(ids)) is not None:
        i, position = again
        raise _element_at(detections[i].idxs, position)["id"].unexpected("every id once")
    _check_pixels(detections, batch, pixels, sensors)
    ids.flags.writeable = pixels.flags.writeable = False
    for part in batch.parts:
        yield CornerLabels(ids[part], pixels[part])


def _check_pixels(
    detections: Sequence[_Detection], batch: "_Batch", pixels: Array, sensors: Mapping[str, Sensor]
) -> None:
    """Refuse a corner far outside of its image, and cameras with many corners outside."""
    cameras = [sensors[detection.sensor].camera for detection in detections]
    sizes = np.array([(camera.width, camera.height) if camera else (0, 0) for camera in cameras], float)[batch.owner]
    if (far := batch.first(np.any((pixels < -sizes) | (pixels > 2 * sizes), axis=-1))) is not None:
        i, position = far
        x, y = pixels[batch.parts[i]][position]
        width, height = sizes[batch.parts[i]][position]
        raise _element_at(detections[i].idxs, position).fault(
            f"found a corner at ({x:g}, {y:g}) px, expected one in the image of {width:g} x {height:g} px of sensor "
            f"'{detections[i].sensor}' (camera_info)"
        )
    outside = ((pixels < -1) | (pixels > sizes)).any(-1)
    for name in dict.fromkeys(detection.sensor for detection in detections) if outside.any() else ():
        of_camera = np.array([detection.sensor == name for detection in detections])[batch.owner]
        if (outside & of_camera).sum() > OUTSIDE_SHARE * of_camera.sum():
            i, position = batch.place(int((outside & of_camera).argmax()))
            x, y = pixels[batch.parts[i]][position]
            width, height = sizes[batch.parts[i]][position]
            raise _element_at(detections[i].idxs, position).fault(
                f"found a corner at ({x:g}, {y:g}) px, one of {(outside & of_camera).sum()} of {of_camera.sum()} that "
                f"sensor '{name}' has outside of its image of {width:g} x {height:g} px; does its camera_info have the "
                "size of the images?"
            )


def _read_pose(idxs: Node) -> PoseLabels:
    if len(idxs.sequence()) != 1:
        raise idxs.fault(f"found {len(idxs.sequence())} poses, expected one")
    return PoseLabels(read_pose(_element_at(idxs, 0), MAX_RANGE_M))


def _read_points(
    detections: Sequence[_Detection], collections: Sequence[Node], sensors: Mapping[str, Sensor], folder: Path | None
) -> Iterator[PointLabels | MissingFileError]:
    """Read the labelled points of each detection; a missing file is returned as its error."""
    if not detections:
        return
    batch, index = _read_indices([detection.idxs for detection in detections])
    data_of = [sensors[detection.sensor].modality.point_data for detection in detections]
    limit_lists = [_limit_points(each.label, data) for each, data in zip(detections, data_of, strict=True)]
    limit_batch, limits = _read_indices(limit_lists)
    positions, missing = batch.find(index, limit_batch, limits)
    if missing is not None:
        i, position = missing
        raise _element_at(limit_lists[i], position).unexpected("one of 'idxs'")
    points = np.zeros((len(index), 3))
    clouds: dict[str, IndexedPoints | MissingFileError] = {}  # of one collection, to limit memory
    not_there: dict[int, MissingFileError] = {}
    collection = None
    for i, (detection, data, part) in enumerate(zip(detections, data_of, batch.parts, strict=True)):
        if detection.collection != collection:
            collection, clouds = detection.collection, {}
        if detection.sensor not in clouds:
            message = collections[collection]["data"][detection.sensor]
            if folder is not None:
                message = Node(folder / message.file.name, message.keys, message.value)
            clouds[detection.sensor] = _read_cloud(data, message, sensors[detection.sensor])
        cloud = clouds[detection.sensor]
        if isinstance(cloud, MissingFileError):
            not_there[i] = cloud
            continue
        try:
            with np.errstate(invalid="ignore"):  # signalling NaNs; they are refused below
                points[part] = cloud.take(index[part])
        except IndexError:
            wrong = _element_at(detection.idxs, int((index[part] >= len(cloud)).argmax()))
            raise wrong.unexpected(f"the index of one of the {data.count.format(len(cloud))}") from None
    if not np.isfinite(points).all():
        i, position = batch.place(int(np.isfinite(points).all(-1).argmin()))
        nothing = data_of[i].nothing.format(index[batch.parts[i]][position])
        raise _element_at(detections[i].idxs, position).fault(nothing)
    if (far := batch.first(np.any(abs(points) > MAX_RANGE_M, axis=-1))) is not None:
        i, position = far
        raise _element_at(detections[i].idxs, position).fault(
            f"found point {index[batch.parts[i]][position]} of sensor '{detections[i].sensor}' "
            f"{abs(points[batch.parts[i]][position]).max():g} m away, expected {MAX_RANGE_M:g} m at most"
        )
    points.flags.writeable = positions.flags.writeable = False
    for i, (part, limit_part) in enumerate(zip(batch.parts, limit_batch.parts, strict=True)):
        yield not_there.get(i) or PointLabels(points[part], positions[limit_part])


def _read_cloud(data: PointData, message: Node, sensor: Sensor) -> IndexedPoints | MissingFileError:
    try:
        return data.read(message, sensor.camera)
    except MissingFileError as error:
        return error


def _limit_points(label: Node, data: PointData) -> Node:
    """Return the limit points, from the first of their possible keys that is present."""
    *others, last = data.limits
    if node := next((node for key in others if (node := label.get(key))), None) or label.get(last):
        return node
    if not others:
        return label[last]
    raise label.fault(f"missing key {' or '.join(map(repr, data.limits))}")


def _read_indices(lists: Sequence[Node]) -> "tuple[_Batch, IntArray]":
    """Parse indices, not yet checked against the size of a cloud."""
    try:
        index = integers(list(chain.from_iterable(node.sequence() for node in lists)))
    except NotNumbersError:  # check one by one, to report the first invalid one
        elements = chain.from_iterable(node.elements() for node in lists)
        index = np.array([element.whole(0, MAX_POINTS) for element in elements], np.int64)
    batch = _Batch([len(node.value) for node in lists])
    if len(index) and not (index.min() >= 0 and index.max() < MAX_POINTS):
        i, position = batch.place(int(((index < 0) | (index >= MAX_POINTS)).argmax()))
        raise _element_at(lists[i], position).unexpected("the index of a point of the cloud, or a pixel of the image")
    return batch, index


def _element_at(indices: Node, position: int) -> Node:
    return list(indices.elements())[position]


class _Batch:
    """Rows of several lists, concatenated."""

    def __init__(self, counts: Sequence[int]) -> None:
        self.ends = np.cumsum(counts)
        self.owner = np.repeat(np.arange(len(counts)), counts)
        """Index of the list of each row."""
        ends = self.ends.tolist()
        self.parts = [slice(end - count, end) for end, count in zip(ends, counts, strict=True)]

    def place(self, row: int) -> tuple[int, int]:
        """Return the list of a row and its position in the list."""
        i = int(self.owner[row])
        return i, row - self.parts[i].start

    def first(self, wrong: BoolArray) -> tuple[int, int] | None:
        """Return the place of the first marked row."""
        return self.place(int(wrong.argmax())) if wrong.any() else None

    def outside(self, values: Array, bounds: Sequence[int]) -> tuple[int, int] | None:
        """Return the place of the first value that is not an integer from 0 to below its list's bound."""
        return self.first(~((values >= 0) & (values < np.array(bounds)[self.owner]) & (values == np.floor(values))))

    def keys(self, index: IntArray) -> IntArray:
        """Return keys of rows: equal if list and index are equal."""
        return self.owner * MAX_POINTS + index

    def repeated(self, index: IntArray) -> tuple[int, int] | None:
        """Return the place of the first row with an index that its list has before."""
        keys = self.keys(index)
        order = np.argsort(keys, kind="stable")
        wrong = np.zeros(len(keys), bool)
        wrong[order[1:]] = np.diff(keys[order]) == 0
        return self.first(wrong)

    def find(self, index: IntArray, other: "_Batch", wanted: IntArray) -> tuple[IntArray, tuple[int, int] | None]:
        """Return the position of each index of another batch in its own list, and the place of the first missing."""
        keys, wanted_keys = self.keys(index), other.keys(wanted)
        order = np.argsort(keys, kind="stable")
        rows = order[np.searchsorted(keys, wanted_keys, sorter=order).clip(max=len(keys) - 1)]
        starts = np.array([part.start for part in self.parts])
        return rows - starts[other.owner], other.first(keys[rows] != wanted_keys)
