"""What is fuzzed: a reader of files of others, with files that it can read."""

import contextlib
import io
import json
import re
import shutil
import tarfile
from collections.abc import Callable, Mapping
from functools import cache, partial
from importlib import import_module
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from calibration.__main__ import main
from calibration.base import CalibrationError, InputError
from calibration.base.tables import judge, parse_rules, read_table
from calibration.ci.execution.extraction import Budget, extract
from calibration.ci.execution.outcome import Glob
from calibration.ci.git import changed_lines
from calibration.ci.github.comments import comment_text
from calibration.ci.image.context import read_ignore_file
from calibration.ci.image.repositories import read_repositories
from calibration.ci.image.specification import read_image_specification
from calibration.ci.introspection import read_rules
from calibration.ci.report.report import read_brief
from calibration.engine.baseline.document import read_baseline
from calibration.engine.dataset.configuration import read_configuration as read_atom_configuration
from calibration.engine.dataset.reading import read_dataset
from calibration.engine.dataset.sensor_data import read_depth_image, read_points
from calibration.engine.dataset.writing import DatasetWriter
from calibration.engine.diagnosis.check_data import check_data
from calibration.engine.estimation.problem.intrinsics import read_intrinsics
from calibration.engine.estimation.start.guesses import StartingNoise
from calibration.engine.evaluation.truth import read_truth
from calibration.engine.evaluation.two_sensors import read_annotation
from calibration.engine.geometry.cameras import Camera
from calibration.engine.geometry.transforms import translation
from calibration.pipeline.configuration import read_configuration
from calibration.pipeline.matrix.cell_result import Cell
from calibration.pipeline.matrix.loaded_system import LoadedSystem
from calibration.pipeline.matrix.running_cell import calibrate_cell
from calibration.pipeline.results import read_results
from calibration.robot.calibrated_urdf import calibrated_urdf
from calibration.robot.importing.bags.bag import open_bag
from calibration.robot.importing.bags.messages import depth_of, image_of
from calibration.robot.importing.bags.survey import survey
from calibration.robot.importing.cloud_files import read_cloud
from calibration.robot.importing.description import Bags, ImportDescription, PatternDescription
from calibration.robot.importing.files.camera_files import read_lens
from calibration.robot.importing.files.samples import Samples, read_samples
from calibration.robot.importing.files.target_files import pattern_configuration
from calibration.robot.importing.image_views import read_image
from calibration.robot.importing.importing import import_data, read_description
from calibration.robot.importing.videos import decoded_frames
from calibration.robot.simulation.motion import read_motion
from calibration.robot.simulation.scenarios.scenario_set import read_scenario_set
from calibration.robot.simulation.system import System, read_system
from calibration.robot.urdf import parse_robot, read_robot
from tests.campaigns.target import DATASETS, PROJECT, Target, files_of
from tests.robot.importing import hand_eye
from tests.robot.importing.bags import BEGIN, SECOND, BagFile, Kind
from tests.robot.importing.clouds import CLOUDS
from tests.robot.importing.test_videos import write_video


def _few_collections() -> list[bytes]:
    """Two datasets of ten collections each: what is calibrated within a tenth of a second."""
    found = []
    for name in ("riwbot", "t2rgb"):
        document = json.loads((DATASETS / name / "dataset.json").read_text())
        document["collections"] = dict(list(document["collections"].items())[:10])
        found.append(json.dumps(document).encode())
    return found


def _changes() -> list[bytes]:
    """What a calibration of a dataset might have changed."""
    dataset = read_dataset(DATASETS / "t2rgb")
    moved = dataset.with_transforms({edge: T @ translation((0.01, 0.0, 0.0)) for edge, T in dataset.transforms.items()})
    return [DatasetWriter(dataset).changes_text(moved).encode()]


def _calibrated(path: Path) -> None:
    dataset = read_dataset(path)
    check_data(dataset)
    result, _ = calibrate_cell(Cell("robot", StartingNoise(0.0, 0.0, 1)), LoadedSystem("robot", dataset, None, None))
    if result.error is not None:
        raise CalibrationError(result.reasons[0])


def _judged(path: Path) -> None:
    judge(
        read_table(path), parse_rules([{"column": "RMS (pix)", "row": "Averages", "max": 3, "every-max": 5}], "rules")
    )


