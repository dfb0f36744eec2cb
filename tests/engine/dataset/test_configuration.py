import dataclasses
import json

import numpy as np
import pytest

from calibration.base import ExitCode, InputError
from calibration.engine.dataset.configuration import parse_configuration, read_configuration
from calibration.engine.dataset.document import Node
from calibration.engine.dataset.reading import read_dataset
from tests.engine.dataset import documents

# As in ATOM's packages: sensors and patterns by name, empty keys, text without quotes.
CONFIG = """
# Path to your xacro description file.
description_file: package://two_description/urdf/two.urdf.xacro
bag_file: $ROS_BAGS/two.bag
world_link: world

sensors:
  cam:
    link: cam_optical
    parent_link: mount
    child_link: cam_link
    topic_name: /cam/image_raw
    modality: rgb
    throttle: 5
  scanner:
    link: scan
    parent_link: mount
    child_link: scan_base
    topic_name: /scan
    modality: lidar2d

additional_tfs:
  mast:
    parent_link: world
    child_link: mount

joints:
  elbow:
    params_to_calibrate: [origin_yaw]

calibration_patterns:
  board:
    link: board_link
    parent_link: world
    fixed: false
    pattern_type: chessboard
    border_size: 0.04
    dimension: {x: 10, y: 7}
    size: 0.1

anchored_sensor: cam
max_duration_between_msgs: 1000
package_name: two_calibration
version: 3.0
"""
VERSION_2 = """
world_link: world
anchored_sensor:
sensors:
  cam: {link: cam_optical, parent_link: mount, child_link: cam_link, topic_name: /cam/image_raw, modality: rgb}
calibration_pattern:
  link: pattern_link
  parent_link: world
  fixed: false
  pattern_type: charuco
  dictionary: DICT_5X5_100
  mesh_file: package://two/pattern.dae
  border_size: {x: 0.04, y: 0.03}
  dimension: {x: 11, y: 8}
  size: 0.06
  inner_size: 0.045
"""


def written(folder, text):
    path = folder / "config.yml"
    path.write_text(text)
    return path


def test_a_configuration(tmp_path):
    config = read_configuration(written(tmp_path, CONFIG))
    assert config.world_link == "world"
    assert config.anchored_sensor == "cam"
    assert config.additional_tfs == {"mast": ("world", "mount")}
    assert config.joints == {"elbow": ("origin_yaw",)}
    assert config.bag_file == "$ROS_BAGS/two.bag"
    assert config.package_name == "two_calibration"
    cam, scanner = config.sensors["cam"], config.sensors["scanner"]
    assert (cam.link, cam.parent_link, cam.child_link) == ("cam_optical", "mount", "cam_link")
    assert (cam.topic_name, cam.modality, cam.throttle) == ("/cam/image_raw", "rgb", 5)
    assert (scanner.modality, scanner.throttle) == ("lidar2d", None)  # whether it is known is not decided here
    board = config.patterns["board"]
    assert (board.dimension, board.size, board.border_size) == ((10, 7), 0.1, (0.04, 0.04))
    assert (board.kind, board.dictionary, board.inner_size, board.mesh_file) == ("chessboard", None, None, "")


@pytest.mark.parametrize("written_as", ["0", "0.0", "null"])
def test_a_chessboard_has_no_markers_whatever_their_size(tmp_path, written_as):
    text = CONFIG.replace(
        "    pattern_type: chessboard\n", f"    pattern_type: chessboard\n    inner_size: {written_as}\n"
    )
    assert text != CONFIG
    assert read_configuration(written(tmp_path, text)).patterns["board"].inner_size is None


def test_a_charuco_board_has_markers(tmp_path):
    text = VERSION_2.replace("inner_size: 0.045", "inner_size: 0.0")
    assert text != VERSION_2
    with pytest.raises(InputError, match=r"inner_size: found 0\.0, expected a number from 1e-06"):
        read_configuration(written(tmp_path, text))


def test_the_geometry_of_its_patterns(tmp_path):
    board = read_configuration(written(tmp_path, CONFIG)).patterns["board"].pattern()
    assert (board.name, board.link, board.parent_link, board.fixed) == ("board", "board_link", "world", False)
    assert board.corners.shape == (70, 3)
    np.testing.assert_allclose(board.corners[[0, 9, 10]], [[0, 0, 0], [0.9, 0, 0], [0, 0.1, 0]], atol=1e-15)
    np.testing.assert_allclose(board.outline[[0, 2]], [[-0.14, -0.14], [1.04, 0.74]], atol=1e-15)


