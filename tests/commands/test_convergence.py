"""Command ``convergence``."""

import json
import re
from pathlib import Path
from typing import Any

import click
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calibration.__main__ import main
from calibration.commands.calibrate_matrix import command as calibrate_matrix
from calibration.commands.convergence import MAX_LEVELS, SHARED_OPTIONS, command, levels, starts

ROOT = Path(__file__).parents[2]
T2RGB = str(ROOT / "datasets" / "t2rgb")
SMALL = ["--translation-noise", "1", "--rotation-noise", "0:1:2", "--seeds", "2", "--jobs", "1"]


def sweep(output: Path, *options: str) -> int:
    return main(["convergence", "--dataset", T2RGB, "--output", str(output), *SMALL, *options])


def results(output: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads((output / "results.json").read_text())
    return found


def test_both_starts_with_a_map_for_each(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    outputs, summary = tmp_path / "outputs", tmp_path / "summary"
    outputs.touch()
    summary.touch()
    monkeypatch.setenv("GITHUB_OUTPUT", str(outputs))
    monkeypatch.setenv("GITHUB_STEP_SUMMARY", str(summary))
    output = tmp_path / "out"

    assert sweep(output) == 0

    given_map, linear = results(output)["maps"]
    assert [given_map["start"], linear["start"]] == ["given", "linear"]
    assert given_map["largest"]["translation_noise"] == 1
    assert given_map["largest"]["rotation_noise"] == 0
    assert linear["largest"]["diagonal"] == {"translation_noise": 1, "rotation_noise": 1}
    assert sorted(path.name for path in output.iterdir()) == [
        *("convergence.csv", "convergence.png", "convergence.svg", "junit.xml"),
        *("largest-noise.csv", "results.json", "summary.md"),
    ]
    lines = dict(line.split("=", 1) for line in outputs.read_text().splitlines())
    assert (lines["verdict"], lines["largest-translation-noise"], lines["largest-rotation-noise"]) == (
        *("pass", "1.0", "0.0"),
    )
    assert lines["figure"] == str(output / "convergence.png")
    assert "| 1 m | 100 | 0 |" in summary.read_text()
    printed = capsys.readouterr().out
    assert "[16/16]" in printed
    assert "1 m  100    0" in printed
    command = "--translation-noise 0 --rotation-noise 1 --seed-list 1 --start given"
    assert re.search(rf"calibration calibrate-matrix --dataset \S+ {command}", printed)


def test_a_minimum_makes_the_verdict(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert sweep(tmp_path, "--start", "linear", "--minimum-rotation-noise", "1") == 0
    assert sweep(tmp_path, "--start", "given", "--minimum-rotation-noise", "1") == 1
    assert results(tmp_path)["verdict"] == "fail"
    error = "t2rgb, given: largest rotation noise that always converges: found 0 rad, expected at least 1 rad"
    assert f"error: {error}" in capsys.readouterr().err


def test_any_number_of_processes_leaves_the_same_bytes(tmp_path: Path) -> None:
    for jobs in ("1", "3"):
        assert sweep(tmp_path / jobs, "--jobs", jobs) == 0
    for path in (tmp_path / "1").iterdir():
        assert path.read_bytes() == (tmp_path / "3" / path.name).read_bytes()


def test_the_same_as_calibrate_matrix_says(tmp_path: Path) -> None:
    assert sweep(tmp_path / "sweep", "--start", "given") == 0
    options = ["--translation-noise", "0,1", "--rotation-noise", "0,1", "--seeds", "2", "--start", "given"]
    main(["calibrate-matrix", "--dataset", T2RGB, *options, "--output", str(tmp_path / "matrix")])
    cells = results(tmp_path / "matrix")["cells"]
    key = ("translation_noise", "rotation_noise")
    expected = {(*(cell[k] for k in key), cell["seed"]) for cell in cells if cell["verdict"] == "fail"}
    [found] = results(tmp_path / "sweep")["maps"]
    assert expected
    assert expected == {(*(pair[k] for k in key), lost["seed"]) for pair in found["pairs"] for lost in pair["lost"]}


def test_the_noise_of_a_configuration_is_not_the_sweeps(tmp_path: Path) -> None:
    config = tmp_path / "calibration.yml"
    config.write_text(
        f"noise: {{translation: [7], seeds: 30}}\nstart: linear\nsystems:\n  robot: {{dataset: {T2RGB}, "
        "limits: {translation-mm: 0.000001}}\n"
    )
    options = ["--translation-noise", "", "--rotation-noise", "0", "--start", "linear"]
    code = main(["convergence", "--config", str(config), *options, "--output", str(tmp_path / "out")])
    assert code == 1
    found = results(tmp_path / "out")
    assert found["grid"] == {"translation_noise": [0], "rotation_noise": [0], "seeds": list(range(1, 11))}
    assert "robot, linear: the start without noise does not converge: translation error" in found["reasons"][0]


def test_data_that_determine_nothing_are_bad_input(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    document = json.loads(Path(T2RGB, "dataset.json").read_text())
    for collection in document["collections"].values():
        for labels in collection["labels"].values():
            labels["right_camera"]["detected"] = False
    (tmp_path / "dataset.json").write_text(json.dumps(document))
    options = ["--dataset", str(tmp_path), "--output", str(tmp_path / "out"), *SMALL]
    assert main(["convergence", *options]) == 2
    assert "Traceback" not in capsys.readouterr().err
    assert results(tmp_path / "out")["verdict"] == "fail"


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--translation-noise", "0:2"], "'0:2' is no range: FIRST:LAST:COUNT was expected"),
        (["--translation-noise", "2:0:9"], "FIRST below LAST"),
        (["--translation-noise", "0:2:1"], "a COUNT of 2 to"),
        (["--translation-noise", "0:2:999999999999"], "a COUNT of 2 to"),
        (["--translation-noise", "0:2:9.5"], "'9.5' is not a whole number"),
        (["--rotation-noise", "0:nan:3"], "'nan' is not a finite number"),
        (["--rotation-noise", "-1"], "'-1' is below 0"),
        (["--rotation-noise", "0:1:50,2:3:50"], "at most 50 were expected"),
        (["--start", "linaer"], "did you mean 'linear'"),
        (["--start", ","], "start is empty"),
        (["--seeds", "0"], "'0' is below 1"),
        (["--seeds", "1000000000000"], "seeds: found 1000000000000, expected a whole number from 1 to 100000"),
        (["--seeds", "100000", "--rotation-noise", "0:3:21"], "at most 1000000 were expected: take fewer seeds"),
        (["--seed-list", "3"], "seeds and seed-list exclude each other"),
        (["--minimum-translation-noise", "1.5"], "minimum-translation-noise: found 1.5, but the sweep ends at 1"),
        (["--minimum-rotation-noise", "-1"], "below 0"),
        (["--image", "robot:1"], "image and command belong together"),
        (["--backend", "aws-batch"], "runs the team's own software"),
        (["--backend", "aws"], "expected docker or aws-batch"),
        (["--evaluate", "rgb-to-rgb:left:right"], "has no sensor 'left'"),
        (["--config", "calibration.yml"], "exactly one of dataset and config"),
        (["--compare", "shah"], "No such option"),
        (["--image", "a", "--command", "b {output}", "--start", "linear"], "add given"),
    ],
)
def test_wrong_input(options: list[str], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert sweep(tmp_path / "out", *options) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1


def test_an_infrastructure_failure(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "file").touch()
    assert sweep(tmp_path / "file" / "out") == 3
    assert "cannot" in capsys.readouterr().err


def test_the_shared_options_are_those_of_calibrate_matrix() -> None:
    theirs = {option.name: option for option in calibrate_matrix.params}
    mine = {option.name: option for option in command.params}
    assert set(theirs) >= SHARED_OPTIONS
    assert all(mine[name] is theirs[name] for name in SHARED_OPTIONS)
    assert set(theirs) - set(mine) == {
        *("compare", "fail_fast", "datasets", "undecided"),
        *("repeat", "max_flake_rate"),
    }


def test_levels_are_sorted_each_once_and_begin_with_0() -> None:
    assert levels("0:2:9") == (0, 0.25, 0.5, 0.75, 1, 1.25, 1.5, 1.75, 2)
    assert levels("1, 0.5\n0.2:0.4:3") == (0, 0.2, 0.3, 0.4, 0.5, 1)
    assert levels("-0, 0, 0.0") == (0,)
    assert str(levels("-0")[0]) == "0.0"


@given(st.floats(0, 1e6), st.floats(1e-6, 1e6), st.integers(2, MAX_LEVELS - 1))
def test_a_range_has_its_ends_and_its_count(first: float, width: float, count: int) -> None:
    found = levels(f"{first!r}:{first + width!r}:{count}")
    assert found[-1] == pytest.approx(first + width, rel=1e-9)
    assert len(found) <= count + 1
    assert list(found) == sorted(set(found))


@given(st.text(max_size=20))
def test_any_text_is_levels_or_a_usage_error(text: str) -> None:
    try:
        found = levels(text)
    except click.BadParameter:
        return
    assert found[0] == 0
    assert all(level >= 0 and level < float("inf") for level in found)


def test_starts_each_once() -> None:
    assert starts("linear, given,linear") == ("linear", "given")


def test_on_github_the_reason_is_an_annotation(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("GITHUB_ACTIONS", "true")
    assert sweep(tmp_path, "--start", "given", "--minimum-rotation-noise", "0.5") == 1
    assert "::error title=Convergence::t2rgb, given: largest rotation noise" in capsys.readouterr().out