TABLE = b"Collection #,RMS (pix),X err (pix)\n000,0.5,0.1\n001,0.25,0.2\nAverages,0.3750,0.1500\n"
RULES = (
    b'rules:\n  - {column: RMS (pix), row: Averages, max: 3}\n  - {column: Status, matches: "ok|done"}\nmin-rows: 2\n'
)
VARIABLES = {"REGISTRY": "registry.example.org"}
"""What the examples take from the environment."""
IMAGE = b"""\
name: ghcr.io/me/robot
base: "ubuntu:22.04"
apt: [git, curl]
environment: {ROS_DOMAIN_ID: "7"}
commands: ["pip install numpy"]
push: true
promote: [stable]
"""


def _tars() -> list[bytes]:
    packed = io.BytesIO()
    with tarfile.open(fileobj=packed, mode="w", format=tarfile.PAX_FORMAT) as tar:
        for name, kind in (
            ("out", tarfile.DIRTYPE),
            ("out/a", None),
            ("out/l", tarfile.SYMTYPE),
            ("out/h", tarfile.LNKTYPE),
        ):
            entry = tarfile.TarInfo(name)
            entry.type = kind or tarfile.REGTYPE
            entry.linkname = "out/a" if kind in (tarfile.LNKTYPE, tarfile.SYMTYPE) else ""
            entry.size = 0 if kind else 600
            tar.addfile(entry, None if kind else io.BytesIO(b"x" * 600))
    return [packed.getvalue()]


def _brought_out(path: Path) -> None:
    folder, glob = path.parent / "brought", Glob("/out/*")
    folder.mkdir()
    extract([path.read_bytes()], glob.landing, glob.source, folder, Budget(1 << 20, 100))
    outside = [found for found in path.parent.iterdir() if found not in (path, folder)]
    if outside:
        raise AssertionError(f"brought out beside the folder: {outside}")


def _depth() -> list[bytes]:
    import cv2

    image = np.arange(16 * 12, dtype=np.uint16).reshape(12, 16)
    return [bytes(cv2.imencode(".png", image)[1])]


APRILGRID = b"target_type: 'aprilgrid'\ntagCols: 6\ntagRows: 6\ntagSize: 0.088\ntagSpacing: 0.3\n"
CHECKERBOARD = (
    b"target_type: 'checkerboard'\ntargetCols: 6\ntargetRows: 7\nrowSpacingMeters: 0.06\ncolSpacingMeters: 0.06\n"
)


def _printed(path: Path) -> None:
    pattern_configuration(PatternDescription("board", target=path), "world").pattern()


def _hand_eye(*names: str) -> Callable[[], list[bytes]]:
    def originals() -> list[bytes]:
        with TemporaryDirectory() as folder:
            for name in names:
                hand_eye.WRITERS[name](hand_eye.simulated(in_hand=True, count=4), Path(folder) / name)
            return [(Path(folder) / name).read_bytes() for name in names]

    return originals


def _poses(path: Path) -> None:
    read_samples(Samples(file=path), in_hand=True)


def _poses_as_json() -> list[bytes]:
    arm = hand_eye.simulated(in_hand=True, count=4).arm
    return [
        json.dumps(
            {"poses": [{"rotation": T[:3, :3].tolist(), "translation": T[:3, 3].tolist()} for T in arm]}
        ).encode(),
        json.dumps([T.ravel().tolist() for T in arm]).encode(),
    ]


def _poses_as_arrays() -> list[bytes]:
    file = io.BytesIO()
    np.savez(file, arm=hand_eye.simulated(in_hand=True, count=4).arm)
    return [file.getvalue()]


def _measured_poses() -> list[bytes]:
    """A dataset of poses."""
    with TemporaryDirectory() as folder:
        config = hand_eye.write_import(Path(folder), hand_eye.simulated(in_hand=False, count=12), "pairs.csv")
        import_data(config, Path(folder) / "out", jobs=1)
        return [(Path(folder) / "out" / "dataset.json").read_bytes()]


