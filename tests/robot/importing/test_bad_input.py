"""Errors in a recording are named in one line, and leave no files."""

import json
import random
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory

import cv2
import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from calibration.__main__ import main
from calibration.base import CalibrationError, InputError
from calibration.robot.importing.files.camera_files import read_lens
from calibration.robot.importing.files.samples import Samples as PosesDescription
from calibration.robot.importing.files.samples import read_samples
from calibration.robot.importing.files.target_files import pattern_configuration
from calibration.robot.importing.image_views import decoded_image
from calibration.robot.importing.importing import import_data, read_description
from tests.robot.importing.conftest import BOARD, CAMERAS, camera_info, change
from tests.robot.importing.hand_eye import WRITERS, Samples, simulated

LEFT, RIGHT = CAMERAS


def cut(folder: Path) -> None:
    file = folder / LEFT / "0.jpg"
    file.write_bytes(file.read_bytes()[:100])


def smaller(folder: Path) -> None:
    file = folder / LEFT / "3.jpg"
    cv2.imwrite(str(file), cv2.resize(cv2.imread(str(file)), None, fx=0.5, fy=0.5))


def all_smaller(folder: Path) -> None:
    for file in (folder / LEFT).iterdir():
        cv2.imwrite(str(file), cv2.resize(cv2.imread(str(file)), (320, 240)))


def copied(folder: Path) -> None:
    (folder / LEFT / "7.jpg").write_bytes((folder / LEFT / "3.jpg").read_bytes())


def renamed(folder: Path) -> None:
    for file in (folder / RIGHT).iterdir():
        file.rename(file.with_name(f"{100 + int(file.stem)}.jpg"))


def nameless(folder: Path) -> None:
    for number, file in enumerate((folder / RIGHT).iterdir()):
        file.rename(file.with_name("abcdefgh"[number] + ".jpg"))


def blank(folder: Path) -> None:
    for file in (folder / LEFT).iterdir():
        cv2.imwrite(str(file), np.full((480, 640), 90 + int(file.stem), np.uint8))


def exchanged(folder: Path) -> None:
    change(folder, "patterns", "board", "columns", to=8)
    change(folder, "patterns", "board", "rows", to=11)


def set_to(*keys: str, to: object) -> Callable[[Path], None]:
    return lambda folder: change(folder, *keys, to=to)


def test_libraries_print_nothing_of_a_damaged_image(capfd: pytest.CaptureFixture[str]) -> None:
    noise = np.random.default_rng(1).integers(0, 255, (40, 60, 3), np.uint8)
    data = bytearray(cv2.imencode(".png", noise)[1])
    data[len(data) // 2] ^= 1
    with pytest.raises(InputError, match="not a readable image"):
        decoded_image(bytes(data), "0.png")
    assert capfd.readouterr().err == ""


@pytest.mark.thorough(but_first=8)
@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (cut, "0.jpg: this is not a readable image, or it is truncated"),
        (smaller, "3.jpg: found 320 x 240 pixels, expected 640 x 480 as"),
        (all_smaller, "found an image of 320 x 240 pixels, expected 640 x 480 as"),
        (copied, "7.jpg: found the same pixels as in"),
        (renamed, "no image of 'right_camera' belongs to one of 'left_camera' by its number"),
        (nameless, "found no number in its name"),
        (blank, "'left_camera' sees pattern 'board' (charuco, 11 x 8 corners, DICT_5X5_100) in none of its 6 images"),
        (set_to("patterns", "board", "dictionary", to="DICT_6X6_100"), "markers of another dictionary, DICT_5X5_100"),
        (
            set_to("patterns", "board", to={"type": "chessboard", "columns": 11, "rows": 8, "square": 0.06}),
            " markers of DICT_5X5_100: is it a charuco board or an aprilgrid?",
        ),
        (set_to("patterns", "board", "dictionary", to="DICT_5X5"), "found dictionary 'DICT_5X5'"),
        (set_to("patterns", "board", "columns", to=7), "are columns and rows those of the printed board"),
        (set_to("patterns", "board", "columns", to=12), "columns and rows"),
        (
            exchanged,
            "'left_camera' sees markers of DICT_5X5_100, but not where pattern 'board' of 8 x 11 corners has them",
        ),
        (set_to("patterns", "board", "columns", to=None), "missing key 'columns' of a charuco board"),
        (set_to("patterns", "board", "marker", to=0.06), "found 0.06, expected less than the square, 0.06"),
        (set_to("patterns", "board", "target", to="april.yaml"), "target"),
        (set_to("sensors", LEFT, "images", to="nowhere"), "nowhere: found no such folder"),
        (set_to("sensors", LEFT, "images", to="left_camera/*.png"), "no file matches this pattern"),
        (set_to("sensors", LEFT, "images", to=None), "'left_camera': missing key 'images'"),
        (set_to("sensors", LEFT, "intrinsics", to="none.yaml"), "none.yaml"),
        (set_to("sensors", LEFT, "frame", to="world"), "world"),
        (set_to("sensors", LEFT, "camera", to="cam0"), "leave out 'camera'"),
        (set_to("anchored", to="lidar"), "expected a sensor: left_camera, right_camera"),
        (set_to("pairs", to="pairs.csv"), "pairs.csv"),
        (set_to("samples", to={"file": "poses.csv"}), "neither a sensor nor a pattern is mounted on the tool"),
    ],
)
def test_it_is_one_line_and_leaves_nothing(
    stereo: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], damage: Callable[[Path], None], message: str
) -> None:
    damage(stereo)
    output = tmp_path / "out"
    arguments = ["--config", str(stereo / "import.yml"), "--output", str(output), "--jobs", "1"]
    assert main(["import-data", *arguments]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
    assert not (output / "dataset.json").exists()


def test_too_few_images_for_intrinsics(stereo: Path, tmp_path: Path) -> None:
    change(stereo, "sensors", LEFT, "intrinsics", to=None)
    change(stereo, "sensors", LEFT, "images", to="left_camera/[0-2].jpg")
    with pytest.raises(InputError, match="'left_camera' has no intrinsics, and 3 images with a pattern"):
        import_data(stereo / "import.yml", tmp_path / "out", jobs=1)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "found no pose"),
        ("image,x,y,z\na.jpg,1,2,3\n", ":2: missing column 'qx'"),
        ("x,y,z,qx,qy,qz,qw\n1,2,3,0,0,0,2\n", ":2: found a quaternion of length 2"),
        ("x,y,z,qx,qy,qz,qw\n1,2,nan,0,0,0,1\n", ":2: found 'nan' as z"),
        ("image,x,y,z,qx,qy,qz,qw\na.jpg,1,2,3,0,0,0,1\na.jpg,1,2,3,0,0,0,1\n", "found the image of"),
    ],
)
def test_poses_that_are_none(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "poses.csv").write_text(text)
    with pytest.raises(InputError) as error:
        read_samples(PosesDescription(file=tmp_path / "poses.csv"), in_hand=True)
    assert message in str(error.value)


