"""The catalogue: every kind of defect, in three sizes, with the words of which a reason that names it has one."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from benchmarks.verdict.defects import arms, boards, cameras, labels, lidars, motions, mounts
from benchmarks.verdict.scene import Scene

ALL = ("t2rgb", "rlbot", "riwbot", "softbot", "spjbot")
LIDARS = ("rlbot", "softbot")
PAIRS = ("t2rgb", "softbot")
ARMS = ("riwbot", "spjbot")
MOVED = ("t2rgb", "rlbot")
"""Systems whose pattern is moved; that of the others is fixed."""

Group = Literal["camera", "pattern", "LiDAR", "arm", "mount", "time", "labels", "description", "data", "clean"]


@dataclass(frozen=True)
class Kind:
    """A kind of defect."""

    name: str
    group: Group
    what: str
    """For a reader's table."""
    plant: Callable[[Scene, float, np.random.Generator], Scene]
    sizes: tuple[float, ...]
    """Small, middle, great."""
    unit: str
    words: tuple[str, ...]
    """A reason names it when it has one of them, in small letters."""
    systems: tuple[str, ...] = ALL
    memory: tuple[str, ...] = ()
    """The systems on which only an earlier result could tell: their data fit another calibration as well. The joint of
    spjbot whose height is calibrated takes up what its neighbours are off by."""
    wanted: tuple[float, ...] = ()
    """The sizes that have to be red whatever harm they do: mistakes that a user has to correct."""
    spoils: bool = False
    """Whether red is right even where it does no harm: a share of the labels is worthless, or too few are left."""
    displaces: bool = False
    """Whether a sensor is moved by the size within the recording: by more than the limit that is harm, wherever the
    result lies between its places."""


LENS = ("lens", "distortion")
MOVED_WORDS = ("moved", "between collection", "drift", "halves", "over time", "contradict")
WHEN = ("lag", "synchron", "delay", "time", "contradict", "late")
VIEWS = ("view", "collection", "contradict", "wrong")
LINK = ("joint", "link", "arm", "encoder", "axis", "origin")
FEW = ("few", "determine", "well enough", "collections", "add ")

