"""``next-pose`` and ``plan-recording``: poses, promises, files, and what is refused."""

import json
from pathlib import Path

import pytest

from calibration.__main__ import main
from calibration.robot.simulation.motion import read_motion

T2RGB = Path(__file__).resolve().parents[2] / "datasets" / "t2rgb"


def configuration(folder: Path, **more: object) -> Path:
    """A calibration.yml of t2rgb with some keys."""
    system = {"dataset": str(T2RGB), "assume": "exact", **more}
    path = folder / "calibration.yml"
    path.write_text(json.dumps({"systems": {"stereo": system}}))
    return path


def test_poses_until_a_limit_is_decided(tmp_path: Path) -> None:
    """As many as asked for, each expected to leave less, in a motion file that is played."""
    config = configuration(tmp_path, limits={"translation-mm": 0.04})
    assert main(["next-pose", "--config", str(config), "--count", "2", "--output", str(tmp_path / "out")]) == 0
    found = json.loads((tmp_path / "out" / "results.json").read_text())["systems"]["stereo"]
    sizes = [pose["sizes"][0] for pose in found["poses"]]
    assert found["goals"][0]["now"] > sizes[0] > sizes[1]
    assert found["needed"] > 2
    assert len(read_motion(tmp_path / "out" / "next-poses.json")) == 2
    assert (tmp_path / "out" / "next-poses.csv").read_text().count("\n") == 3
    assert "<svg" in (tmp_path / "out" / "report.html").read_text()


def test_a_run_with_an_undecided_limit_says_what_to_record(tmp_path: Path) -> None:
    """In its cell's results, with the files; the accepted calibration would keep the promise."""
    config = configuration(tmp_path, limits={"translation-mm": 0.04}, truth="none")
    assert main(["calibrate-matrix", "--config", str(config), "--output", str(tmp_path / "out")]) == 1
    (cell,) = (tmp_path / "out" / "stereo").iterdir()
    details = json.loads((cell / "results.json").read_text())["cells"][0]
    assert len(details["next_poses"]["poses"]) == len(read_motion(cell / "next-poses.json")) == 3
    promised = details["snapshot"]["promise"]
    assert promised["poses"] == 3
    assert promised["sizes"]["right_camera"]["mm"] == details["next_poses"]["poses"][-1]["sizes"][0]


@pytest.mark.parametrize(
    ("arguments", "found"),
    [
        (["next-pose", "--count", "41"], "found 41"),
        (["next-pose", "--systems", "none"], "none"),
        (["plan-recording", "--system", "nowhere"], "nowhere"),
        (["plan-recording", "--system", str(T2RGB), "--paper", "A4"], "too large"),
        (["plan-recording", "--system", str(T2RGB), "--count", "500"], "found 500"),
    ],
)
def test_wrong_input_is_one_line(
    arguments: list[str], found: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config = ["--config", str(configuration(tmp_path))] if arguments[0] == "next-pose" else []
    assert main([*arguments, *config, "--output", str(tmp_path / "out")]) == 2
    said = capsys.readouterr()
    assert found in said.out + said.err
    assert "Traceback" not in said.out + said.err


def test_a_plan_from_a_description(tmp_path: Path) -> None:
    """Poses that decide a limit, none of which is known before; the boards on paper."""
    plan = ["plan-recording", "--system", str(T2RGB), "--translation-mm", "6", "--count", "4", "--paper", "A0"]
    assert main([*plan, "--output", str(tmp_path)]) == 0
    found = json.loads((tmp_path / "results.json").read_text())["systems"]["t2rgb"]
    assert [goal["unit"] for goal in found["goals"]] == ["mm"]
    assert found["goals"][0]["now"] is None
    assert found["needed"] <= 4
    assert len(read_motion(tmp_path / "next-poses.json")) == 4
    assert (tmp_path / "pattern_1.svg").read_text().startswith("<")
    assert (tmp_path / "pattern_1.pdf").read_bytes().startswith(b"%PDF")
