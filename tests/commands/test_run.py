"""``calibration run``: the pipeline of a repository, and its failures."""

import json
import re
import shutil
from pathlib import Path

import pytest

from calibration.__main__ import main
from calibration.base import InfrastructureError

ROOT = Path(__file__).parents[2]


@pytest.fixture
def repository(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a repository with only a calibration.yml."""
    shutil.copy(ROOT / "calibration.yml", tmp_path)
    (tmp_path / "datasets").symlink_to(ROOT / "datasets")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def with_systems(repository: Path, *names: str) -> None:
    """Leave these of the systems, without other methods beside them."""
    path = repository / "calibration.yml"
    begin, systems, rest = re.split(r"^systems:\n|^(?=simulation:)", path.read_text(), flags=re.MULTILINE)
    kept = [text for text in re.split(r"^(?=  \w)", systems, flags=re.MULTILINE) if text.startswith(names)]
    assert len(kept) == len(names)
    path.write_text(f"{begin}systems:\n" + re.sub(r"(?m)^    compare: .*\n", "", "".join(kept)) + rest)


def edit(repository: Path, old: str, new: str) -> None:
    path = repository / "calibration.yml"
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))


def test_the_shipped_pipeline_is_green(repository: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run"]) == 0

    found = json.loads((repository / "output" / "results.json").read_text())
    assert len(found["cells"]) == 20
    assert {cell["method"] for cell in found["comparisons"]} == {
        *("opencv-stereo", "shah", "li", "tsai", "park", "horaud", "andreff", "daniilidis")
    }
    assert all(cell["truth"] for cell in found["cells"])
    with_joints = [cell for cell in found["cells"] if "joint_mm" in cell["truth"]]
    assert [cell["system"] for cell in with_joints] == ["spjbot"] * 4
    assert all(0 < cell["truth"]["joint_deg"] < 0.01 for cell in with_joints)
    assert "pass: 20 cells calibrated, 1 dataset collected" in capsys.readouterr().out


def test_a_lowered_limit_is_red_and_names_the_cells(repository: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with_systems(repository, "  t2rgb:", "  riwbot:")
    edit(repository, "limits: {translation-mm: 1, rotation-deg: 0.05}", "limits: {translation-mm: 0.0001}")

    assert main(["run", "--only", "calibrate,introspect"]) == 1

    errors = capsys.readouterr().err
    assert "t2rgb, all 4 starts: translation error against the truth: found" in errors
    assert "riwbot" not in errors


@pytest.mark.parametrize(
    ("error", "code", "why"),
    [(KeyboardInterrupt(), 130, "it was stopped"), (InfrastructureError("the disk is full"), 3, "the disk is full")],
)
def test_a_run_that_ends_early_leaves_no_pass_and_goes_on(
    repository: Path, monkeypatch: pytest.MonkeyPatch, error: BaseException, code: int, why: str
) -> None:
    def stop(*_: object) -> None:
        raise error

    with_systems(repository, "  riwbot:")
    with monkeypatch.context() as patch:
        patch.setattr("calibration.pipeline.stages.judge_results", stop)
        assert main(["run", "--only", "calibrate,introspect"]) == code
    found = json.loads((repository / "output" / "results.json").read_text())
    assert (found["verdict"], found["reasons"]) == ("fail", [f"the run ended early: {why}"])
    for name in ("junit.xml", "summary.md", "badge.svg", "comment.json"):
        assert "fail" in (repository / "output" / name).read_text(), name

    assert main(["run", "--only", "introspect"]) == 0
    assert json.loads((repository / "output" / "results.json").read_text())["verdict"] == "pass"


def test_stages_run_alone_and_pass_files_on(repository: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with_systems(repository, "  t2rgb:", "  riwbot:")
    edit(repository, "row: Averages, min: 0, max: 1", "row: Averages, min: 0, max: 0.001")

    assert main(["run", "--only", "calibrate"]) == 0
    assert main(["run", "--only", "introspect"]) == 1
    assert "RMS (pix), Averages" in capsys.readouterr().err
    edit(repository, "max: 0.001", "max: 1")
    assert main(["run", "--only", "introspect"]) == 0


def test_without_a_table_the_kind_of_rms_is_stated_and_earlier_cells_are_removed(
    repository: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = repository / "calibration.yml"
    for noise in ("[0, 0.5]", "[0.3]"):
        path.write_text(f"noise: {{translation: {noise}}}\nsystems: {{arm: {{dataset: datasets/riwbot}}}}\n")
        assert main(["run"]) == 0
    assert "RMS of arm: of all corners against where the calibration puts them" in capsys.readouterr().out
    assert [each.name for each in (repository / "output" / "arm").iterdir()] == ["translation-0.3_rotation-0_seed-1"]


def test_introspection_without_results_is_bad_input(repository: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", "--only", "introspect"]) == 2
    assert "results.json" in capsys.readouterr().err
    assert not (repository / "output").exists()


def test_an_unknown_stage_is_bad_input(repository: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", "--only", "calibrat"]) == 2
    assert "did you mean 'calibrate'" in capsys.readouterr().err


def test_a_missing_configuration(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)

    assert main(["run"]) == 2
    assert "calibration.yml" in capsys.readouterr().err


def test_the_schemas_are_printed(capsys: pytest.CaptureFixture[str]) -> None:
    for name in ("calibration.yml", "results", "introspection"):
        assert main(["schema", name]) == 0
        assert "$schema" in json.loads(capsys.readouterr().out)


def test_on_github_a_broken_rule_is_annotated_at_its_line(
    repository: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    with_systems(repository, "  t2rgb:", "  riwbot:")
    edit(repository, "row: Averages, min: 0, max: 1", "row: Averages, min: 0, max: 0.001")
    monkeypatch.setenv("GITHUB_ACTIONS", "true")
    assert main(["run", "--only", "calibrate,introspect"]) == 1
    lines = (repository / "calibration.yml").read_text().splitlines()
    [at] = [i for i, line in enumerate(lines, 1) if "max: 0.001" in line]
    assert f"::error file=calibration.yml,line={at},title=Calibration::" in capsys.readouterr().out
