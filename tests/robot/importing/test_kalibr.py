"""A session of Kalibr (folders of images named by their stamps, camchain, target) becomes a dataset that calibrates."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml

from calibration.__main__ import main
from calibration.base import InputError
from calibration.base.records import read
from calibration.engine.dataset.reading import read_dataset
from calibration.engine.estimation.calibrate import Options, calibrate
from calibration.engine.geometry import rotations
from calibration.engine.geometry.transforms import distance, inverse, transform
from calibration.robot.importing.description import ImportDescription
from calibration.robot.importing.files.pictures import find_pictures, moments_of
from calibration.robot.importing.files.target_files import pattern_configuration
from calibration.robot.importing.importing import import_data
from calibration.robot.labelling.marked_boards import tag_dictionary
from tests.robot.importing.conftest import change
from tests.robot.labelling.pictures import VGA, Photograph, charuco, chessboard, facing
from tests.robot.labelling.test_aprilgrid import BOARD, turned_tags

START = 1403715273262142976
"""The stamp of the first image, ns."""
T_CAM1_CAM0 = transform(rotations.exp(np.array([0.02, -0.1, 0.01])), [-0.2, 0.01, 0.005])
TARGET = {"target_type": "aprilgrid", "tagCols": 6, "tagRows": 6, "tagSize": 0.088, "tagSpacing": 0.3}
CAMERA = {
    "camera_model": "pinhole",
    "intrinsics": VGA.intrinsics[:4].tolist(),
    "distortion_model": "radtan",
    "distortion_coeffs": [0.0, 0.0, 0.0, 0.0],
    "resolution": [VGA.width, VGA.height],
}


def write_session(folder: Path) -> None:
    random, photograph = np.random.default_rng(4), Photograph(VGA, supersampling=2)
    for camera in ("cam0", "cam1"):
        (folder / camera).mkdir(parents=True)
    for number in range(7):
        tilt, turns = random.uniform(0.1, 0.6), random.uniform(-0.5, 0.5)
        T = facing(BOARD, random.uniform(1.1, 1.5), tilt, number, turns, (0.07, 0.0))
        for camera, pose, lag in (("cam0", T, 0), ("cam1", T_CAM1_CAM0 @ T, 3_000_000)):
            file = folder / camera / f"{START + number * 50_000_000 + lag}.png"
            cv2.imwrite(str(file), photograph.of(BOARD, pose))
    (folder / "camchain.yaml").write_text(
        yaml.safe_dump({"cam0": CAMERA, "cam1": {**CAMERA, "T_cn_cnm1": T_CAM1_CAM0.tolist()}})
    )
    (folder / "aprilgrid.yaml").write_text(yaml.safe_dump(TARGET))
    sensors = {
        camera: {"images": camera, "intrinsics": "camchain.yaml", "camera": camera} for camera in ("cam0", "cam1")
    }
    description = {"sensors": sensors, "patterns": {"grid": {"target": "aprilgrid.yaml"}}}
    (folder / "import.yml").write_text(json.dumps(description))


@pytest.fixture(scope="session")
def photographed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("kalibr") / "session"
    write_session(folder)
    return folder


@pytest.fixture
def session(photographed: Path, tmp_path: Path) -> Path:
    """A session of its own, to be changed."""
    return copied(photographed, tmp_path / "session", 7)


@pytest.fixture
def short_session(photographed: Path, tmp_path: Path) -> Path:
    """The same, of three moments: enough to find a mistake in the description."""
    return copied(photographed, tmp_path / "session", 3)


def copied(photographed: Path, folder: Path, moments: int) -> Path:
    for path in photographed.rglob("*"):
        late = path.suffix == ".png" and (int(path.stem) - START) // 50_000_000 >= moments
        if path.is_file() and not late:
            copy = folder / path.relative_to(photographed)
            copy.parent.mkdir(parents=True, exist_ok=True)
            copy.write_bytes(path.read_bytes())
    return folder


def test_it_calibrates_to_the_truth(session: Path, tmp_path: Path) -> None:
    results = import_data(session / "import.yml", tmp_path / "out", jobs=1)
    assert (results.moments, results.together, results.lag_ms) == (7, 7, 3.0)
    assert results.sensors["cam0"].corners > 7 * 130
    calibration = calibrate(read_dataset(tmp_path / "out"), Options(description="rough"))
    found = calibration.dataset.transform("cam1_optical_frame", "cam0_optical_frame")[0]
    m, rad = (float(v) for v in distance(T_CAM1_CAM0, found))
    assert m < 1e-3
    assert np.degrees(rad) < 0.03
    assert calibration.rms_px is not None
    assert calibration.rms_px < 0.1


def test_it_starts_from_the_baseline(session: Path, tmp_path: Path) -> None:
    import_data(session / "import.yml", tmp_path / "out", jobs=1)
    dataset = read_dataset(tmp_path / "out")
    starts = dataset.transform("cam1_optical_frame", "cam0_optical_frame")
    np.testing.assert_allclose(starts, np.broadcast_to(T_CAM1_CAM0, starts.shape), atol=1e-9)


def test_an_aprilgrid_described_in_import_yml_is_the_same(session: Path, tmp_path: Path) -> None:
    described = {"type": "aprilgrid", "columns": 6, "rows": 6, "tag": 0.088, "spacing": 0.3}
    import_data(session / "import.yml", tmp_path / "target", jobs=1)
    change(session, "patterns", "grid", to=described)
    import_data(session / "import.yml", tmp_path / "keys", jobs=1)
    assert (tmp_path / "target" / "dataset.json").read_bytes() == (tmp_path / "keys" / "dataset.json").read_bytes()


def test_labels_are_the_same_again(session: Path, tmp_path: Path) -> None:
    import_data(session / "import.yml", tmp_path / "out", jobs=1)
    arguments = ["--dataset", str(tmp_path / "out"), "--output", str(tmp_path / "again"), "--again", "--jobs", "1"]
    assert main(["label", *arguments]) == 0
    first, again = (read_dataset(tmp_path / name) for name in ("out", "again"))
    for one, other in zip(first.collections, again.collections, strict=True):
        for key in one.labels:
            np.testing.assert_array_equal(one.labels[key].pixels, other.labels[key].pixels)  # type: ignore[union-attr]


def set_target(**keys: object) -> Callable[[Path], None]:
    return lambda folder: (folder / "aprilgrid.yaml").write_text(yaml.safe_dump({**TARGET, **keys})) and None


def photograph_instead(image: np.ndarray) -> Callable[[Path], None]:
    """Other images in place of the first camera's."""

    def put(folder: Path) -> None:
        change(folder, "sensors", "cam0", "intrinsics", to=None)
        change(folder, "sensors", "cam0", "camera", to=None)
        for number, file in enumerate((folder / "cam0").iterdir()):
            other = image.copy()
            other[0, 0] = number  # no copies
            cv2.imwrite(str(file), other)

    return put


