"""Joints to calibrate, and transforms that move: read with their checks; what is written reads back the same."""

import json
import math

import numpy as np
import pytest

from calibration.base import InputError
from calibration.engine.dataset.reading import read_dataset
from calibration.engine.dataset.writing import dataset_document, write_dataset
from calibration.engine.evaluation.truth import truth_of
from calibration.engine.geometry.frames import JOINT_PARAMETERS
from tests.engine.dataset import documents
from tests.engine.dataset.documents import MISSING, changed

ELBOW = {
    "transform_key": "mount-cam_link",
    "position": 0.25,
    **dict(zip(JOINT_PARAMETERS[:6], [0.1, 0.0, 0.05, 0.0, 0.2, 0.3], strict=True)),
    "axis_x": 0.0,
    "axis_y": 0.0,
    "axis_z": 2.0,
    "parent_link": "world",
    "child_link": "mount",
    "joint_type": "revolute",
}
CONFIG = "calibration_config/joints"


def document(**changes: object) -> documents.Document:
    """The dataset of `documents` whose mount is a joint."""
    content = changed(
        documents.document(),
        {
            "calibration_config/additional_tfs": None,
            CONFIG: {"elbow": {"params_to_calibrate": ["position_bias", "origin_x"]}},
            "collections/000/joints": {"elbow": dict(ELBOW), "other": {"position": 1.0}},
            "collections/002/joints": {"elbow": {**ELBOW, "position": -0.5}},
            "collections/002/transforms/world-mount/quat": [0, 0, math.sin(-0.375), math.cos(-0.375)],
        },
    )
    return changed(content, {path.replace("__", "/"): value for path, value in changes.items()})


def read(folder, content):
    return read_dataset(documents.write(folder, content))


def test_a_joint(tmp_path):
    dataset = read(tmp_path, document())
    (joint,) = dataset.joints.values()
    assert (joint.name, joint.edge, joint.parameters) == ("elbow", ("world", "mount"), ("origin_x", "position_bias"))
    assert (joint.model.prismatic, joint.model.axis) == (False, (0.0, 0.0, 1.0))
    np.testing.assert_array_equal(joint.values, [0.1, 0.0, 0.05, 0.0, 0.2, 0.3, 0.0])
    np.testing.assert_array_equal(joint.positions, [0.25, -0.5])
    np.testing.assert_array_equal(dataset.with_collections([1]).joints["elbow"].positions, [-0.5])


@pytest.mark.parametrize("nothing", [None, {}, MISSING])
def test_no_joints(tmp_path, nothing):
    assert read(tmp_path, changed(documents.document(), {CONFIG: nothing})).joints == {}


def test_what_was_calibrated_reads_back(tmp_path):
    dataset = read(tmp_path, document())
    values = dataset.joints["elbow"].values + np.array([0.01, 0, 0, 0, 0, 0, 0.02])
    moved = dataset.with_joints({"elbow": values})
    np.testing.assert_allclose(moved.transforms["world", "mount"], moved.joints["elbow"].transform)
    path = write_dataset(moved, tmp_path / "out")
    again = read_dataset(path)
    np.testing.assert_array_equal(again.joints["elbow"].values, values)
    np.testing.assert_array_equal(again.joints["elbow"].positions, [0.25, -0.5])
    np.testing.assert_allclose(again.transforms["world", "mount"], moved.transforms["world", "mount"], atol=1e-12)
    written = json.loads(path.read_text())
    assert written["collections"]["000"]["joints"]["other"] == {"position": 1.0}
    assert written["collections"]["002"]["joints"]["elbow"]["position_bias"] == 0.02
    described = written["transforms"]["world-mount"]
    assert described["joint_name"] == "elbow"
    assert described["joint_params_calibrated"] == ["origin_x", "position_bias"]


