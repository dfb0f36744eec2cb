"""Records of poses, and the collection of all poses of a motion: each is captured, labelled and checked.

The record of a pose is its part of the dataset, or the reasons for its rejection, and the quality of its labels. It is
plain JSON, so that an interrupted collection can be continued from the records on disk.

The contact sheet shows all poses: the data and detections of each sensor, and the reasons of rejected poses.
"""

import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from calibration.base import write_atomically
from calibration.base.arrays import Array
from calibration.ci.execution.tasks import Task, Workspace, run_tasks
from calibration.engine.dataset.model import CornerLabels, Edge
from calibration.engine.geometry import rotations
from calibration.engine.geometry.frames import JOINT_PARAMETERS
from calibration.engine.geometry.transforms import apply, inverse
from calibration.robot.labelling.detection import Image
from calibration.robot.labelling.points import PatternPoints
from calibration.robot.simulation.capture import Capture, Requirements, capture, reasons_to_lose
from calibration.robot.simulation.kinematics import Play
from calibration.robot.simulation.sensors.camera import encode_image
from calibration.robot.simulation.sensors.sensor import PICTURE_HEIGHT_PX, Found, SimulatedSensor
from calibration.robot.simulation.system import System
from calibration.robot.urdf import Joint, compose

ESTIMATE_DECIMALS = 5
"""Decimals of estimated poses: 10 micrometres and microradians."""


@dataclass(frozen=True)
class CornerErrors:
    """Errors of detected corners against the true projections, for one camera at one pose, px."""

    count: int
    mean: Sequence[float]
    """Along x and along y."""
    rms: float
    """Root mean square of the distances."""
    largest: float


@dataclass(frozen=True)
class Record:
    """Result of one pose. It is kept if there is no reason to reject it."""

    number: int
    """Index of the pose, from 0."""
    lost: Sequence[str]
    """Reasons why it is not part of the dataset; empty if it is."""
    labels: Mapping[str, int]
    """Number of corners or points that each sensor labelled, on all patterns together; 0 without a detection."""
    complete: Mapping[str, bool]
    """Whether a camera that detects a pattern sees all its corners, by camera."""
    errors: Mapping[str, CornerErrors]
    """Errors of the detected corners, by camera."""
    cells: Mapping[str, Sequence[int]]
    """Cells with a corner of a grid over the image (`COVERAGE_COLUMNS` x `COVERAGE_ROWS`, row by row), by camera."""
    collection: Mapping[str, Any]
    """The entry of ``collections`` in the dataset."""
    initial: Mapping[str, Mapping[str, Any]]
    """Entry of ``transforms_initial`` of each pattern."""
    truth: Sequence[Mapping[str, Any]]
    """True poses of the patterns in the world, and the transforms that differ between collections."""
    named: str | None = None
    """Key of the collection, if it was not numbered by this program."""

    @property
    def key(self) -> str:
        """Key of the collection: the index of its pose, so a rejected one leaves a gap."""
        return collection_key(self.number) if self.named is None else self.named

    @property
    def kept(self) -> bool:
        """Whether it is part of the dataset."""
        return not self.lost

    def to_json(self) -> str:
        """Format the record as JSON."""
        return json.dumps(asdict(self))

    @classmethod
    def from_json(cls, text: str | bytes) -> "Record":
        """Parse the record from JSON.

        Raises:
            ValueError, TypeError, KeyError: it is not a record.
        """
        fields = json.loads(text)
        return cls(**{**fields, "errors": {name: CornerErrors(**error) for name, error in fields["errors"].items()}})


COVERAGE_COLUMNS, COVERAGE_ROWS = 4, 3
"""Size of the grid over an image for its coverage."""


def collection_key(number: int) -> str:
    """Return the key of a collection, such as "000"."""
    return f"{number:03d}"


def record(play: Play, capture: Capture, lost: tuple[str, ...]) -> Record:
    """Return the record of a capture."""
    system, number = play.system, capture.number
    return Record(
        number=number,
        lost=list(lost),
        labels={name: sum(map(_label_count, capture.found_by(name).values())) for name in system.sensors},
        complete={name: _sees_all(play, capture, name) for name in system.cameras},
        errors={name: error for name in system.cameras if (error := _corner_errors(play, capture, name))},
        cells={
            name: image_cells(sensor.camera.width, sensor.camera.height, capture.corners(name).values())
            for name, sensor in system.cameras.items()
        },
        collection=_collection_document(play, capture),
        initial={name: _initial_pattern_pose(play, capture, name) for name in system.patterns},
        truth=_true_transforms(play, number),
    )


