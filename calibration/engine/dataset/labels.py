"""Labels of all collections: the detections of patterns by sensors, checked and converted."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from calibration.base.arrays import Array, IntArray
from calibration.engine.dataset.document import MissingFileError, Node
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
    found: list[Collection] = []
    missing: dict[str, dict[str, None]] = {}
    corners: dict[str, list[tuple[Node, Array]]] = {}
    for collection in collections:
        labels: dict[tuple[str, str], Labels] = {}
        clouds: dict[str, IndexedPoints | MissingFileError] = {}
        for pattern, by_sensor in _by_pattern(collection["labels"], patterns, version):
            for name, label in by_sensor.items():
                if name not in sensors:
                    raise label.fault(f"no sensor '{name}' in the dataset (sensors: {', '.join(sensors)})")
                if not label["detected"].flag() or not (idxs := label["idxs"]).sequence():
                    continue
                sensor = sensors[name]
                if sensor.modality.has_poses:
                    labels[pattern, name] = _read_pose(idxs)
                elif sensor.modality.has_corners:
                    labels[pattern, name] = seen = _read_corners(idxs, patterns[pattern], sensor)
                    corners.setdefault(name, []).append((idxs, seen.pixels))
                else:
                    index, limits = _read_indices(label, sensor.modality.point_data)
                    if name not in clouds:
                        clouds[name] = _read_cloud(collection, sensor, data)
                    cloud = clouds[name]
                    if isinstance(cloud, MissingFileError):
                        missing.setdefault(name, {})[str(cloud)] = None
                    else:
                        labels[pattern, name] = PointLabels(_take_points(idxs, index, cloud, sensor), limits)
        found.append(Collection(collection.keys[-1], labels))
    for name, labelled in corners.items():
        _refuse_many_outside(sensors[name], labelled)
    return ReadLabels(tuple(found), {sensor: tuple(files) for sensor, files in missing.items()})


def _by_pattern(labels: Node, patterns: Mapping[str, Pattern], version: str) -> Iterator[tuple[str, Node]]:
    """Iterate over patterns with their labels by sensor; version 2 has one pattern and does not name it."""
    if version == "2.0":
        yield next(iter(patterns)), labels
        return
    for pattern, by_sensor in labels.items():
        if pattern not in patterns:
            raise by_sensor.fault(f"no pattern '{pattern}' in the dataset (patterns: {', '.join(patterns)})")
        yield pattern, by_sensor


def _read_corners(idxs: Node, pattern: Pattern, sensor: Sensor) -> CornerLabels:
    numbers, pixels = read_corners(idxs)
    known = (numbers >= 0) & (numbers < len(pattern.corners)) & (numbers == np.floor(numbers))
    if not known.all():
        raise _element_at(idxs, int(known.argmin()))["id"].unexpected(
            f"the id of a corner of pattern '{pattern.name}', 0 to {len(pattern.corners) - 1}"
        )
    ids = numbers.astype(np.int64)
    first_of_each = np.unique(ids, return_index=True)[1]
    if len(first_of_each) < len(ids):
        again = np.setdiff1d(np.arange(len(ids)), first_of_each)
        raise _element_at(idxs, int(again[0]))["id"].unexpected("every id once")
    size = _image_size(sensor)
    far = ((pixels < -size) | (pixels > 2 * size)).any(-1)
    if far.any():
        x, y = pixels[far.argmax()]
        raise _element_at(idxs, int(far.argmax())).fault(
            f"found a corner at ({x:g}, {y:g}) px, expected one in the image of {size[0]:g} x {size[1]:g} px of sensor "
            f"'{sensor.name}' (camera_info)"
        )
    ids.flags.writeable = pixels.flags.writeable = False
    return CornerLabels(ids, pixels)


def _image_size(sensor: Sensor) -> Array:
    if sensor.camera is None:
        raise AssertionError("a sensor with corners has intrinsics")
    return np.array([sensor.camera.width, sensor.camera.height], float)


def _refuse_many_outside(sensor: Sensor, labelled: Sequence[tuple[Node, Array]]) -> None:
    """Refuse a camera with many corners outside of its image."""
    size = _image_size(sensor)
    outside = [((pixels < -1) | (pixels > size)).any(-1) for _, pixels in labelled]
    count, total = sum(int(each.sum()) for each in outside), sum(len(pixels) for _, pixels in labelled)
    if count > OUTSIDE_SHARE * total:
        (idxs, pixels), which = next((seen, each) for seen, each in zip(labelled, outside, strict=True) if each.any())
        x, y = pixels[which.argmax()]
        raise _element_at(idxs, int(which.argmax())).fault(
            f"found a corner at ({x:g}, {y:g}) px, one of {count} of {total} that sensor '{sensor.name}' has outside "
            f"of its image of {size[0]:g} x {size[1]:g} px; does its camera_info have the size of the images?"
        )


def _read_pose(idxs: Node) -> PoseLabels:
    if len(idxs.sequence()) != 1:
        raise idxs.fault(f"found {len(idxs.sequence())} poses, expected one")
    return PoseLabels(read_pose(_element_at(idxs, 0), MAX_RANGE_M))


def _read_indices(label: Node, data: PointData) -> tuple[IntArray, IntArray]:
    """Return the indices (N,) of labelled points, not yet checked against a cloud, and the places of the limits."""
    limit_node = _limit_points(label, data)
    index, limits = _read_integers(label["idxs"]), _read_integers(limit_node)
    order = np.argsort(index, kind="stable")
    places = order[np.searchsorted(index, limits, sorter=order).clip(max=len(index) - 1)]
    wrong = index[places] != limits
    if wrong.any():
        raise _element_at(limit_node, int(wrong.argmax())).unexpected("one of 'idxs'")
    places.flags.writeable = False
    return index, places


def _read_integers(node: Node) -> IntArray:
    values = node.sequence()
    if not set(map(type, values)) <= {int}:
        values = [element.whole(0, MAX_POINTS) for element in node.elements()]
    if values and not (min(values) >= 0 and max(values) < MAX_POINTS):
        wrong = next(k for k, value in enumerate(values) if not 0 <= value < MAX_POINTS)
        raise _element_at(node, wrong).unexpected("the index of a point of the cloud, or a pixel of the image")
    return np.array(values, np.int64)


def _take_points(idxs: Node, index: IntArray, cloud: IndexedPoints, sensor: Sensor) -> Array:
    """Return the labelled points (N, 3) of a cloud, a scan or an image."""
    data = sensor.modality.point_data
    try:
        with np.errstate(invalid="ignore"):  # signalling NaNs; they are refused below
            points = cloud.take(index)
    except IndexError:
        wrong = _element_at(idxs, int((index >= len(cloud)).argmax()))
        raise wrong.unexpected(f"the index of one of the {data.count.format(len(cloud))}") from None
    measured = np.isfinite(points).all(-1)
    if not measured.all():
        k = int(measured.argmin())
        raise _element_at(idxs, k).fault(data.nothing.format(index[k]))
    far = (abs(points) > MAX_RANGE_M).any(-1)
    if far.any():
        k = int(far.argmax())
        raise _element_at(idxs, k).fault(
            f"found point {index[k]} of sensor '{sensor.name}' {abs(points[k]).max():g} m away, expected "
            f"{MAX_RANGE_M:g} m at most"
        )
    points.flags.writeable = False
    return points


def _read_cloud(collection: Node, sensor: Sensor, folder: Path | None) -> IndexedPoints | MissingFileError:
    """Read a sensor's data in a collection; a missing file is returned as its error."""
    message = collection["data"][sensor.name]
    if folder is not None:
        message = Node(folder / message.file.name, message.keys, message.value)
    try:
        return sensor.modality.point_data.read(message, sensor.camera)
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


def _element_at(indices: Node, position: int) -> Node:
    return list(indices.elements())[position]