def test_what_has_not_changed_is_written_as_it_was_read(tmp_path):
    content = document()
    written = dataset_document(read(tmp_path, content))
    assert written["collections"]["000"]["joints"] == content["collections"]["000"]["joints"]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"collections__002__joints": {}}, "collections/002/joints: missing key 'elbow'"),
        ({"collections__000__joints": {"wrist": ELBOW}},
         r"config/joints/elbow: collection 000 has no joint of this name \(there are: wrist\)"),
        ({"collections__000__joints__elbow__position": 1e308}, "position: found 1e+.308, expected a number from -1e"),
        ({"collections__000__joints__elbow__origin_x": -1e7}, "origin_x: found -10000000.0, expected a number from -1"),
        ({"collections__002__joints": MISSING}, "collections/002: missing key 'joints'"),
        ({"collections__000__joints__elbow__joint_type": "fixed"}, "expected a joint that moves: revolute or"),
        ({"collections__000__joints__elbow__axis_z": 0.0}, r"found the axis \(0, 0, 0\), expected a direction"),
        ({"collections__000__joints__elbow__position": "far"}, "joints/elbow/position"),
        ({"collections__002__joints__elbow__origin_x": 0.2}, "differs from collection 000; only the position"),
        ({"collections__002__joints__elbow__joint_type": "prismatic"}, "differs from collection 000"),
        ({"calibration_config__joints__elbow__params_to_calibrate": ["origin_w"]}, "expected one of origin_x, "),
        ({"calibration_config__joints__elbow__params_to_calibrate": []}, "expected at least one parameter"),
        ({"collections__000__joints__elbow__child_link": "hand", "collections__002__joints__elbow__child_link": "hand"},
         "joints/elbow: its transform, 'world-hand', is none of the collections' transforms"),
        ({"calibration_config__additional_tfs": {"mast": {"parent_link": "world", "child_link": "mount"}}},
         "joints/elbow: its transform, 'world-mount', is calibrated by additional_tfs already"),
        ({f"collections__{c}__joints__elbow__{k}": v for c in ("000", "002")
          for k, v in (("parent_link", "mount"), ("child_link", "cam_link"))},
         "is calibrated by sensor 'cam' already"),
        ({"calibration_config__joints__twin": {"params_to_calibrate": ["origin_x"]},
          "collections__000__joints__twin": ELBOW, "collections__002__joints__twin": ELBOW},
         "joints/twin: its transform, 'world-mount', is calibrated by joint 'elbow' already"),
    ],
)  # fmt: skip
def test_invalid_input_is_reported(tmp_path, changes, message):
    with pytest.raises(InputError, match=message):
        read(tmp_path, document(**changes))


@pytest.mark.parametrize(
    ("first", "second", "kind"),
    [
        (math.degrees(0.25), math.degrees(-0.5), "revolute"),
        (0.25, 0.25, "revolute"),  # it stands still, the transform does not
        (-0.25, 0.5, "revolute"),  # the other way
        (0.25, -0.5, "prismatic"),
    ],
)
def test_positions_that_do_not_go_with_the_transforms(tmp_path, first, second, kind):
    changes = {
        f"collections__{c}__joints__elbow__{key}": value
        for c, position in (("000", first), ("002", second))
        for key, value in (("position", position), ("joint_type", kind))
    }
    with pytest.raises(
        InputError, match=r"002/joints/elbow/position: found .*than in collection 000, but 'world-mount' has moved oth"
    ):
        read(tmp_path, document(**changes))


def test_a_joint_is_read_a_little_later_than_its_transform(tmp_path):
    assert read(tmp_path, document(collections__002__joints__elbow__position=-0.45)).joints


@pytest.mark.parametrize(
    ("described", "shift", "moves"),
    [
        (None, 0.0, False),
        (None, 0.1, True),
        ({"world-mount": {"type": "fixed"}}, 0.1, False),
        ({"world-mount": {"type": "multiple"}}, 0.0, True),
        ({"mount-cam_link": {"type": "multiple"}}, 0.0, False),
        ({"world-mount": {}}, 0.1, True),
    ],
)
def test_an_additional_transform_moves_by_the_files_flag_or_its_values(tmp_path, described, shift, moves):
    content = changed(documents.document(), {"collections/002/transforms/world-mount/trans": [shift, 0.0, 1.0]})
    dataset = read(tmp_path, {**content, "transforms": described} if described else content)
    assert dataset.moving_transforms == ({("world", "mount")} if moves else set())
    again = read_dataset(write_dataset(dataset, tmp_path / "out"))
    assert again.moving_transforms == dataset.moving_transforms
    if moves:
        assert ("world", "mount") not in truth_of(dataset).transforms


def test_a_type_that_is_none(tmp_path):
    content = {**documents.document(), "transforms": {"world-mount": {"type": "floating"}}}
    with pytest.raises(
        InputError, match=r"transforms/world-mount/type: found 'floating', expected 'fixed' or 'multiple'"
    ):
        read(tmp_path, content)