def _true_transforms(play: Play, number: int) -> list[Mapping[str, Any]]:
    system = play.system
    patterns = {
        (system.configuration.world_link, pattern.link): play.true.patterns[name]
        for name, pattern in system.patterns.items()
    }
    moving = {edge: play.true.transforms[edge] for edge in sorted(system.unknown_motions)}
    return [pose_document(edge, T[number]) for edge, T in {**patterns, **moving}.items()]


def _label_count(found: Found) -> int:
    match found:
        case CornerLabels():
            return len(found.ids)
        case PatternPoints():
            return len(found.on_pattern)
    return 0


def _sees_all(play: Play, capture: Capture, camera: str) -> bool:
    return any(
        len(found.ids) == len(play.system.patterns[pattern].corners)
        for pattern, found in capture.corners(camera).items()
    )


def _corner_errors(play: Play, capture: Capture, camera: str) -> CornerErrors | None:
    """Compare labels with the true corners as this camera saw them: of a pattern that may sway and be bowed."""
    T_camera_world = inverse(play.true.sensors[camera][capture.number])
    boards = {board.pattern.name: board for board in capture.boards[camera]}
    differences = []
    for pattern, found in capture.corners(camera).items():
        board = boards[pattern]
        corners = board.surface(board.pattern.corners[found.ids, :2])
        true = play.system.cameras[camera].camera.project(apply(T_camera_world @ board.T_world_pattern, corners))
        differences.append(found.pixels - true)
    if not differences:
        return None
    error = np.concatenate(differences)
    distance = np.linalg.norm(error, axis=-1)
    x, y = error.mean(axis=0)
    return CornerErrors(
        count=len(error),
        mean=[round(float(x), 6), round(float(y), 6)],
        rms=round(float(np.sqrt((distance**2).mean())), 6),
        largest=round(float(distance.max()), 6),
    )