def _bag(kind: Kind) -> Callable[[], list[bytes]]:
    """A file of a small bag."""

    def originals() -> list[bytes]:
        with TemporaryDirectory() as folder:
            path = Path(folder) / ("recorded.bag" if kind == "bag" else "recorded")
            with BagFile(path, kind) as bag:
                bag.transforms("/tf_static", BEGIN, {("world", "left"): np.eye(4)})
                for n in range(2):
                    stamp = BEGIN + n * SECOND
                    bag.camera_info("/left/camera_info", stamp, "left", (16, 12), 50.0)
                    bag.image("/left/image_raw", stamp, np.full((12, 16, 3), 40 * n, np.uint8), "left", "mono8")
                    bag.depth("/left/depth/image_raw", stamp, np.full((12, 16), 1.5), "left", "16UC1")
            files = [path] if path.is_file() else [each for each in path.iterdir() if each.suffix == f".{kind}"]
            return [file.read_bytes() for file in files]

    return originals


def _recorded(path: Path) -> None:
    """Both passes over a bag."""
    description = ImportDescription(patterns=(), bags=Bags((path,)))
    with open_bag([path]) as bag:
        found = survey(bag, description)
        for message in bag.messages({sensor.topic for sensor in found.sensors.values()}):
            image_of(bag.decode(message), "an image")
        for message in bag.messages({"/left/depth/image_raw"}):
            depth_of(bag.decode(message), "a depth image")


IMPORT = b"""\
sensors:
  camera: {parent: tool0, intrinsics: camera.yaml}
patterns:
  board: {type: charuco, columns: 11, rows: 8, square: 0.06, marker: 0.045, dictionary: DICT_5X5_100}
samples: {file: poses.csv, base: base_link, tool: tool0}
"""
POSES_XML = b"""\
<?xml version="1.0"?>
<opencv_storage><poses type_id="opencv-matrix"><rows>2</rows><cols>7</cols><dt>d</dt>
<data>0.1 0.2 0.3 0. 0. 0. 1. 0.4 0.2 0.3 0. 0. 1. 0.</data></poses></opencv_storage>
"""
CAMERA_INI = b"""\
[image]
width
640
height
480
[camera]
camera matrix
500 0 320
0 501 240
0 0 1
distortion
0.1 0.01 -0.002 0.001 0
"""
CAMERA_TOML = b"""\
[cam_0]
name = "A"
size = [640, 480]
matrix = [[500.0, 0.0, 320.0], [0.0, 501.0, 240.0], [0.0, 0.0, 1.0]]
distortions = [0.1, 0.01, 0.0, 0.0, 0.0]
"""
OPENCV = b"""
cameraResolution: [640, 480]
cameraMatrix: {rows: 3, cols: 3, data: [500, 0, 320, 0, 500, 240, 0, 0, 1]}
cameraMatrix_std_dev: {rows: 4, cols: 1, data: [0.5, 0.5, 0.4, 0.4]}
dist_coeffs: {rows: 1, cols: 5, data: [0, 0, 0, 0, 0]}
stdDeviationsIntrinsics: {rows: 9, cols: 1, data: [0.5, 0.5, 0.4, 0.4, 0.002, 0.01, 0, 0, 0.02]}
"""
CAMERA_INFO = b"""\
image_width: 640
image_height: 480
camera_matrix: {rows: 3, cols: 3, data: [500, 0, 320, 0, 500, 240, 0, 0, 1]}
distortion_model: plumb_bob
distortion_coefficients: {rows: 1, cols: 5, data: [0, 0, 0, 0, 0]}
"""
CAMCHAIN = b"""\
cam0:
  camera_model: pinhole
  intrinsics: [500, 500, 320, 240]
  distortion_model: radtan
  distortion_coeffs: [0, 0, 0, 0]
  resolution: [640, 480]
"""
STEREO = (
    CAMCHAIN
    + CAMCHAIN.replace(b"cam0", b"cam1")
    + b"""\
  T_cn_cnm1:
  - [1.0, 0.0, 0.0, -0.1]
  - [0.0, 0.99995, -0.01, 0.0]
  - [0.0, 0.01, 0.99995, 0.002]
  - [0.0, 0.0, 0.0, 1.0]
"""
)


