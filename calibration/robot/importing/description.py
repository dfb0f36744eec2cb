"""Description of an import, ``import.yml``: sensors, patterns and frames."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Literal

import numpy as np

from calibration.base.arrays import Array
from calibration.base.records import (
    ByName,
    Converted,
    Misfit,
    Place,
    above,
    between,
    excludes,
    field,
    length,
    record,
)
from calibration.engine.dataset.configuration import (
    APRILGRID_TAGS,
    MAX_CORNERS,
    MAX_SPACING,
    MIN_SPACING,
    TAG_COUNT,
)
from calibration.engine.dataset.model import Edge
from calibration.engine.dataset.pattern import (
    CIRCLE_KINDS,
    MAX_MARKER,
    MAX_SIZE,
    UNMARKED_KINDS,
    PatternKind,
    PlacedTag,
)
from calibration.engine.geometry.transforms import from_xyz_rpy, inverse
from calibration.robot.importing.files.samples import Samples
from calibration.robot.robot_description import XacroInputs
from calibration.robot.simulation.scene import Pose

Name = Annotated[str, length(1, 200)]
Size = Annotated[float, above(0, MAX_SIZE)]
Count = Annotated[int, between(2, MAX_CORNERS)]
VIDEO_ENDINGS = (".mp4", ".m4v", ".mov", ".avi", ".mkv", ".webm")
"""Endings of videos, in lower case."""
_OF_KIND: Mapping[PatternKind, tuple[str, ...]] = {
    "charuco": ("columns", "rows", "square", "marker", "dictionary"),
    "chessboard": ("columns", "rows", "square"),
    "aprilgrid": ("columns", "rows", "tag", "spacing"),
    "circles": ("columns", "rows", "spacing", "diameter"),
    "asymmetric-circles": ("columns", "rows", "spacing", "diameter"),
    "tags": ("dictionary", "tags"),
}
"""Keys of a pattern by its kind."""
FLAT_M, FLAT_RAD = 1e-6, 1e-6
"""Limits of what two tags of one side are apart from one plane."""


def _path_beside(text: str, place: Place) -> str:
    return str(place.folder / text)


def is_video(images: str) -> bool:
    """Whether the images of a sensor are a video, by the ending of its name."""
    return images.lower().endswith(VIDEO_ENDINGS)


Files = Annotated[str, Converted(Name, _path_beside)]
"""Folder or glob pattern of files, relative to the folder of the document."""


@record
class SensorDescription:
    """A camera, LiDAR or depth camera: where its data are, and where it is mounted."""

    name: str
    images: Files | None = field(
        "Folder of its images, a pattern such as left/*.png, or a video; without it those that samples name.",
        default=None,
    )
    clouds: Files | None = field(
        "Of a LiDAR: folder of its point clouds (PCD, PLY, LAS, LAZ, or text), or a pattern of files.",
        default=None,
    )
    topic: Name | None = field("Topic of its images in a bag.", default=None)
    modality: Literal["rgb", "depth"] | None = field(
        "Kind of its images in a bag: depth if the topic has that word (rgb).", default=None
    )
    camera_info: Name | None = field("Topic of its intrinsics in a bag (camera_info beside the images).", default=None)
    intrinsics: Path | None = field(
        "File with its intrinsics: ROS's camera_info, Kalibr's camchain, OpenCV's FileStorage, robot_cal_tools', or "
        "the intrinsics.json of an earlier calibration. How well they are known goes along, where the file says so. "
        "Without one they are calibrated, from a start that the corners give.",
        default=None,
    )
    distortion: Path | None = field(
        "File with its distortion coefficients, where 'intrinsics' is a matrix alone (mtx.npy and dist.npy).",
        default=None,
    )
    model: Name | None = field(
        "Lens model of the coefficients in that file, where it states none or a wrong one; without a file, of the lens "
        "that is calibrated: plumb_bob, rational_polynomial, equidistant (cv2.fisheye), eucm, double_sphere or omni.",
        default=None,
    )
    camera: Name | None = field("Its name in that file, where that has several: cam0.", default=None)
    parent: Name | None = field(
        "Frame that it is mounted on; its pose relative to this one is calibrated (the world).", default=None
    )
    frame: Name | None = field("Frame of its images, z forward (its name and _optical_frame).", default=None)
    stamps: Literal["header", "recorded"] | Path | None = field(
        "Times of its messages in a bag: those in their headers, or those at which they were recorded, for a sensor "
        "whose clock is not that of the others (header). Of a video: file with the time of each frame, one a line, s "
        "or ns (those in the video).",
        default=None,
    )
    pose: Pose | None = field(
        "Its pose on its parent, roughly (of a LiDAR to 10 cm), where no recording has it: xyz in m, rpy in rad.",
        default=None,
    )

    @property
    def link(self) -> str:
        """Frame of its images."""
        return self.frame or f"{self.name}_optical_frame"


@record
class TagOnBody(PlacedTag):
    """A tag, and where it is on the body of its pattern."""

    z: Annotated[float, between(-MAX_SIZE, MAX_SIZE)] = field("Likewise, away from who sees it, m (0).", default=0.0)
    roll: Annotated[float, between(-7, 7)] = field("Beside yaw, about x, as URDF's rpy, rad (0).", default=0.0)
    pitch: Annotated[float, between(-7, 7)] = field("Likewise, about y, rad (0).", default=0.0)

    @property
    def flat(self) -> PlacedTag:
        """Itself in the plane of x and y."""
        return PlacedTag(self.id, self.size, self.x, self.y, self.yaw)

    @property
    def T_body_tag(self) -> Array:
        """(4, 4)."""
        return from_xyz_rpy([self.x, self.y, self.z], [self.roll, self.pitch, self.yaw])

    @property
    def is_flat(self) -> bool:
        """Whether it is in the plane of x and y."""
        return not (self.z or self.roll or self.pitch)


@record
class BodyDescription:
    """A body that carries patterns, whose pose is calibrated."""

    name: str
    parent: Name | None = field(
        "Frame that it is mounted on (the world); on any other it is fixed, and its pose there calibrated.",
        default=None,
    )
    fixed: bool | None = field("Whether it has one pose there, or one in each collection.", default=None)


def _with_article(kind: PatternKind) -> str:
    if kind in CIRCLE_KINDS:
        return "a grid of circles"
    names = {"charuco": "a charuco board", "chessboard": "a chessboard", "aprilgrid": "an aprilgrid"}
    return names.get(kind, "a list of tags")


@record(rules=(excludes("target", "type"),))
class PatternDescription:
    """A pattern, as it is printed and as it is mounted."""

    name: str
    target: Path | None = field("File that describes it: Kalibr's target YAML, or robot_cal_tools'.", default=None)
    type: PatternKind | None = field(
        "Its kind; of a pattern whose poses are in the samples it need not be known.", default=None
    )
    columns: Count | None = field(
        "Corners inside, along a row: squares less one. Of an aprilgrid: tags (Kalibr's tagCols). Of circles: those of "
        "a row.",
        default=None,
    )
    rows: Count | None = field(
        "Corners inside, along a column. Of an aprilgrid: tags (tagRows). Of circles: rows.", default=None
    )
    square: Size | None = field("Side of a square, m.", default=None)
    marker: Size | None = field("Side of a marker of a charuco board, m.", default=None)
    dictionary: Name | None = field("Dictionary of its markers: DICT_5X5_100.", default=None)
    tag: Size | None = field("Side of a tag of an aprilgrid, m (tagSize).", default=None)
    spacing: Size | None = field(
        "Gap between two tags of an aprilgrid, in sides of a tag (tagSpacing); from circle to circle, m: of an "
        "asymmetric grid from row to row, half of that along a row.",
        default=None,
    )
    diameter: Size | None = field("Diameter of a circle, m.", default=None)
    tags: Annotated[tuple[TagOnBody, ...], length(1, 1000)] | None = field(
        "Tags or markers, each once: one on a flange or a wall, several in a plane, or on the sides of a body.",
        default=None,
    )
    first: Annotated[int, between(0, MAX_MARKER)] | None = field(
        "Lowest id of its markers or tags, where boards of one dictionary are told apart (0).", default=None
    )
    inverted: bool = field("Whether black and white are exchanged in its print.", default=False)
    border: Annotated[float, between(0, MAX_SIZE)] = field(
        "Margin of the board around the squares, m; for LiDARs and depth cameras.", default=0.0
    )
    parent: Name | None = field(
        "Frame that it is mounted on (the world); on any other it is fixed, and its pose there calibrated.",
        default=None,
    )
    fixed: bool | None = field("Whether it has one pose there, or one in each collection.", default=None)
    frame: Name | None = field("Its own frame (its name and _link).", default=None)
    pose: Pose | None = field(
        "Its known pose on its parent, to be held (hold) where the recording does not determine it; on a body it is.",
        default=None,
    )

    def __post_init__(self) -> None:
        """Refuse an incomplete pattern.

        Raises:
            Misfit: names the missing keys.
        """
        if self.type is None:
            return
        needed = _OF_KIND[self.type]
        if missing := [key for key in needed if getattr(self, key) is None]:
            raise Misfit(f"missing key '{missing[0]}' of {_with_article(self.type)}")
        others = dict.fromkeys(key for keys in _OF_KIND.values() for key in keys if key not in needed)
        if stray := [key for key in others if getattr(self, key) is not None]:
            raise Misfit(f"found '{stray[0]}', expected the keys of {_with_article(self.type)}: {', '.join(needed)}")
        if self.tags and len({tag.id for tag in self.tags}) < len(self.tags):
            raise Misfit("found an id twice, expected each tag once", "tags")
        if self.pose is not None and not self.is_flat:
            raise Misfit("found 'pose' of tags on several sides, whose pose on the parent is calibrated", "pose")
        if self.type in (*UNMARKED_KINDS, "tags") and self.first is not None:
            raise Misfit("found 'first', expected it of a board with markers", "first")
        if self.type == "aprilgrid" and (self.first or 0) + (self.columns or 0) * (self.rows or 0) > TAG_COUNT:
            begin = f" from id {self.first}" if self.first else ""
            raise Misfit(
                f"found {self.columns} x {self.rows} tags{begin}, expected {TAG_COUNT} at most, as {APRILGRID_TAGS} has"
            )
        if self.type == "aprilgrid" and not MIN_SPACING <= (self.spacing or 0) <= MAX_SPACING:
            raise Misfit(
                f"found {self.spacing:g}, expected {MIN_SPACING:g} to {MAX_SPACING:g} sides of a tag", "spacing"
            )
        if self.diameter is not None and self.spacing is not None and self.diameter >= self.spacing:
            raise Misfit(f"found {self.diameter:g}, expected less than the spacing, {self.spacing:g}", "diameter")
        if self.marker is not None and self.square is not None and self.marker >= self.square:
            raise Misfit(f"found {self.marker:g}, expected less than the square, {self.square:g}", "marker")

    @property
    def is_printed(self) -> bool:
        """Whether the print is described, so that it can be detected in images."""
        return self.target is not None or self.type is not None

    @property
    def is_flat(self) -> bool:
        """Whether all is in one plane."""
        return all(tag.is_flat for tag in self.tags or ())

    def check_printed(self) -> None:
        """Refuse a pattern that cannot be detected.

        Raises:
            Misfit: neither its kind nor its file is given.
        """
        if not self.is_printed:
            raise Misfit(f"patterns: '{self.name}': missing key 'type', or 'target'")


@record(rules=(excludes("every", "at"),))
class MomentChoice:
    """Which moments of a recording may become collections."""

    every: Annotated[float, above(0, 1e6)] | None = field(
        "A moment every so many seconds, still or not, in place of those at which all stands still.", default=None
    )
    at: Path | None = field("File with the times of the moments, s, one a line, likewise.", default=None)
    most: Annotated[int, between(1, 10_000)] = field(
        "Moments at most; of more, those that calibrate best, or, with every or at, evenly chosen.", default=100
    )

    @property
    def only_standstill(self) -> bool:
        """Whether moments are taken only where all stands still."""
        return self.every is None and self.at is None


@record
class Videos:
    """What is taken of the videos that sensors name as their images."""

    step: Annotated[int, between(1, 10_000)] = field("Of so many frames one is searched.", default=1)
    moments: MomentChoice = field(flat=True, default_factory=MomentChoice)


@record
class Bags:
    """A recording of ROS 1 or ROS 2."""

    files: Annotated[tuple[Path, ...], length(1, 1000)] = field(
        "Bags that follow each other: .bag, .db3, .mcap, or folders with metadata.yaml."
    )
    robot_description: Path | None = field("URDF or xacro of the robot (that of /robot_description).", default=None)
    xacro: XacroInputs = field(flat=True, default_factory=XacroInputs)
    moments: MomentChoice = field(flat=True, default_factory=MomentChoice)


@record
class ImportDescription:
    """Recorded data, and the calibration's configuration."""

    patterns: Annotated[tuple[PatternDescription, ...], ByName()] = field("By their names.")
    bodies: Annotated[tuple[BodyDescription, ...], ByName()] = field(
        "What carries several patterns, as the sides of a box, by name: the parent of these.",
        default=(),
    )
    sensors: Annotated[tuple[SensorDescription, ...], ByName()] = field(
        "By their names; for a bag, every topic of images unless given.", default=()
    )
    robot: Name | None = field("Name of the robot (of the folder of this file).", default=None)
    world: Name | None = field(
        "The frame that all others hang on (world; of a bag, the root of its frames).", default=None
    )
    parents: Mapping[Name, Name] = field(
        "The parent, of each frame that has several in a bag: {box: table}.", default_factory=dict
    )
    bags: Bags | None = field("What ROS recorded.", default=None)
    videos: Videos | None = field("What is taken of videos, where images of sensors are some.", default=None)
    pairs: Literal["name", "number", "stamp"] | Path | None = field(
        "What tells which images belong together: their names, the last numbers in them, the stamps in nanoseconds "
        "that their names are, or a CSV with a column for each sensor (stamp where all names are, name, else number).",
        default=None,
    )
    samples: Samples | None = field("Poses of a robot arm.", default=None)
    anchored: Name | None = field("The sensor with a fixed pose (the first, if only patterns move).", default=None)

    def __post_init__(self) -> None:
        """Refuse inconsistent keys.

        Raises:
            Misfit: names them.
        """
        names = [sensor.name for sensor in self.sensors]
        if self.anchored is not None and self.anchored not in names:
            raise Misfit(f"found '{self.anchored}', expected a sensor: {', '.join(names)}", "anchored")
        if self.bags is not None or self.samples is None:
            for pattern in self.patterns:
                pattern.check_printed()
        if stray := [each.name for each in self.sensors if each.distortion is not None and each.intrinsics is None]:
            raise Misfit(f"sensors: '{stray[0]}': found 'distortion', expected 'intrinsics' beside it: a matrix alone")
        if self.bags is not None:
            self._check_bags()
            return
        if not names:
            raise Misfit("missing key 'sensors'")
        if self.parents:
            raise Misfit("found 'parents' without 'bags': only recorded frames have several")
        of_bags = [
            each
            for each in self.sensors
            if each.topic or each.camera_info or each.modality or isinstance(each.stamps, str)
        ]
        if of_bags:
            raise Misfit(f"sensors: '{of_bags[0].name}': a topic needs 'bags', and so do a modality and stamps")
        self._check_videos()
        self._check_clouds()
        without = [sensor.name for sensor in self.sensors if sensor.images is None and sensor.clouds is None]
        if without and (self.samples is None or len(self.sensors) > 1):
            raise Misfit(f"sensors: '{without[0]}': missing key 'images', a folder or a pattern of files")

    @property
    def root(self) -> str:
        """The frame that all others hang on, where no recording tells it."""
        return self.world or "world"

    def is_fixed(self, each: "PatternDescription | BodyDescription") -> bool:
        """Whether a pattern or a body has one pose on its parent."""
        return (each.parent or self.root) != self.root if each.fixed is None else each.fixed

    @property
    def in_hand(self) -> bool:
        """Whether the arm carries a sensor, not a pattern."""
        return self.samples is not None and any(each.parent == self.samples.tool for each in self.sensors)

    @property
    def has_videos(self) -> bool:
        """Whether the cameras have videos."""
        return any(sensor.images is not None and is_video(sensor.images) for sensor in self.sensors)

    def _check_videos(self) -> None:
        if stray := [
            each.name for each in self.sensors if isinstance(each.stamps, Path) and not is_video(each.images or "")
        ]:
            raise Misfit(f"sensors: '{stray[0]}': found 'stamps', expected a video as its 'images'")
        if not self.has_videos:
            if self.videos is not None:
                raise Misfit(
                    f"found 'videos', expected a sensor with one: images: left.mp4 ({', '.join(VIDEO_ENDINGS)})"
                )
            return
        if self.samples is not None or self.pairs is not None:
            raise Misfit("found videos with 'samples' or 'pairs': their images belong together by their times")
        if others := [each.name for each in self.sensors if not (each.images and is_video(each.images))]:
            raise Misfit(f"sensors: '{others[0]}': expected a video as its 'images', as the other sensors have")

    def _check_clouds(self) -> None:
        lidars = [sensor for sensor in self.sensors if sensor.clouds is not None]
        for lidar in lidars:
            if lidar.images is not None or lidar.intrinsics is not None:
                raise Misfit(f"sensors: '{lidar.name}': found 'clouds' with 'images' or 'intrinsics' of a camera")
        if lidars and len(lidars) == len(self.sensors):
            raise Misfit(f"sensors: '{lidars[0].name}': missing a camera, which sees where the pattern is")

    def _check_bags(self) -> None:
        if self.samples is not None or self.pairs is not None:
            raise Misfit("found 'bags' with 'samples' or 'pairs': a bag has its own poses and stamps")
        for sensor in self.sensors:
            if isinstance(sensor.stamps, Path):
                raise Misfit(
                    f"sensors: '{sensor.name}': found stamps: {sensor.stamps.name}, expected header or recorded"
                )
            if sensor.images is not None or sensor.clouds is not None or sensor.topic is None:
                raise Misfit(f"sensors: '{sensor.name}': expected the 'topic' of its data in the bag, no folder")