def image_cells(width: int, height: int, detected: Iterable[CornerLabels]) -> list[int]:
    """Return the cells of the grid over an image (px) with a corner."""
    size = np.array([width / COVERAGE_COLUMNS, height / COVERAGE_ROWS])
    found = set()
    for labels in detected:
        column, row = np.clip((labels.pixels + 0.5) // size, 0, [COVERAGE_COLUMNS - 1, COVERAGE_ROWS - 1]).astype(int).T
        found.update((row * COVERAGE_COLUMNS + column).tolist())
    return sorted(found)


def _collection_document(play: Play, capture: Capture) -> dict[str, Any]:
    system, number = play.system, capture.number
    return {
        "additional_data": {},
        "data": {name: _sensor_message(play, capture, name) for name in system.sensors},
        "joints": _nominal_joints(play, number),
        "labels": {
            pattern: {name: sensor.label_document(capture.labels[pattern, name]) for name, sensor in system.by_modality}
            for pattern in system.patterns
        },
        "transforms": {
            f"{parent}-{child}": pose_document((parent, child), T[number])
            for (parent, child), T in play.nominal.transforms.items()
        },
    }


def _nominal_joints(play: Play, number: int) -> dict[str, Any]:
    """Return the calibrated joints of the nominal robot."""
    joints = {name: play.system.nominal.movable[name] for name in play.system.configuration.joints}
    return {name: joint_document(joint, float(play.nominal.joints[name][number])) for name, joint in joints.items()}


def _sensor_message(play: Play, capture: Capture, name: str) -> dict[str, Any]:
    """Return the ROS message of a sensor; its data are in a separate file or in the message itself."""
    sensor = play.system.sensors[name]
    header = message_header(play.system.configuration.sensors[name].link, capture.number)
    file = {"data_file": data_file(name, sensor, capture.number)} if sensor.file_ending else {}
    return {**file, "header": header, **sensor.message(capture.data[name])}


def data_file(name: str, sensor: SimulatedSensor, number: int) -> str:
    """Return the name of the file with a sensor's data in a collection."""
    return f"{name}_{collection_key(number)}.{sensor.file_ending}"


def _initial_pattern_pose(play: Play, capture: Capture, pattern: str) -> dict[str, Any]:
    """Return the pose of a pattern by the labels of the first camera that detects it.

    It is estimated by the nominal robot, as ATOM does when it collects.
    """
    geometry = play.system.patterns[pattern]
    for camera in play.system.cameras:
        T_camera_pattern = capture.estimates.get((pattern, camera))
        if T_camera_pattern is not None and np.isfinite(T_camera_pattern).all():
            edge: Edge = (geometry.parent_link, geometry.link)
            T_parent_camera = _nominal_camera_pose(play, geometry.parent_link, camera, capture.number)
            pose = pose_document(edge, T_parent_camera @ T_camera_pattern, ESTIMATE_DECIMALS)
            return {"detected": True, "sensor": camera, **pose}
    return {"detected": False}


def _nominal_camera_pose(play: Play, frame: str, camera: str, number: int) -> Array:
    """Return the nominal ``T_frame_camera`` (4, 4)."""
    transforms = {edge: T[number : number + 1] for edge, T in play.nominal.transforms.items()}
    link = play.system.configuration.sensors[camera].link
    return np.asarray(compose(play.system.nominal.tree, transforms, frame, link)[0])


POSE_DECIMALS = 9
"""Decimals of exact poses: a nanometre and a nanoradian, so that rounding errors of the arithmetic have no effect."""


def pose_document(edge: Edge, T: Array, decimals: int = POSE_DECIMALS) -> dict[str, Any]:
    """Return the document of a transform (4, 4); its quaternion is the one with a positive last component."""
    quaternion = np.round(rotations.to_quaternion(T[:3, :3]), decimals)
    last = quaternion[np.flatnonzero(quaternion)[-1]]
    return {
        "parent": edge[0],
        "child": edge[1],
        "trans": (np.round(T[:3, 3], decimals) + 0.0).tolist(),
        "quat": (quaternion * np.sign(last) + 0.0).tolist(),
    }


def joint_document(joint: Joint, position: float) -> dict[str, Any]:
    """Return a joint's entry in a collection: the description's parameters, and the encoder's position in rad or m."""
    values = dict(zip(JOINT_PARAMETERS[:6], joint.values().tolist(), strict=False))
    return {
        "transform_key": f"{joint.parent}-{joint.child}",
        "position": position,
        **{parameter: round(value, POSE_DECIMALS) + 0.0 for parameter, value in values.items()},
        **{f"axis_{axis}": value for axis, value in zip("xyz", joint.axis.tolist(), strict=True)},
        "parent_link": joint.parent,
        "child_link": joint.child,
        "joint_type": joint.kind,
    }


def message_header(frame: str, number: int) -> dict[str, Any]:
    """Return the header of a ROS message: poses are ten seconds apart."""
    return {"frame_id": frame, "seq": number, "stamp": {"secs": 10 * number, "nsecs": 0}}


Done = Callable[[int, int, Record], None]
"""Callback after each pose: number of finished poses, number of all poses, record."""


def collect_pose(
    play: Play, number: int, requirements: Requirements, images: bool = True
) -> tuple[Record, dict[str, bytes]]:
    """Collect one pose.

    Args:
        play: the motion.
        number: index of the pose, from 0.
        requirements: requirements of the collection.
        images: whether images are written too; point clouds always are, as labels refer to them.

    Returns:
        The record, and the contents of its files by name.
    """
    seen = capture(play, number)
    files = {
        data_file(name, sensor, number): sensor.encode(seen.data[name])
        for name, sensor in play.system.sensors.items()
        if sensor.file_ending and (images or sensor.modality.points)
    }
    return record(play, seen, reasons_to_lose(play.system, seen, requirements)), files


def collect(
    play: Play,
    requirements: Requirements,
    workspace: Workspace[Record],
    jobs: int | None = None,
    done: Done = lambda *_: None,
) -> list[Record]:
    """Collect every pose without a record in the workspace.

    Args:
        play: the motion.
        requirements: requirements of each collection.
        workspace: folder of records and files; existing ones are not made again.
        jobs: number of processes; None for one per core.
        done: called after each pose; first for those already finished.

    Returns:
        All records, in the order of the poses.

    Raises:
        InfrastructureError: a file cannot be written, or a process died.
    """

    def collect_into(number: int) -> Record:
        found, files = collect_pose(play, number, requirements)
        return workspace.keep(str(number), found, files)

    tasks = [Task.call(str(number), partial(collect_into, number)) for number in range(len(play))]
    return list(run_tasks(tasks, workers=jobs, find=workspace.find, done=done).values())


def corner_rms(records: Iterable[Record]) -> float | None:
    """Return the root mean square of the errors of all detected corners, px; None without any."""
    errors = [error for record in records for error in record.errors.values()]
    corners = sum(error.count for error in errors)
    return round((sum(error.count * error.rms**2 for error in errors) / corners) ** 0.5, 4) if corners else None


def kept(records: Sequence[Record]) -> list[Record]:
    """Return the records that are part of the dataset."""
    return [record for record in records if record.kept]


CONTACT_SHEET_FILE = "contact_sheet.png"
SHEET_WIDTH_PX = 1600
"""Approximate width of the sheet, px."""
MOST_POSES = 120
"""Limit of the number of poses shown."""
GAP_PX, LINE_HEIGHT_PX = 6, 16
PAPER_COLOUR, INK_COLOUR, REJECTED_COLOUR = (250, 250, 250), (60, 60, 60), (40, 40, 200)
_FONT, _TEXT_SIZE = cv2.FONT_HERSHEY_SIMPLEX, 0.38


def write_contact_sheet(folder: Path, system: System, records: Sequence[Record], files: Path) -> None:
    """Write the contact sheet.

    Args:
        folder: folder of the sheet.
        system: the system.
        records: of every pose, including rejected ones.
        files: the folder with the images, depth images and clouds of the records.

    Raises:
        InfrastructureError: it cannot be written.
    """
    tiles = [_draw_pose(system, record, files) for record in records[:MOST_POSES]]
    write_atomically(
        folder / CONTACT_SHEET_FILE, encode_image(arrange_tiles(tiles), ".png", [cv2.IMWRITE_PNG_COMPRESSION, 4])
    )


def arrange_tiles(tiles: Sequence[Image]) -> Image:
    """Arrange tiles of one size in rows, on a sheet of about `SHEET_WIDTH_PX`."""
    columns = max(1, round(SHEET_WIDTH_PX / tiles[0].shape[1]))
    filled = [*tiles, *[np.full_like(tiles[0], PAPER_COLOUR)] * (-len(tiles) % columns)]
    return np.vstack([np.hstack(filled[i : i + columns]) for i in range(0, len(filled), columns)])


def _draw_pose(system: System, record: Record, files: Path) -> Image:
    """Draw one pose: its pictures side by side, each with a title; a rejected pose has a frame."""
    labels, parts = record.collection["labels"], []
    for name, sensor in system.by_modality:
        own = [by_sensor[name] for by_sensor in labels.values()]
        patterns = [system.patterns[pattern] for pattern in labels]
        picture = sensor.draw(record.collection["data"][name], own, patterns, files)
        if not record.kept:
            cv2.rectangle(picture, (0, 0), (picture.shape[1] - 1, PICTURE_HEIGHT_PX - 1), REJECTED_COLOUR, 2)
        found = f"{record.labels[name]} {sensor.label_name}" if record.labels[name] else "not detected"
        part = np.vstack([draw_text_line(f"{name}: {found}", picture.shape[1], INK_COLOUR), picture])
        parts += [part, np.full((len(part), GAP_PX, 3), PAPER_COLOUR, np.uint8)]
    row = (
        np.hstack(parts)
        if parts
        else np.full((LINE_HEIGHT_PX + PICTURE_HEIGHT_PX, SHEET_WIDTH_PX // 4, 3), PAPER_COLOUR, np.uint8)
    )
    title = f"{record.number + 1}" if record.kept else f"{record.number + 1}  lost: {'; '.join(record.lost)}"
    heading = draw_text_line(title, row.shape[1], INK_COLOUR if record.kept else REJECTED_COLOUR)
    return np.vstack([heading, row, np.full((GAP_PX, row.shape[1], 3), PAPER_COLOUR, np.uint8)])


def draw_text_line(text: str, width: int, colour: tuple[int, int, int]) -> Image:
    """Draw a line of text, truncated to the width."""
    picture = np.full((LINE_HEIGHT_PX, width, 3), PAPER_COLOUR, np.uint8)
    cv2.putText(picture, text, (2, LINE_HEIGHT_PX - 5), _FONT, _TEXT_SIZE, colour, 1, cv2.LINE_AA)
    return picture
