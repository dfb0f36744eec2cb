"""Systems that nobody made the simulation for: changed files of the ones that ship, collected and calibrated."""

from collections.abc import Mapping
from pathlib import Path

import pytest

from calibration.pipeline.collection.collecting import collect_dataset
from calibration.pipeline.collection.request import CollectionRequest
from calibration.pipeline.collection.results import CollectionResults
from tests.robot.simulation.conftest import DATASETS

Edits = Mapping[str, Mapping[str, str]]
"""By file: replaced texts and their replacements."""


def collected(source: str, folder: Path, edits: Edits, poses: int = 8) -> CollectionResults:
    """A dataset of a system like one that ships, with these differences in its files."""
    system = folder / "system"
    system.mkdir()
    for name in ("robot.urdf", "config.yml", "simulation.yml"):
        text = (DATASETS / source / name).read_text()
        for old, new in edits.get(name, {}).items():
            assert old in text
            text = text.replace(old, new)
        (system / name).write_text(text)
    return collect_dataset(CollectionRequest(system, motion=f"generate:{poses}", seed=3), folder / "output")


def check(results: CollectionResults) -> None:
    """All poses are kept, and they calibrate to the truth."""
    assert results.reasons == []
    assert len(results.kept) == 8
    assert results.proof is not None
    assert results.proof.translation_mm is not None
    assert results.proof.translation_mm < 0.1


def test_a_camera_in_the_hand_of_an_arm_with_a_distorted_lens_and_a_chessboard(tmp_path: Path) -> None:
    results = collected(
        "riwbot",
        tmp_path,
        {
            "robot.urdf": {
                'parent link="tripod_center_support"': 'parent link="flange"',
                'xyz="0 0 0.03"': 'xyz="0.05 0 0.02"',
                '"flange"/>\n    <child link="pattern_link"': '"tabletop"/>\n    <child link="pattern_link"',
                'xyz="0.06 -0.06 0" rpy="0 0 0"': 'xyz="0.7 0.3 0.06" rpy="3.14159265 0 0"',
            },
            "config.yml": {
                "parent_link: flange\n    fixed": "parent_link: tabletop\n    fixed",
                "parent_link: tripod_center_support": "parent_link: flange",
                "pattern_type: charuco": "pattern_type: chessboard",
                "dimension: {x: 7, y: 7}": "dimension: {x: 9, y: 6}",
            },
            "simulation.yml": {"hfov_deg: 60}": "hfov_deg: 60, distortion: [-0.2, 0.05, 0.001, -0.001, 0]}"},
        },
    )
    check(results)
    assert results.corner_rms is not None
    assert results.corner_rms < 0.06


def test_a_camera_that_sees_an_aprilgrid_on_an_arm(tmp_path: Path) -> None:
    results = collected(
        "riwbot",
        tmp_path,
        {
            "config.yml": {
                "pattern_type: charuco": "pattern_type: aprilgrid\n    spacing: 0.3",
                "dictionary: DICT_4X4_100": "dictionary: DICT_APRILTAG_36h11",
                "dimension: {x: 7, y: 7}": "dimension: {x: 4, y: 4}",
                "size: 0.02": "size: 0.03",
                "inner_size: 0.015": "inner_size: null",
            },
        },
    )
    check(results)
    assert results.corner_rms is not None
    assert results.corner_rms < 0.06


@pytest.mark.thorough
def test_the_old_charuco_layout_with_an_even_number_of_rows(tmp_path: Path) -> None:
    results = collected(
        "riwbot",
        tmp_path,
        {
            "simulation.yml": {"scene:": "patterns: {pattern_1: {legacy_layout: true}}\nscene:"},
        },
    )
    check(results)


@pytest.mark.thorough
def test_a_bent_pattern_is_less_accurate(tmp_path: Path) -> None:
    bent = {"simulation.yml": {"scene:": "patterns: {pattern_1: {bow_mm: [3, -2]}}\nscene:"}}
    results = []
    for name, edits in (("flat", {}), ("bent", bent)):
        (tmp_path / name).mkdir()
        results.append(collected("t2rgb", tmp_path / name, edits))
    flat, bowed = (r.proof.rms_px for r in results if r.proof is not None and r.proof.rms_px is not None)
    assert bowed > 1.5 * flat
    rms = [r.corner_rms for r in results]
    assert rms[0] is not None
    assert rms[1] is not None
    assert rms[1] < 1.5 * rms[0]  # the corners are found where they are: it is the pattern that is not as it is said


@pytest.mark.thorough
def test_a_pattern_that_swings_is_lost_for_that(tmp_path: Path) -> None:
    results = collected("t2rgb", tmp_path, {"simulation.yml": {"tilt_deg: 50": "tilt_deg: 50\n  sway_mm: 10"}})
    assert results.verdict == "fail"
    assert any("while the sensors looked, 2 mm are allowed" in reason for r in results.lost for reason in r.lost)