SCENARIOS = b"""\
light: {ambient: {uniform: [0.4, 0.9]}, elevation_deg: 30, azimuth_deg: 5}
cameras: {exposure: {log_uniform: [0.7, 1.4]}, k1: {normal: [0, 0.05], within: [-0.15, 0.1]}}
occluders: {count: {integer: [0, 3]}, size_m: {uniform: [0.03, 0.12]}}
motion: {poses: 12}
constraints:
  - {less: [cameras.k1, light.ambient]}
"""
SYSTEM = DATASETS / "riwbot"


def _system(path: Path) -> None:
    """A system one of whose files was changed."""
    for name in ("robot.urdf", "config.yml", "simulation.yml"):
        if not (path.parent / name).exists():
            shutil.copy(SYSTEM / name, path.parent)
    read_system(path.parent)


@cache
def _known_system() -> System:
    return read_system(DATASETS / "t2rgb")


def _photographs() -> list[bytes]:
    import cv2

    image = np.random.default_rng(1).integers(0, 255, (24, 32, 3), np.uint8)
    return [bytes(cv2.imencode(suffix, image)[1]) for suffix in (".png", ".jpg", ".tiff")]


def _left_by_a_run(name: str) -> Callable[[], list[bytes]]:
    def originals() -> list[bytes]:
        with TemporaryDirectory() as folder, contextlib.redirect_stdout(io.StringIO()):
            arguments = ["--dataset", str(SYSTEM), "--intrinsics", "all", "--compare", "shah", "--output", folder]
            main(["calibrate-matrix", *arguments])
            return [path.read_bytes() for path in Path(folder).rglob(name)][:1]

    return originals


ANNOTATION = {"000": {side: {"ixs": [1.0, 2, 3], "iys": [1.0, 2, 3]} for side in ("top", "right", "bottom", "left")}}
MATRIX = b"!!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n   data: [ 500., 0., 320., 0., 500., 240., 0., 0., 1. ]\n"
FILE_STORAGE = (
    b"%YAML:1.0\n---\nimage_width: 640\nimage_height: 480\ncamera_matrix: " + MATRIX + b"distortion_coefficients: "
    b"!!opencv-matrix\n   rows: 1\n   cols: 5\n   dt: d\n   data: [ 0., 0., 0., 0., 0. ]\n"
)
OUR_STORAGE = (
    b"%YAML:1.0\n---\nname_0: left\nsize_0: [ 640, 480 ]\nmodel_0: plumb_bob\nK_0: "
    + MATRIX
    + b"D_0: [0.,0.,0.,0.,0.]\n"
)
ROBOT_CAL_TOOLS = b"intrinsics: {fx: 500.0, fy: 500.0, cx: 320.0, cy: 240.0}\n"
REPOSITORIES = b"""\
repositories:
  a/b: {type: git, url: https://x.org/a.git, version: 0123456789012345678901234567890123456789}
  c: {type: git, url: https://x.org/c.git, version: v1}
"""
DIFFERENCE = b"""\
diff --git a/x b/x
index 1..2 100644
--- a/x
+++ b/x
@@ -1,2 +3,4 @@ f
+a
-b
@@ -9 +11 @@
+c
\\ No newline at end of file
+++ "b/\\303\\251.py"
"""
BRIEF = {
    "schema": 1,
    "verdict": "pass",
    "sentence": "1 cell calibrated",
    "reasons": ["a @b #1 http://x.y www.z.org GH-1 </details> <img> `x` ![](y) [a](b)"],
    "tables": [{"columns": ["a", "b"], "rows": [["1", "x|y"], ["2", "<b>"]]}],
}


def _lenses(path: Path) -> None:
    for name in ("left", "cam0"):
        with contextlib.suppress(InputError):
            read_lens(path, name)
    read_lens(path)


def _commented(path: Path) -> None:
    """What is written on a pull request has no markup, mention or link but ours."""
    text = comment_text(read_brief(path), "n", {"run": "https://github.com/a/b"}, "a" * 40)
    body = text.replace("https://github.com/a/b", "")
    if len(text) > 65536 or (found := re.search(r"<(?!br>|!--).{0,60}|@[A-Za-z0-9]|https?://", body)):
        raise AssertionError(f"in the comment: {found and found[0]}, {len(text)} characters")


def _exported(path: Path) -> None:
    calibrated_urdf(path.read_bytes(), {("tripod", "tripod_plate"): np.eye(4)}, "robot.urdf")


