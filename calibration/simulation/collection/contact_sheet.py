"""A picture of all poses: what each sensor saw with what was detected in it, and what was lost and why."""

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from calibration.dataset.depth_image import NO_RETURN, read_depth_image
from calibration.dataset.pointcloud import read_points
from calibration.errors import InputError
from calibration.estimation.median import median
from calibration.files import write_atomically
from calibration.geometry.types import Array
from calibration.labelling.detection import DepthImage, Image
from calibration.simulation.collection.record import Record
from calibration.simulation.collection.stored_scan import scan_points
from calibration.simulation.system import System

FILE = "contact_sheet.png"
WIDTH = 1600
"""About how wide the sheet is, px."""
HEIGHT = 160
"""Of one picture, px."""
MOST_POSES = 120
"""More are not shown."""
_GAP, _LINE = 6, 16
_PAPER, _INK, _RED = (250, 250, 250), (60, 60, 60), (40, 40, 200)
_FONT, _TEXT_SIZE = cv2.FONT_HERSHEY_SIMPLEX, 0.38
_SHIFT = 4  # drawing with sixteenths of a pixel
_COLOURS = cv2.applyColorMap(np.arange(256, dtype=np.uint8)[:, None], cv2.COLORMAP_JET)[:, 0]
_FROM_NEAR = cv2.applyColorMap(np.arange(256, dtype=np.uint8)[::-1, None], cv2.COLORMAP_BONE)[:, 0]
_ON_PATTERN, _ON_BORDER = (90, 200, 90), (60, 120, 255)
_DOT = 24  # the radius of a corner's mark, in these


def write_contact_sheet(folder: Path, system: System, records: Sequence[Record], files: Path) -> None:
    """Write the sheet.

    Args:
        folder: where the sheet goes.
        system: whose sensors look.
        records: of every pose, lost ones too.
        files: the folder with the images, depth images and clouds of the records.

    Raises:
        WorldError: it cannot be written.
    """
    tiles = [_tile(system, record, files) for record in records[:MOST_POSES]]
    columns = max(1, round(WIDTH / tiles[0].shape[1]))
    tiles += [np.full_like(tiles[0], _PAPER)] * (-len(tiles) % columns)
    rows = [np.hstack(tiles[i : i + columns]) for i in range(0, len(tiles), columns)]
    done, data = cv2.imencode(".png", np.vstack(rows), [cv2.IMWRITE_PNG_COMPRESSION, 4])
    if not done:
        raise AssertionError("OpenCV cannot write .png")
    write_atomically(folder / FILE, bytes(data))