def test_a_configuration_of_version_2(tmp_path):
    config = read_configuration(written(tmp_path, VERSION_2))
    assert list(config.patterns) == ["pattern_1"]
    assert config.anchored_sensor is None
    pattern = config.patterns["pattern_1"]
    assert (pattern.dictionary, pattern.inner_size) == ("DICT_5X5_100", 0.045)
    # The same 0.8 x 0.6 m board with either origin.
    np.testing.assert_allclose(pattern.pattern().outline[[0, 2]], [[-0.04, -0.03], [0.76, 0.57]], atol=1e-15)
    np.testing.assert_allclose(pattern.pattern().corners[0], [0.06, 0.06, 0])
    np.testing.assert_allclose(pattern.pattern("2.0").outline[[0, 2]], [[-0.1, -0.09], [0.7, 0.51]], atol=1e-15)
    np.testing.assert_allclose(pattern.pattern("2.0").corners[0], [0, 0, 0])


@pytest.mark.parametrize("text", [CONFIG, VERSION_2])
def test_the_document_round_trips(tmp_path, text):
    config = read_configuration(written(tmp_path, text))
    document = json.loads(json.dumps(config.to_document()))
    assert parse_configuration(Node(tmp_path, (), document)) == config
    assert document["version"] == 3.0


def test_its_document_is_that_of_the_real_datasets(shared_data):
    for name in ("t2rgb", "riwbot", "rlbot"):
        dataset = read_dataset(shared_data / "synthetic" / name)
        original = dataset.document["calibration_config"]
        assert parse_configuration(Node(dataset.path, (), original)).to_document() == original


def test_nothing_in_it_can_be_changed(tmp_path):
    config = read_configuration(written(tmp_path, CONFIG))
    with pytest.raises(dataclasses.FrozenInstanceError):
        config.world_link = "map"


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("world_link: world", "", "missing key 'world_link'"),
        ("world_link: world", "world_link: on", "world_link: found true, expected text"),
        ("modality: rgb", "", "sensors/cam: missing key 'modality'"),
        ("  cam:\n", "  1:\n", "sensors: found the key 1, expected text"),
        ("  cam:\n", "  2024-01-01:\n", "sensors: found the key 2024-01-01, expected text"),
        ("throttle: 5", "throttle: fast", "sensors/cam/throttle: found 'fast', expected a finite number"),
        ("size: 0.1", "size: .nan", "calibration_patterns/board/size: found nan, expected a finite number"),
        ("size: 0.1", "size: 1e-1", "calibration_patterns/board/size: found '1e-1', expected a finite number"),
        ("{x: 10, y: 7}", "[10, 7]", "calibration_patterns/board/dimension: found a list of 2, expected an object"),
        ("{x: 10, y: 7}", "{x: 10}", "calibration_patterns/board/dimension: missing key 'y'"),
        ("border_size: 0.04", "border_size: {x: 1}", "calibration_patterns/board/border_size: missing key 'y'"),
        ("fixed: false", "fixed: 0", "calibration_patterns/board/fixed: found 0, expected true or false"),
        ("anchored_sensor: cam", "anchored_sensor: lidar", "found 'lidar', expected a sensor (cam, scanner)"),
        ("[origin_yaw]", "origin_yaw", "joints/elbow/params_to_calibrate: found 'origin_yaw', expected a list"),
        ("package_name: two_calibration", "package_name: [1]", "package_name: found a list of 1, expected text"),
    ],
)
def test_what_is_wrong_is_named(tmp_path, old, new, message):
    assert old in CONFIG
    path = written(tmp_path, CONFIG.replace(old, new, 1))
    with pytest.raises(InputError) as caught:
        read_configuration(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert message in str(caught.value)
    assert caught.value.exit_code == ExitCode.BAD_INPUT


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"- a\n",
        b"a: [1, 2",
        b"a: b: c",
        b"\t",
        b"\x00",
        b"\xff\xfe\x00",
        b"a: *nothing",
        b"a: !!python/object/apply:os.system [true]",
        b"a: 2024-13-45",
        b"? [a, b]\n: 1",
        b"{" * 5000,
        b"a: &a [*a]",
        b"world_link: w\nsensors: &s {cam: *s}",
    ],
)
def test_what_is_no_configuration(tmp_path, content):
    path = tmp_path / "config.yml"
    path.write_bytes(content)
    with pytest.raises(InputError) as caught:
        read_configuration(path)
    assert str(path) in str(caught.value)
    assert str(caught.value).isprintable()


def test_no_such_file(tmp_path):
    with pytest.raises(InputError, match=r"config\.yml"):
        read_configuration(tmp_path / "config.yml")


def test_the_configuration_of_a_dataset_gives_the_datasets_patterns(tmp_path):
    dataset = read_dataset(documents.write(tmp_path, documents.document()))
    config = parse_configuration(Node(dataset.path, (), dataset.document["calibration_config"]))
    np.testing.assert_array_equal(config.patterns["board"].pattern().corners, dataset.patterns["board"].corners)