GRIPPER = b"""<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro"><link name="a"/><link name="b"/>
<link name="c"/><link name="d"/><link name="e"/>
<joint name="left" type="prismatic"><parent link="a"/><child link="b"/><origin xyz="0 0 1" rpy="0 0 0.5"/></joint>
<joint name="right" type="revolute"><parent link="a"/><child link="c"/><axis xyz="0 1 0"/>
<limit lower="-1" upper="2"/><mimic joint="left" multiplier="-1.5" offset="0.1"/></joint>
<joint name="thumb" type="continuous"><parent link="c"/><child link="d"/><mimic joint="right"/></joint>
<joint name="toss" type="floating"><parent link="a"/><child link="e"/></joint></robot>"""
XACRO = b"""<robot name="$(arg name)" xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:arg name="name" default="r"/>
<xacro:arg name="length" default="2"/><xacro:property name="half" value="${$(arg length) / 2}"/>
<xacro:macro name="finger" params="side *origin"><link name="${side}"/><joint name="${side}_joint" type="prismatic">
<parent link="base"/><child link="${side}"/><xacro:insert_block name="origin"/></joint></xacro:macro><link name="base"/>
<xacro:finger side="left"><origin xyz="${half} 0 ${sin(pi / 4)}"/></xacro:finger>
<xacro:if value="${half > 0 and not False}">
<xacro:finger side="right"><origin xyz="0 ${-half} 0"/></xacro:finger></xacro:if>
</robot>"""


def _moved_robot(path: Path) -> None:
    robot = parse_robot(path.read_bytes(), path)
    robot.transforms({name: np.array([joint.rest]) for name, joint in robot.movable.items()})


def _clouds(*names: str) -> Callable[[], list[bytes]]:
    points = np.random.default_rng(1).uniform(-20, 20, (40, 3)).round(3)
    points[10:20] = points[10]
    return lambda: [CLOUDS[name](points) for name in names]


def _videos() -> list[bytes]:
    images = [np.full((48, 64, 3), 40 * i, np.uint8) for i in range(5)]
    with TemporaryDirectory() as folder:
        return [write_video(Path(folder) / f"a{suffix}", images).read_bytes() for suffix in (".mp4", ".avi", ".mkv")]


def _of_addons() -> dict[str, Target]:
    """Return the targets that each folder of add-ons' tests brings in its `targets`."""
    folders = sorted(file.parent.name for file in PROJECT.glob("tests/addons/*/targets.py"))
    found = (import_module(f"tests.addons.{folder}.targets").TARGETS for folder in folders)
    return {name: target for targets in found for name, target in targets.items()}


