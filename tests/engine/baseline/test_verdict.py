"""Changes since the accepted calibration are red, with name, size and direction; nothing else is."""

from dataclasses import replace

import pytest

from calibration.base.tables.rules import parse_allowance
from calibration.engine.baseline.calibration_document import (
    CalibratedParameter,
    CalibrationDocument,
    SoftwareStart,
    document_of_calibration,
)
from calibration.engine.baseline.comparison import BaselineChange
from calibration.engine.baseline.quality import BaselineSettings, MaxIncrease, SameData
from calibration.engine.baseline.verdict import Accepted, against_baseline, size_of_change, software_against_baseline
from calibration.engine.diagnosis.finding import Finding
from calibration.engine.estimation.calibrate import calibrate
from calibration.engine.estimation.options import Options
from tests.engine.baseline.scenes import stereo, taken

SINCE = "calibration-baseline.json of 2026-11-02 (1a2b3c4)"
MOVED = (0.0, 0.0, 0.005, 0.0, 0.009, 0.0)


@pytest.fixture(scope="module")
def before() -> CalibrationDocument:
    return taken(stereo(1))


@pytest.fixture(scope="module")
def moved() -> CalibrationDocument:
    return taken(stereo(2, MOVED))


def found(
    before: CalibrationDocument | None, now: CalibrationDocument, settings: BaselineSettings | None = None
) -> tuple[Finding, ...]:
    return against_baseline(Accepted(settings or BaselineSettings(), before, SINCE), now)[1]


def red(*arguments: object) -> list[str]:
    return [each.text for each in found(*arguments) if each.severity == "red"]  # type: ignore[arg-type]


def test_the_same_data_and_program_give_nothing(before: CalibrationDocument) -> None:
    assert found(before, taken(stereo(1))) == ()


def test_other_data_give_a_note_on_the_largest_undetected_move(before: CalibrationDocument) -> None:
    [finding] = found(before, taken(stereo(3)))
    assert finding.severity == "note"
    assert f"nothing has moved since {SINCE}; a move of right by up to" in finding.text


def test_a_rotation_within_its_error_bar_has_no_axis() -> None:
    moved = BaselineChange(name="camera", kind="pose", translation_mm=(0, 0, 3.0), mm=3.0, sigma_mm=0.1, deg=0.002)
    within = replace(moved, rotation_deg=(-0.001, -0.001, 0.0014), sigma_deg=0.005)
    beyond = replace(moved, rotation_deg=(0, 0.002, 0), sigma_deg=0.0005)
    assert size_of_change(within) == "3 ± 0.1 mm along its z, 0.002 ± 0.005 deg"
    assert size_of_change(beyond) == "3 ± 0.1 mm along its z, 0.002 ± 0.0005 deg about its y"


def test_a_sensor_that_has_moved_is_red_by_name_size_and_direction(
    before: CalibrationDocument, moved: CalibrationDocument
) -> None:
    [finding] = [each for each in found(before, moved) if each.severity == "red"]
    assert finding.text.startswith(f"right has moved since {SINCE}: 5")
    assert "along its z" in finding.text
    assert "about its y; p < 1e-09 that this is chance" in finding.text
    assert finding.sensors == ("right",)
    assert finding.moves_mm == pytest.approx(5, abs=0.5)


@pytest.mark.parametrize(
    ("parameter", "advice"),
    [
        (CalibratedParameter("left", "cx", 320.0, "px", 0.2), "the lens"),
        (CalibratedParameter("j2", "origin_z", 0.1, "m", 1e-4), "the joint"),
    ],
)
def test_a_parameter_that_has_changed_says_where_to_look(
    before: CalibrationDocument, parameter: CalibratedParameter, advice: str
) -> None:
    changed = replace(parameter, value=parameter.value + 20 * parameter.sigma)
    now = replace(taken(stereo(3)), parameters=(changed,))
    [text] = red(replace(before, parameters=(parameter,)), now)
    assert text.startswith(f"{parameter.name} has changed since {SINCE}: by ")
    assert f"that this is chance: look at {advice}, or accept it" in text


def test_a_move_within_the_tolerance_is_a_note(before: CalibrationDocument, moved: CalibrationDocument) -> None:
    settings = BaselineSettings(translation_mm=6, rotation_deg=1)
    assert red(before, moved, settings) == []
    assert any("allowed 6 mm, 1 deg" in each.text for each in found(before, moved, settings))
    assert red(before, moved, replace(settings, rotation_deg=0.3)) != []