def test_samples_stay_in_their_folder(tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    (tmp_path / "pose.yaml").write_text("x: 0")
    (tmp_path / "in" / "list.yaml").write_text("- {image: a.jpg, pose: ../pose.yaml}")
    with pytest.raises(InputError, match="expected a file in the folder of this one"):
        read_samples(PosesDescription(file=tmp_path / "in" / "list.yaml"), in_hand=True)


def text_of(write: Callable[[Samples, Path], None]) -> str:
    """Of a file with three hand-eye samples."""
    with TemporaryDirectory() as folder:
        write(simulated(in_hand=True, count=3), Path(folder) / "file")
        return (Path(folder) / "file").read_text()


def _read_poses(path: Path) -> None:
    read_samples(PosesDescription(file=path), in_hand=True)


FILES: dict[str, tuple[str, Callable[[Path], object]]] = {
    "camera.yaml": (yaml.safe_dump(camera_info()), read_lens),
    "camera.yml": ("%YAML:1.0\n---\nK: !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n   data: [1]\n", read_lens),
    "target.yaml": (
        "target_type: checkerboard\ntargetCols: 6\ntargetRows: 7\nrowSpacingMeters: 0.06\ncolSpacingMeters: 0.06\n",
        lambda path: pattern_configuration(
            read_description(_description(path, {"board": {"target": path.name}})).patterns[0], "world"
        ),
    ),
    "aprilgrid.yaml": (
        "target_type: 'aprilgrid'\ntagCols: 6\ntagRows: 6\ntagSize: 0.088\ntagSpacing: 0.3\n",
        lambda path: pattern_configuration(
            read_description(_description(path, {"board": {"target": path.name}})).patterns[0], "world"
        ).pattern(),
    ),
    "import.yml": (
        yaml.safe_dump({"sensors": {"left": {"images": "left"}}, "patterns": {"board": BOARD}}),
        read_description,
    ),
    "poses.csv": ("image,x,y,z,qx,qy,qz,qw\na.jpg,1,2,3,0,0,0,1\n", _read_poses),
    "poses.yaml": ("- {image: a.jpg, pose: poses.yaml}\n", _read_poses),
    **{name: (text_of(write), _read_poses) for name, write in WRITERS.items()},
}


def _description(path: Path, patterns: object) -> Path:
    file = path.with_name("of_target.yml")
    file.write_text(json.dumps({"sensors": {"left": {"images": "left"}}, "patterns": patterns}))
    return file


@pytest.mark.parametrize("name", FILES)
@given(seed=st.integers(0, 2**32))
def test_mutated_files_are_errors_or_nothing(tmp_path_factory: pytest.TempPathFactory, name: str, seed: int) -> None:
    text, reader = FILES[name]
    folder = tmp_path_factory.getbasetemp() / "mutated"
    folder.mkdir(exist_ok=True)
    draw = random.Random(seed)
    data = bytearray(text.encode())
    for _ in range(draw.randint(1, 6)):
        at = draw.randrange(len(data))
        match draw.randrange(4):
            case 0:
                data[at] = draw.randrange(256)
            case 1:
                del data[at : at + draw.randint(1, 20)]
                data = data or bytearray(b" ")
            case 2:
                data[at:at] = draw.choice([b"\n", b": ", b"[", b"1e999", b"-1", b".nan", b"null", b"&a ", b"*a", b"\0"])
            case _:
                data[at:at] = data[draw.randrange(len(data)) :][:30]
    (folder / name).write_bytes(data)
    with suppress(CalibrationError):  # one line by its own tests; anything else fails here
        reader(folder / name)