def a_larger_checkerboard(folder: Path) -> None:
    target = {"target_type": "checkerboard", "targetCols": 9, "targetRows": 7}
    spacing = {"rowSpacingMeters": 0.06, "colSpacingMeters": 0.06}
    (folder / "aprilgrid.yaml").write_text(yaml.safe_dump({**target, **spacing}))
    photograph_instead(Photograph(VGA).of(chessboard(), facing(chessboard(), 1.1)))(folder)


def with_border_of_one() -> np.ndarray:
    tags = [cv2.aruco.generateImageMarker(tag_dictionary(), i, 50, borderBits=1) for i in range(12)]
    image = np.full((480, 640), 255, np.uint8)
    for i, tag in enumerate(tags):
        y, x = 40 + 90 * (i // 4), 60 + 90 * (i % 4)
        image[y : y + 50, x : x + 50] = tag
    return image


@pytest.mark.thorough(but_first=4)
@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (set_target(tagCols=7), "found its tags with ids up to 35, expected 0 to 41: are columns and rows those of"),
        (set_target(tagCols=4), "found its tags with ids up to 35, expected 0 to 23"),
        (
            set_target(tagRows=5),
            "sees tag 35 of DICT_APRILTAG_36h11, expected 0 to 29, as pattern 'grid' of 6 x 5 tags has",
        ),
        (set_target(tagSpacing=0.0264), "sides of a tag, expected 0.0264: spacing is the gap by the side of a tag"),
        (
            photograph_instead(Photograph(VGA).of(charuco(), facing(charuco(), 1.2))),
            " markers of DICT_5X5_100, expected DICT_APRILTAG_36h11",
        ),
        (
            photograph_instead(cv2.resize(turned_tags(BOARD), (470, 470), interpolation=cv2.INTER_AREA)),
            "found 36 of its tags, not as a board of this size has them: are columns and rows exchanged, or is it not",
        ),
        (photograph_instead(with_border_of_one()), "with a border of one module, expected two, as Kalibr prints them"),
        (a_larger_checkerboard, "(chessboard, 9 x 7 corners) in none of its 3 images; found one of 10 x 7 corners"),
        (photograph_instead(np.full((480, 640), 90, np.uint8)), "bits and no tags are found either"),
        (set_target(tagSize=0), "aprilgrid.yaml: tagSize: found 0, expected a number from 1e-06 to 1000"),
        (set_target(tagSpacing="wide"), "tagSpacing: found 'wide', expected a finite number"),
        (set_target(tagRows=100), "found 6 x 100 tags, expected 587 at most"),
        (set_target(target_type="rings"), "found 'rings', expected one of aprilgrid, checkerboard, circlegrid"),
        (
            set_target(target_type="circlegrid", targetCols=4, targetRows=11, spacingMeters=0.03),
            "found no diameter for 'grid' in import.yml, expected 'diameter' beside 'target'",
        ),
    ],
)
def test_what_is_wrong_is_named(
    short_session: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    damage: Callable[[Path], None],
    message: str,
) -> None:
    damage(short_session)
    output = short_session.parent / "out"
    arguments = ["--config", str(short_session / "import.yml"), "--output", str(output), "--jobs", "1"]
    assert main(["import-data", *arguments]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"tag": None}, "missing key 'tag' of an aprilgrid"),
        ({"spacing": None}, "missing key 'spacing' of an aprilgrid"),
        ({"spacing": 2}, "found 2"),
        ({"square": 0.06}, "found 'square', expected the keys of an aprilgrid: columns, rows, tag, spacing"),
        (
            {"type": "chessboard", "square": 0.06},
            "found 'tag', expected the keys of a chessboard: columns, rows, square",
        ),
        ({"columns": 60, "rows": 60}, "found 60 x 60 tags, expected 587 at most"),
    ],
)
def test_keys_that_are_wrong(session: Path, tmp_path: Path, keys: dict[str, object], message: str) -> None:
    described = {"type": "aprilgrid", "columns": 6, "rows": 6, "tag": 0.088, "spacing": 0.3, **keys}
    change(session, "patterns", "grid", to={key: value for key, value in described.items() if value is not None})
    with pytest.raises(InputError) as error:
        import_data(session / "import.yml", tmp_path / "out", jobs=1)
    assert message in str(error.value)


