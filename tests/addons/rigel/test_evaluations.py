"""ATOM's evaluations in commands, as ``evaluate`` has them."""

import pytest

from calibration.addons.rigel.fields import Notes
from calibration.addons.rigel.systems import evaluation_in
from calibration.engine.evaluation.specification import TABLE_KINDS, parse_evaluation

JSON = "-train_json /d/atom_calibration.json -test_json $DATASETS/test.json"
COMMANDS = {
    "rgb_to_rgb_evaluation -ss left -st right": "rgb-to-rgb:left:right",
    "rgb_to_rgb_evaluation --sensor_source left --sensor_target right -pn p_1": "rgb-to-rgb:left:right:p_1",
    "inter_collection_rgb_to_rgb_evaluation -ss cam -st cam -wf world": "inter-collection-rgb-to-rgb:cam:cam",
    "cross_collection_rgb_to_rgb_evaluation -st b -ss a -wf world": "inter-collection-rgb-to-rgb:a:b",
    "single_rgb_evaluation -ssf 'lambda s: s in [a]' -cpt": "single-rgb",
    "lidar_to_rgb_evaluation -rs lidar -cs cam -sfr": "lidar-to-rgb:lidar:cam",
    "inter_collection_lidar_to_rgb_evaluation -rs lidar -cs cam": "inter-collection-lidar-to-rgb:lidar:cam",
    "depth_to_rgb_evaluation -ds depth -cs cam": "depth-to-rgb:depth:cam",
    "inter_collection_depth_to_rgb_evaluation -ds depth -cs cam": "inter-collection-depth-to-rgb:depth:cam",
    "lidar_to_lidar_evaluation -ss a -st b": "lidar-to-lidar:a:b",
    "inter_collection_lidar_to_lidar_evaluation -ss a -st b": "inter-collection-lidar-to-lidar:a:b",
    "lidar_to_depth_evaluation --range_sensor=a --depth_sensor='b'": "lidar-to-depth:a:b",
    "inter_collection_lidar_to_depth_evaluation -rs a -ds b -bt 0.1": "inter-collection-lidar-to-depth:a:b",
    "depth_to_depth_evaluation -ss a -st b -ua": "depth-to-depth:a:b",
    "inter_collection_depth_to_depth_evaluation -ss a -st b": "inter-collection-depth-to-depth:a:b",
    "ground_truth_transform_evaluation -p base -c cam_link -sac": "ground-truth-transform:base:cam_link",
    "ground_truth_frame_evaluation -tf base": "ground-truth-frame:base",
    "ground_truth_frame_evaluation -tf base -sf cam": "ground-truth-frame:base:cam",
}


@pytest.mark.parametrize(("command", "expected"), COMMANDS.items())
@pytest.mark.parametrize("around", ["{}", "rosrun atom_evaluation {} -sfr", "bash -c 'calibrate -ss 1 && {} && true'"])
def test_each_evaluation_of_atom_is_recognised(command: str, expected: str, around: str) -> None:
    notes = Notes()
    script, _, flags = command.partition(" ")
    assert evaluation_in(around.format(f"{script} {JSON} {flags}"), notes, "jobs.a") == expected
    assert list(notes) == []
    assert str(parse_evaluation(expected)) == expected


def test_there_is_one_of_each_kind() -> None:
    assert {parse_evaluation(text).kind for text in COMMANDS.values()} == set(TABLE_KINDS) - {
        "measured-poses"
    }  # not ATOM's


@pytest.mark.parametrize(
    "command",
    ["calibrate -json x", "my_evaluation -ss a -st b", "rgb_to_rgb_evaluations -ss a -st b", "evaluation", ""],
)
def test_other_commands_have_none(command: str) -> None:
    notes = Notes()
    assert evaluation_in(command, notes, "jobs.a") is None
    assert list(notes) == []


def test_the_first_counts_and_its_flags_are_its_own() -> None:
    command = "rgb_to_rgb_evaluation -ss a -st b; lidar_to_rgb_evaluation -rs l -cs c -pn p"
    assert evaluation_in(command, Notes(), "jobs.a") == "rgb-to-rgb:a:b"


def test_a_command_over_several_lines_is_one() -> None:
    assert evaluation_in("rgb_to_rgb_evaluation \\\n -ss a \\\n -st b\n", Notes(), "jobs.a") == "rgb-to-rgb:a:b"


@pytest.mark.parametrize("flags", ["-ss a", "-ss a; -st b", "-ss a -st ${{RIGHT}}", "-ss a -st", "-ss a -st -sfr"])
def test_what_cannot_be_read_is_noted(flags: str) -> None:
    notes = Notes()
    assert evaluation_in(f"rgb_to_rgb_evaluation {flags}", notes, "jobs.a") is None
    assert [str(note) for note in notes] == [
        "jobs.a: evaluate: rgb_to_rgb_evaluation has no --sensor_target that can be read: write the table"
    ]