KINDS = (
    Kind("focal length", "camera", "focal length", cameras.focal, (0.002, 0.01, 0.05), "share", ("focal",)),
    Kind("aspect", "camera", "fy alone", cameras.aspect, (0.001, 0.005, 0.02), "share", ("aspect", "focal", "fy")),
    Kind("principal x", "camera", "principal point", cameras.principal_x, (1, 4, 15), "px", ("principal", "cx")),
    Kind("principal y", "camera", "principal point", cameras.principal_y, (1, 4, 15), "px", ("principal", "cy")),
    Kind("k1", "camera", "distortion", cameras.k1, (0.01, 0.03, 0.1), "", (*LENS, "k1")),
    Kind("k2", "camera", "distortion", cameras.k2, (0.02, 0.1, 0.3), "", (*LENS, "k2")),
    Kind(
        "tangential",
        "camera",
        "distortion",
        cameras.tangential,
        (0.001, 0.003, 0.01),
        "",
        (*LENS, "p1", "p2", "principal"),
    ),
    Kind(
        "no distortion",
        "camera",
        "distortion left out",
        cameras.no_distortion,
        (0.02, 0.08, 0.25),
        "k1",
        (*LENS, "k1"),
    ),
    Kind(
        "lens model",
        "camera",
        "another lens model",
        cameras.lens_model,
        (0.05, 0.15, 0.3),
        "k1",
        (*LENS, "k1", "model"),
    ),
    Kind("skew", "camera", "pixel columns that lean", cameras.skew, (0.001, 0.004, 0.015), "", ("skew",)),
    Kind(
        "half a pixel",
        "camera",
        "pixel centres",
        cameras.half_pixel,
        (0.5, 1.0, 2.0),
        "px",
        ("half a pixel", "pixel centre", "principal"),
    ),
    Kind(
        "image scale",
        "camera",
        "images of another resolution",
        cameras.scaled_images,
        (0.9, 0.5, 2.0),
        "times",
        ("resolution", "scale", "focal"),
    ),
    Kind(
        "cropped images", "camera", "cropped images", cameras.cropped_images, (5, 30, 120), "px", ("crop", "principal")
    ),
    Kind(
        "mirrored images",
        "camera",
        "mirrored images",
        cameras.mirrored_images,
        (1, 2, 3),
        "variant",
        ("mirror", "numbered", "flip", "upside", "homograph", "ids", "order", "description", "guess"),
        wanted=(1, 2),
    ),
    Kind(
        "bad camera_info",
        "camera",
        "another camera's camera_info",
        cameras.bad_camera_info,
        (0.005, 0.02, 0.1),
        "share",
        ("focal", "principal", "camera_info"),
    ),
    Kind(
        "exchanged camera_info",
        "camera",
        "two camera_info exchanged",
        cameras.exchanged_intrinsics,
        (0.01, 0.04, 0.15),
        "share",
        ("focal", "exchang", "camera_info", *LENS),
        PAIRS,
    ),
    Kind(
        "focal drift",
        "time",
        "focal length that drifts",
        cameras.focal_drift,
        (0.002, 0.01, 0.04),
        "share",
        ("focal", *MOVED_WORDS),
    ),
    Kind(
        "corner noise",
        "data",
        "corners placed badly",
        cameras.pixel_noise,
        (0.7, 1.5, 4),
        "px",
        ("noise", "detector", "scatter", "blur", *FEW),
        spoils=True,
    ),
    Kind(
        "outliers",
        "labels",
        "wrong corners",
        cameras.outliers,
        (0.02, 0.1, 0.3),
        "share",
        ("reject", "outlier", "do not fit", "does not fit"),
        spoils=True,
    ),
    Kind(
        "square size",
        "pattern",
        "size of the squares",
        boards.size,
        (0.003, 0.02, 0.1),
        "share",
        ("size", "square"),
        memory=("t2rgb",),
    ),
    Kind(
        "pattern in mm",
        "pattern",
        "unit of the pattern",
        boards.unit,
        (10, 39.37, 1000),
        "times",
        ("mm", "millimet", "unit", "size", "inch", "cm"),
        wanted=(10, 39.37, 1000),
    ),
    Kind(
        "stretched pattern",
        "pattern",
        "print that is stretched",
        boards.stretch,
        (0.001, 0.004, 0.02),
        "share",
        ("stretch", "aspect", "size", "print"),
    ),
    Kind(
        "bow along x",
        "pattern",
        "bent pattern",
        boards.bow_x,
        (0.0005, 0.002, 0.008),
        "m",
        ("bow", "bent", "flat", "bend"),
    ),
    Kind(
        "bow along y",
        "pattern",
        "bent pattern",
        boards.bow_y,
        (0.0005, 0.002, 0.008),
        "m",
        ("bow", "bent", "flat", "bend"),
    ),
    Kind(
        "twisted pattern",
        "pattern",
        "twisted pattern",
        boards.twist,
        (0.0005, 0.002, 0.008),
        "m",
        ("twist", "flat", "bow", "bent"),
    ),
    Kind(
        "border",
        "pattern",
        "width of the border",
        boards.border,
        (0.003, 0.01, 0.04),
        "m",
        ("border", "outline", "edge"),
        LIDARS,
    ),
    Kind(
        "dimensions",
        "pattern",
        "number of squares",
        boards.dimensions,
        (1, 2, 3),
        "variant",
        ("homograph", "transpos", "squares", "dimension", "columns", "rows", "ids"),
        ("t2rgb", "rlbot", "softbot", "spjbot"),
        wanted=(1, 2, 3),
    ),
    Kind("range bias", "LiDAR", "range bias", lidars.range_bias, (0.005, 0.02, 0.06), "m", ("bias", "range"), LIDARS),
    Kind(
        "range scale",
        "LiDAR",
        "range scale",
        lidars.range_scale,
        (0.003, 0.01, 0.04),
        "share",
        ("scale", "range"),
        LIDARS,
    ),
    Kind(
        "ring tilt",
        "LiDAR",
        "elevation of the rings",
        lidars.tilt,
        (0.1, 0.4, 1.5),
        "deg",
        ("tilt", "elevation", "ring", "vertical"),
        LIDARS,
    ),
    Kind(
        "scan skew",
        "LiDAR",
        "pattern that moves during a scan",
        lidars.skew_in_time,
        (0.01, 0.04, 0.12),
        "m",
        (*WHEN, "skew"),
        LIDARS,
    ),
    Kind(
        "LiDAR axes",
        "LiDAR",
        "axes exchanged",
        lidars.axes,
        (1, 2, 3),
        "variant",
        ("axes", "axis", "mirror", "description", "guess", "hand"),
        LIDARS,
        wanted=(1, 2, 3),
    ),
    Kind(
        "LiDAR noise",
        "LiDAR",
        "noisy ranges",
        lidars.noise,
        (0.03, 0.08, 0.2),
        "m",
        ("noise", "range", *FEW),
        LIDARS,
        spoils=True,
    ),
    Kind(
        "background points",
        "LiDAR",
        "points of the background",
        lidars.background,
        (0.02, 0.1, 0.3),
        "share",
        ("reject", "outlier", "do not fit", "does not fit"),
        LIDARS,
        spoils=True,
    ),
    Kind(
        "LiDAR frame",
        "LiDAR",
        "points in another frame",
        lidars.other_frame,
        (0.1, 0.3, 1.0),
        "share",
        (*VIEWS, "description", "guess"),
        LIDARS,
        spoils=True,
    ),
    *(
        Kind(
            f"joint origin {a}",
            "arm",
            "origin of a joint",
            arms.origin_shift(i),
            (0.001, 0.004, 0.02),
            "m",
            LINK,
            ARMS,
            memory=("spjbot",) if a != "y" else (),
        )
        for i, a in enumerate("xyz")
    ),
    *(
        Kind(
            f"joint origin {a}",
            "arm",
            "origin of a joint",
            arms.origin_turn(i),
            (0.05, 0.2, 1.0),
            "deg",
            LINK,
            ("riwbot",),
        )
        for i, a in enumerate(("roll", "pitch", "yaw"))
    ),
    Kind(
        "encoder offset", "arm", "zero of an encoder", arms.encoder_offset, (0.05, 0.2, 1.0), "deg", LINK, ("riwbot",)
    ),
    Kind(
        "encoder gain",
        "arm",
        "encoder that counts wrong",
        arms.encoder_gain,
        (0.001, 0.005, 0.03),
        "share",
        (*LINK, "gain"),
        ARMS,
    ),
    Kind("backlash", "arm", "gear with play", arms.backlash, (0.05, 0.2, 0.8), "deg", (*LINK, "backlash"), ARMS),
    Kind("leaning axis", "arm", "axis of a joint", arms.wrong_axis, (0.1, 0.5, 2), "deg", LINK, ARMS),
    Kind(
        "degrees for radians",
        "arm",
        "degrees for radians",
        arms.in_degrees,
        (1, 2, 3),
        "variant",
        (*LINK, "degree", "radian", "robot"),
        ARMS,
        wanted=(1, 2, 3),
    ),
    Kind(
        "unsteady arm",
        "arm",
        "arm that does not repeat",
        arms.unsteady,
        (0.001, 0.004, 0.02),
        "m",
        (*LINK, *WHEN, "noise", "views"),
        ARMS,
    ),
    Kind(
        "pushed base",
        "mount",
        "base of the arm moved",
        arms.base_moved,
        (0.002, 0.01, 0.04),
        "m",
        ("base", *MOVED_WORDS),
        ("riwbot",),
    ),
    Kind(
        "arm of another moment",
        "labels",
        "poses of the arm of another collection",
        arms.poses_of_others,
        (0.1, 0.2, 0.4),
        "share",
        VIEWS,
        ARMS,
        spoils=True,
    ),
    Kind(
        "pushed sensor",
        "mount",
        "sensor that moved",
        mounts.shifted,
        (0.002, 0.008, 0.03),
        "m",
        MOVED_WORDS,
        displaces=True,
    ),
    Kind(
        "turned sensor", "mount", "sensor that turned", mounts.turned, (0.1, 0.5, 2), "deg", MOVED_WORDS, displaces=True
    ),
    Kind("drifting sensor", "time", "sensor that drifts", mounts.drifting, (0.002, 0.008, 0.03), "m", MOVED_WORDS),
    Kind(
        "loose sensor",
        "mount",
        "sensor that shakes",
        mounts.loose,
        (0.002, 0.008, 0.03),
        "m",
        (*WHEN, *MOVED_WORDS, "rigid"),
    ),
    Kind(
        "pushed pattern",
        "mount",
        "fixed pattern that moved",
        mounts.pattern_moved,
        (0.002, 0.01, 0.04),
        "m",
        ("pattern", *MOVED_WORDS),
        ARMS,
    ),
    Kind("lag", "time", "sensor that lags", mounts.lag, (0.001, 0.005, 0.03), "m", WHEN),
    Kind("sway", "time", "pattern that sways", mounts.sway, (0.002, 0.008, 0.03), "m", (*WHEN, "sway", "moved"), MOVED),
    Kind(
        "exchanged labels",
        "labels",
        "labels of two sensors exchanged",
        labels.exchanged,
        (0.1, 0.3, 1.0),
        "share",
        ("exchang", "swap", "left", *VIEWS),
        PAIRS,
        wanted=(0.3, 1.0),
        spoils=True,
    ),
    Kind(
        "exchanged names",
        "labels",
        "left and right exchanged",
        labels.exchanged_names,
        (1, 2),
        "variant",
        ("exchang", "swap", "description", "guess"),
        PAIRS,
        wanted=(1, 2),
    ),
    Kind(
        "views of another moment",
        "labels",
        "labels of another collection",
        labels.of_another_collection,
        (0.1, 0.2, 0.4),
        "share",
        VIEWS,
        spoils=True,
    ),
    Kind(
        "reversed ids",
        "labels",
        "corners counted backwards",
        labels.reversed_ids,
        (0.1, 0.3, 0.5),
        "share",
        (*VIEWS, "ids", "revers", "order"),
        spoils=True,
    ),
    Kind(
        "ids off by one",
        "labels",
        "corners counted from another",
        labels.ids_off_by_one,
        (0.1, 0.3, 0.5),
        "share",
        (*VIEWS, "ids", "order", "homograph"),
        spoils=True,
    ),
    Kind(
        "shuffled ids",
        "labels",
        "ids without meaning",
        labels.shuffled_ids,
        (0.1, 0.3, 0.5),
        "share",
        (*VIEWS, "ids", "order", "homograph"),
        spoils=True,
    ),
    Kind(
        "shifted labels",
        "labels",
        "labels shifted in some views",
        labels.shifted_labels,
        (3, 10, 40),
        "px",
        VIEWS,
        spoils=True,
    ),
    Kind(
        "copies",
        "data",
        "one collection many times",
        labels.copied,
        (1, 5, 20),
        "times",
        ("same", "equal", "copies", "identical", "duplicate", "twice"),
        wanted=(1, 5, 20),
    ),
    Kind(
        "near copies",
        "data",
        "one pose many times",
        labels.nearly_copied,
        (5, 20, 60),
        "times",
        ("same", "equal", "alike", "copies", "duplicate", *FEW),
        spoils=True,
    ),
    Kind(
        "corner of the image",
        "data",
        "labels in a part of the images",
        labels.in_a_corner,
        (0.7, 0.5, 0.35),
        "share",
        (*FEW, "part", "image"),
        spoils=True,
    ),
    Kind(
        "few views",
        "data",
        "a sensor that saw little",
        labels.few_views,
        (6, 4, 3),
        "views",
        (*FEW, "views"),
        spoils=True,
    ),
    Kind("few collections", "data", "too few collections", motions.few, (6, 4, 3), "", FEW, spoils=True),
    Kind("alike collections", "data", "collections from one place", motions.alike, (10, 7, 5), "", FEW, spoils=True),
    Kind(
        "no rotations",
        "data",
        "pattern always held alike",
        motions.no_rotations,
        (5, 1, 0),
        "deg",
        (*FEW, "rotation"),
        MOVED,
        spoils=True,
    ),
    Kind(
        "far pattern",
        "data",
        "pattern far away",
        motions.far,
        (2, 4, 10),
        "times",
        (*FEW, "far", "small"),
        MOVED,
        spoils=True,
    ),
    Kind(
        "described elsewhere",
        "description",
        "description that puts a sensor elsewhere",
        mounts.described_elsewhere,
        (0.1, 0.4, 1.5),
        "m",
        ("description", "guess"),
        wanted=(0.4, 1.5),
    ),
    Kind(
        "described turned",
        "description",
        "description that turns a sensor",
        mounts.described_turned,
        (5, 25, 90),
        "deg",
        ("description", "guess"),
        wanted=(25, 90),
    ),
    Kind(
        "optical frame",
        "description",
        "wrong optical frame",
        mounts.optical_frame,
        (1, 2, 3),
        "variant",
        ("description", "guess", "frame"),
        ("t2rgb", "riwbot", "spjbot"),
        wanted=(1, 2, 3),
    ),
    Kind(
        "transforms in mm",
        "description",
        "transforms in mm",
        mounts.transforms_in_mm,
        (1, 2, 3),
        "variant",
        ("mm", "millimet", "unit", "description", "guess", "joint", "link", "arm"),
        wanted=(1, 2, 3),
    ),
    Kind(
        "moved since",
        "mount",
        "sensor that moved since the last calibration",
        mounts.moved_before,
        (0.002, 0.008, 0.03),
        "m",
        ("known", "earlier", "moved"),
        memory=ALL,
    ),
    Kind(
        "anchor elsewhere",
        "description",
        "anchored sensor described elsewhere",
        mounts.anchor_elsewhere,
        (0.005, 0.02, 0.1),
        "m",
        ("known", "earlier", "description"),
        ("rlbot", "softbot"),
        memory=("rlbot", "softbot"),
    ),
)


def _nothing(scene: Scene, _: float, __: np.random.Generator) -> Scene:
    return scene


CLEAN = Kind("clean", "clean", "nothing", _nothing, (0,), "", ())