TARGETS: Mapping[str, Target] = {
    "robot-description": Target("robot.urdf", lambda: [GRIPPER], _moved_robot, 6),
    "xacro": Target("robot.urdf.xacro", lambda: [XACRO], read_robot, 1),
    "cloud-pcd": Target("cloud.pcd", _clouds("ascii.pcd", "compressed.pcd"), read_cloud, 6),
    "cloud-ply": Target("cloud.ply", _clouds("ascii.ply", "little.ply", "big.ply"), read_cloud, 6),
    "cloud-las": Target("cloud.las", _clouds("old.las", "new.LAS"), read_cloud, 6),
    "cloud-text": Target("cloud.xyz", _clouds("blanks.xyz", "titled.csv", "counted.pts"), read_cloud, 6),
    "video": Target("video.mp4", _videos, lambda path: list(decoded_frames(path, [0, 3])), 1),
    "annotation": Target("annotation.json", lambda: [json.dumps(ANNOTATION).encode()], read_annotation, 4),
    "opencv": Target("camera.yml", lambda: [FILE_STORAGE, OUR_STORAGE, ROBOT_CAL_TOOLS], _lenses, 4),
    "comment-text": Target("comment.json", lambda: [json.dumps(BRIEF).encode()], _commented),
    "repositories": Target("a.repos", lambda: [REPOSITORIES], read_repositories),
    "dockerignore": Target(".dockerignore", lambda: [b"# c\n*.py\n!a\n**/b\n/c/\n[a-z]?\n"], read_ignore_file),
    "urdf-export": Target("robot.urdf", files_of("datasets/riwbot/robot.urdf"), _exported, 4),
    "git-diff": Target("difference", lambda: [DIFFERENCE], lambda path: changed_lines(path.read_bytes())),
    "changes": Target("dataset.json", _changes, lambda path: read_dataset(path, given=DATASETS / "t2rgb"), 2),
    "simulation": Target("simulation.yml", files_of("datasets/riwbot/simulation.yml"), _system, 2),
    "robot": Target("robot.urdf", files_of("datasets/riwbot/robot.urdf"), _system, 2),
    "scenarios": Target("scenarios.yml", lambda: [SCENARIOS], lambda path: read_scenario_set(path, _known_system()), 4),
    "motion": Target("motion.json", files_of("datasets/*/motion.json"), read_motion, 4),
    "truth": Target("ground_truth.json", files_of("datasets/*/ground_truth.json"), read_truth, 4),
    "photograph": Target("image", _photographs, read_image),
    "baseline": Target("baseline.json", files_of("calibration-baseline.json"), read_baseline, 4),
    "results": Target("results.json", _left_by_a_run("results.json"), lambda path: read_results(path.parent), 4),
    "comment": Target("comment.json", _left_by_a_run("comment.json"), read_brief, 4),
    "intrinsics-covariance": Target("intrinsics.json", _left_by_a_run("intrinsics.json"), read_intrinsics, 4),
    "import.yml": Target("import.yml", lambda: [IMPORT], read_description, 4),
    "intrinsics": Target("camera.yaml", lambda: [CAMERA_INFO, CAMCHAIN, OPENCV], read_lens, 4),
    "intrinsics-in-text": Target("mtx.txt", lambda: [b"500 0 320\n0 500 240\n0 0 1\n"], read_lens, 2),
    "camchain": Target("camchain.yaml", lambda: [STEREO], partial(read_lens, name="cam1"), 4),
    "hand-eye-samples": Target("robot.samples", _hand_eye("robot.samples", "moveit.yaml"), _poses, 4),
    "pairs-of-poses": Target("pairs.csv", _hand_eye("pairs.csv"), _poses, 10),
    "poses-in-json": Target("poses.json", _poses_as_json, _poses, 10),
    "poses-in-xml": Target("poses.xml", lambda: [POSES_XML], _poses, 10),
    "poses-in-npz": Target("poses.npz", _poses_as_arrays, _poses, 10),
    "camera-ini": Target("ost.txt", lambda: [CAMERA_INI], read_lens, 4),
    "camera-toml": Target("camera.toml", lambda: [CAMERA_TOML], read_lens, 4),
    "measured-poses": Target("dataset.json", _measured_poses, _calibrated, 1),
    "ros1-bag": Target("recorded.bag", _bag("bag"), _recorded, 4),
    "ros2-mcap": Target("recorded.mcap", _bag("mcap"), _recorded, 4),
    "ros2-db3": Target("recorded.db3", _bag("db3"), _recorded, 4),
    "calibration": Target("dataset.json", _few_collections, _calibrated, 1),
    "dataset": Target("dataset.json", _few_collections, lambda path: check_data(read_dataset(path)), 4),
    "point-cloud": Target("cloud.pcd", files_of("datasets/rlbot/lidar_right_000.pcd"), read_points),
    "depth-image": Target("depth.png", _depth, lambda path: read_depth_image(path, Camera(10, 10, 7.5, 5.5, 16, 12))),
    "atom-configuration": Target("config.yml", files_of("datasets/*/config.yml"), read_atom_configuration, 4),
    "kalibr-target": Target("target.yaml", lambda: [APRILGRID, CHECKERBOARD], _printed, 4),
    "calibration.yml": Target(
        "calibration.yml",
        files_of("calibration.yml", "examples/*/calibration.yml"),
        lambda path: read_configuration(path, VARIABLES),
        4,
    ),
    "image": Target("image.yml", lambda: [IMAGE], read_image_specification, 4),
    "rules": Target("rules.yml", lambda: [RULES], read_rules),
    "table": Target("table.csv", lambda: [TABLE], _judged, 40),
    "tar": Target("artifacts.tar", _tars, _brought_out, 20),
    **_of_addons(),
}
"""By name."""