def with_sides(described: ImportDescription) -> ImportDescription:
    """Return a description in which patterns with tags on several sides are bodies with a flat pattern a side."""
    solid = [pattern for pattern in described.patterns if not pattern.is_flat]
    bodies = [BodyDescription(each.name, each.parent, described.is_fixed(each)) for each in solid]
    patterns = [
        side for each in described.patterns for side in (_sides_of_pattern(each) if not each.is_flat else [each])
    ]
    return replace(described, patterns=tuple(patterns), bodies=(*described.bodies, *bodies))


def _sides_of_pattern(pattern: PatternDescription) -> list[PatternDescription]:
    """Return the sides of a pattern; the frame of each is that of its first tag."""
    sides: list[tuple[TagOnBody, list[TagOnBody]]] = []
    for tag in pattern.tags or ():
        for first, tags in sides:
            T = inverse(first.T_body_tag) @ tag.T_body_tag
            if abs(T[2, 3]) < FLAT_M and np.linalg.norm(T[:2, 2]) < FLAT_RAD and T[2, 2] > 0:
                tags.append(_in_plane(tag, T))
                break
        else:
            sides.append((tag, [_in_plane(tag, np.eye(4))]))
    return [
        replace(
            pattern,
            name=f"{pattern.name}_{number}",
            tags=tuple(tags),
            parent=pattern.name,
            fixed=True,
            frame=None,
            pose=Pose((first.x, first.y, first.z), (first.roll, first.pitch, first.yaw)),
        )
        for number, (first, tags) in enumerate(sides)
    ]


def _in_plane(tag: TagOnBody, T: Array) -> TagOnBody:
    yaw = float(np.arctan2(T[1, 0], T[0, 0]))
    return TagOnBody(id=tag.id, size=tag.size, x=float(T[0, 3]), y=float(T[1, 3]), yaw=yaw)


def body_edges(described: ImportDescription) -> dict[str, Edge]:
    """Return the transform of each body to its parent."""
    return {each.name: (each.parent or described.root, each.name) for each in described.bodies}


def moving_bodies(described: ImportDescription) -> tuple[str, ...]:
    """Return the bodies that have a pose in each collection."""
    return tuple(each.name for each in described.bodies if not described.is_fixed(each))


def carriers(described: ImportDescription, parents: Sequence[str]) -> set[str]:
    """Return the frames that carry fixed patterns, by their parents: of a body, the frame that it is fixed on."""
    bodies = {each.name: each for each in described.bodies}
    on_frames = {parent for parent in parents if parent not in bodies}
    return on_frames | {each.parent or described.root for each in bodies.values() if described.is_fixed(each)}