def stamped(folder: Path, **stamps: list[int]) -> list[dict[str, int]]:
    """The moments of cameras with images of these stamps (ms), as their stamps."""
    pictures = []
    for camera, own in stamps.items():
        (folder / camera).mkdir()
        for stamp in own:
            (folder / camera / f"{START + stamp * 1_000_000}.png").write_bytes(b"")
        pictures.append(find_pictures(camera, str(folder / camera)))
    return [
        {camera: (int(path.stem) - START) // 1_000_000 for camera, path in moment.files.items()}
        for moment in moments_of(pictures)
    ]


def test_images_belong_to_the_nearest(tmp_path: Path) -> None:
    found = stamped(tmp_path, a=[0, 50, 100, 150], b=[48, 103, 171, 200])
    assert found == [{"a": 0}, {"b": 48, "a": 50}, {"a": 100, "b": 103}, {"a": 150}, {"b": 171}, {"b": 200}]


def test_fast_cameras_too(tmp_path: Path) -> None:
    assert stamped(tmp_path, a=[0, 10, 20], b=[9, 19, 29]) == [
        {"a": 0},
        {"b": 9, "a": 10},
        {"b": 19, "a": 20},
        {"b": 29},
    ]


def test_a_camera_that_is_faster_than_the_other(tmp_path: Path) -> None:
    assert stamped(tmp_path, a=[0, 50], b=[1, 5, 51]) == [{"a": 0, "b": 1}, {"b": 5}, {"a": 50, "b": 51}]


def test_three_cameras(tmp_path: Path) -> None:
    assert stamped(tmp_path, a=[0, 50], b=[1, 90], c=[2, 91]) == [
        {"a": 0, "b": 1, "c": 2},
        {"a": 50},
        {"b": 90, "c": 91},
    ]


def test_clocks_that_are_not_synchronised(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"no image of 'b' was taken within 0.02 s .* are their clocks synchronised\?"):
        stamped(tmp_path, a=[0, 50], b=[1000, 1050])


def test_names_that_are_no_stamps(session: Path, tmp_path: Path) -> None:
    change(session, "pairs", to="stamp")
    first = min((session / "cam1").iterdir())
    first.rename(first.with_name("first.png"))
    with pytest.raises(InputError, match="found 'first' as its name, expected a stamp in nanoseconds"):
        import_data(session / "import.yml", tmp_path / "out", jobs=1)


def test_the_board_is_behind_no_mirror(session: Path, tmp_path: Path) -> None:
    """The pose that comes out has the board before the camera, its origin at the bottom left, y down, z away."""
    import_data(session / "import.yml", tmp_path / "out", jobs=1)
    found = calibrate(read_dataset(tmp_path / "out"), Options(description="rough")).dataset
    T = found.transform("cam0_optical_frame", "grid_link")
    assert (T[:, 2, 3] > 0.5).all()
    assert (T[:, 2, 2] > 0).all()
    assert inverse(T)[0].shape == (4, 4)


@pytest.mark.parametrize("kind", ["circles", "asymmetric-circles"])
def test_a_grid_of_circles_is_that_of_our_own_keys(tmp_path: Path, kind: str) -> None:
    """Kalibr's asymmetric grid: circle (row, column) at ((2 column + row % 2) spacing, row spacing)."""
    own = {"columns": 4, "rows": 11, "spacing": 0.03, "diameter": 0.02}
    target = {"target_type": "circlegrid", "targetCols": 4, "targetRows": 11, "spacingMeters": 0.03}
    target["asymmetricGrid"] = kind == "asymmetric-circles"
    (tmp_path / "circles.yaml").write_text(yaml.safe_dump(target))
    patterns = {"ours": {"type": kind, **own}, "theirs": {"target": "circles.yaml", "diameter": 0.02}}
    document = {"sensors": {"camera": {"images": "."}}, "patterns": patterns}
    described = read(ImportDescription, document, "import.yml", tmp_path).patterns
    ours, theirs = (pattern_configuration(replace(each, name="board"), "world") for each in described)
    assert theirs == ours