def test_another_result_of_the_same_data_is_red(before: CalibrationDocument) -> None:
    dataset = stereo(1)
    options = Options(loss="linear", intrinsics=("right",))
    other = calibrate(dataset, options)
    [text, *_] = red(before, document_of_calibration(other, dataset, other.rms_px, options))
    assert text.startswith(f"right differs from {SINCE} on the same data: ")
    assert "what changed beside: options: look there" in text


def test_the_tolerance_on_the_same_data_is_what_is_set(before: CalibrationDocument) -> None:
    pose = next(each for each in before.poses if each.name == "right")
    x, y, z = pose.xyz_mm
    shifted = replace(pose, xyz_mm=(x + 0.004, y, z))
    now = replace(before, poses=tuple(shifted if each is pose else each for each in before.poses))
    exact = BaselineSettings(same_data=SameData(sigmas=0, translation_mm=0.003))
    assert red(before, now, exact) != []
    assert red(before, now, BaselineSettings(same_data=SameData(sigmas=0, translation_mm=0.005))) == []


def test_a_removed_sensor_is_red_and_an_added_one_is_not(before: CalibrationDocument) -> None:
    less = replace(before, poses=tuple(each for each in before.poses if each.name != "right"))
    [text] = red(before, less)
    assert text.startswith("right is in ")
    assert red(less, before) == []
    assert any("right is calibrated, and not in" in each.text for each in found(less, before))


def test_quality_that_is_worse_than_allowed_is_red(before: CalibrationDocument) -> None:
    assert before.rms_px is not None
    worse = replace(before, rms_px=1.06 * before.rms_px)
    [text] = red(before, worse)
    assert text.startswith("worse than the baseline: RMS: found ")
    assert red(before, worse, BaselineSettings(max_increase=MaxIncrease(rms=parse_allowance("10%")))) == []
    rejected = replace(before, rejected_labels=before.labels // 20)
    assert any("rejected labels" in text for text in red(before, rejected))
    assert red(before, replace(before, rms_px=None)) != []


def test_without_an_accepted_calibration_it_is_red_where_required(before: CalibrationDocument) -> None:
    assert found(None, before) == ()
    assert len(red(None, before, BaselineSettings(required=True))) == 1


def test_software_that_became_worse_on_the_same_data_is_red(before: CalibrationDocument) -> None:
    earlier = SoftwareStart(0.1, 0.2, 1, True, 0.5, 1.0)
    accepted = Accepted(BaselineSettings(), replace(before, software=(earlier,)), SINCE)
    assert software_against_baseline(accepted, replace(earlier, rms_px=0.51), before.data) == ()
    [finding] = software_against_baseline(accepted, replace(earlier, rms_px=0.53), before.data)
    assert "RMS: found 0.53 px, expected at most 0.525 px (baseline 0.5)" in finding.text
    [finding] = software_against_baseline(accepted, replace(earlier, distance_mm=3.0), before.data)
    assert "distance from our optimum" in finding.text
    assert software_against_baseline(accepted, replace(earlier, rms_px=0.9), "0" * 64) == ()
    assert software_against_baseline(accepted, replace(earlier, seed=2, rms_px=0.9), before.data) == ()


def test_what_else_has_changed_is_named(before: CalibrationDocument, moved: CalibrationDocument) -> None:
    def with_input(now: CalibrationDocument, name: str) -> CalibrationDocument:
        return replace(now, inputs={**now.inputs, name: "0" * 16})

    pose = next(each for each in before.poses if each.name == "right")
    shifted = replace(pose, xyz_mm=(0.0, 0.0, 0.0))
    now = replace(before, poses=tuple(shifted if each is pose else each for each in before.poses))
    assert "nothing that goes in has changed, but the program has" in red(before, now)[0]
    assert (
        "what changed beside: camera_info of left: look there" in red(before, with_input(now, "camera_info of left"))[0]
    )
    newer = replace(with_input(now, "pattern board"), engine="9.9")
    assert f"pattern board, the engine ({before.engine} to 9.9): look there" in red(before, newer)[0]
    assert "at its mount, and at options, which changed too, or" in red(before, with_input(moved, "options"))[0]