def _tile(system: System, record: Record, files: Path) -> Image:
    """One pose: its pictures side by side, each under a line that says what it shows; what was lost is framed."""
    pictures = [(_camera(system, record, name, files), name, "corners") for name in system.cameras]
    pictures += [(_cloud(record, name, files), name, "points") for name in system.lidars]
    pictures += [(_scan(system, record, name), name, "rays") for name in system.lidars2d]
    pictures += [(_depth(system, record, name, files), name, "pixels") for name in system.depth_cameras]
    parts = []
    for picture, name, what in pictures:
        if not record.kept:
            cv2.rectangle(picture, (0, 0), (picture.shape[1] - 1, HEIGHT - 1), _RED, 2)
        found = f"{record.labels[name]} {what}" if record.labels[name] else "not detected"
        part = np.vstack([_line(f"{name}: {found}", picture.shape[1], _INK), picture])
        parts += [part, np.full((len(part), _GAP, 3), _PAPER, np.uint8)]
    row = np.hstack(parts) if parts else np.full((_LINE + HEIGHT, WIDTH // 4, 3), _PAPER, np.uint8)
    title = f"{record.number + 1}" if record.kept else f"{record.number + 1}  lost: {'; '.join(record.lost)}"
    heading = _line(title, row.shape[1], _INK if record.kept else _RED)
    return np.vstack([heading, row, np.full((_GAP, row.shape[1], 3), _PAPER, np.uint8)])


def _line(text: str, width: int, colour: tuple[int, int, int]) -> Image:
    """A line of text as a picture; what is too long is cut."""
    picture = np.full((_LINE, width, 3), _PAPER, np.uint8)
    cv2.putText(picture, text, (2, _LINE - 5), _FONT, _TEXT_SIZE, colour, 1, cv2.LINE_AA)
    return picture


def _camera(system: System, record: Record, name: str, files: Path) -> Image:
    """A camera's image, small, with the corners in the colours of their order."""
    camera = system.cameras[name].camera
    scale = HEIGHT / camera.height
    size = (max(1, round(scale * camera.width)), HEIGHT)
    file = files / record.collection["data"][name]["data_file"]
    image = cv2.imread(str(file), cv2.IMREAD_COLOR) if file.is_file() else None  # it warns of one that is not there
    picture = (
        np.full((size[1], size[0], 3), 128, np.uint8)
        if image is None
        else cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    )
    drawn: Image = np.asarray(
        cv2.convertScaleAbs(picture, alpha=0.8, beta=40), np.uint8
    )  # paler, so that the marks stand out
    for pattern, by_sensor in record.collection["labels"].items():
        labels = by_sensor[name]["idxs"]
        total = len(system.patterns[pattern].corners)
        for label in labels:
            at = scale * (np.array([label["x"], label["y"]]) + 0.5) - 0.5
            cv2.circle(drawn, _fine(at), _DOT, _colour(label["id"] / total), -1, cv2.LINE_AA, _SHIFT)
    return drawn


def _cloud(record: Record, name: str, files: Path) -> Image:
    """A LiDAR's cloud as it looks from the sensor: azimuth to the left, elevation up."""
    picture = np.full((HEIGHT, 2 * HEIGHT, 3), (45, 40, 35), np.uint8)
    try:
        points = read_points(files / record.collection["data"][name]["data_file"])
    except InputError:
        points = np.empty((0, 3))
    if len(points):
        middle = np.arctan2(*points.mean(axis=0)[[1, 0]])
        azimuth = (np.arctan2(points[:, 1], points[:, 0]) - middle + np.pi) % (2 * np.pi) - np.pi
        elevation = np.arctan2(points[:, 2], np.hypot(points[:, 0], points[:, 1]))
        place = np.column_stack([_spread(-azimuth, 2 * HEIGHT), _spread(-elevation, HEIGHT)])
        groups = [(range(len(points)), (150, 140, 130), 1)]
        for by_sensor in record.collection["labels"].values():
            groups += [
                (by_sensor[name]["idxs"], _ON_PATTERN, 1),
                (by_sensor[name]["idxs_limit_points"], _ON_BORDER, 2),
            ]
        for indices, colour, radius in groups:
            for at in place[list(indices)]:
                cv2.circle(picture, _fine(at), radius << _SHIFT, colour, -1, cv2.LINE_AA, _SHIFT)
    return picture


def _scan(system: System, record: Record, name: str) -> Image:
    """A 2D LiDAR's scan from above, the sensor at the bottom, x up; as far as twice the pattern's distance."""
    picture = np.full((HEIGHT, 2 * HEIGHT, 3), (45, 40, 35), np.uint8)
    ranges = record.collection["data"][name].get("ranges")
    if ranges is None:  # of applications in containers, whose scans are not drawn
        return picture
    points = scan_points(system.lidars2d[name], np.array(ranges))[:, :2]
    labels = [by_sensor[name] for by_sensor in record.collection["labels"].values()]
    shown = [index for label in labels for index in label["idxs"]] or np.flatnonzero(np.isfinite(points[:, 0])).tolist()
    if shown:
        reach = 2 * median(np.linalg.norm(points[shown], axis=-1))
        place = np.array([HEIGHT, HEIGHT - 1]) - HEIGHT / reach * points[:, ::-1]
        inside = np.flatnonzero(((place >= 0) & (place < [2 * HEIGHT, HEIGHT])).all(-1))
        groups = [(inside.tolist(), (150, 140, 130), 1)]
        for label in labels:
            groups += [(label["idxs"], _ON_PATTERN, 1), (label["idxs_limit_points"], _ON_BORDER, 2)]
        for indices, colour, radius in groups:
            for at in place[indices]:
                cv2.circle(picture, _fine(at), radius << _SHIFT, colour, -1, cv2.LINE_AA, _SHIFT)
    return picture


def _depth(system: System, record: Record, name: str, files: Path) -> Image:
    """A depth camera's image, small, near pale and far dark; the labelled pixels in their colours."""
    camera = system.depth_cameras[name].camera
    width = max(1, round(HEIGHT / camera.height * camera.width))
    try:
        depth = read_depth_image(files / record.collection["data"][name]["data_file"], camera).depth
    except InputError:
        return np.full((HEIGHT, width, 3), 128, np.uint8)
    rows, columns = (np.arange(n) * size // n for n, size in ((HEIGHT, camera.height), (width, camera.width)))
    picture = _coloured(depth[rows[:, None], columns])
    for by_sensor in record.collection["labels"].values():
        for key, colour, size in (("idxs", _ON_PATTERN, 3), ("idxs_limit_points", _ON_BORDER, 1)):
            y, x = np.divmod(np.array(by_sensor[name][key], int), camera.width)
            marked = np.zeros((HEIGHT, width), np.uint8)
            marked[y * HEIGHT // camera.height, x * width // camera.width] = 1
            picture[cv2.dilate(marked, np.ones((size, size), np.uint8)) > 0] = colour  # labels are thinned
    return picture


def _coloured(depth: DepthImage) -> Image:
    """Depths (h, w) in colours (h, w, 3) from near to far; dark where nothing came back. In whole numbers."""
    returned = (depth != NO_RETURN) & (depth != 0)
    sorted_depths = np.sort(depth[returned].astype(int))
    if not len(sorted_depths):
        return np.full((*depth.shape, 3), (45, 40, 35), np.uint8)
    near, far = sorted_depths[[len(sorted_depths) // 100, -1 - len(sorted_depths) // 100]]
    share = 255 * (np.clip(depth, near, far) - near) // max(far - near, 1)
    return np.where(returned[..., None], _FROM_NEAR[share], np.array((45, 40, 35), np.uint8))


def _spread(values: Array, length: int) -> Array:
    """Values over a length, with some space at its ends."""
    low, high = values.min(), values.max()
    share = (values - low) / max(high - low, 1e-9)
    place: Array = (0.05 + 0.9 * share) * (length - 1)
    return place


def _fine(at: Array) -> tuple[int, int]:
    """A place in sixteenths of a pixel."""
    x, y = np.floor(at * (1 << _SHIFT) + 0.5 + 1e-6).astype(int)  # so that a tie falls one way on every machine
    return int(x), int(y)


def _colour(share: float) -> tuple[int, int, int]:
    """From red over green to blue, blue first."""
    blue, green, red = _COLOURS[round(255 * (1 - share))]
    return int(blue), int(green), int(red)
