import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from defusedxml.ElementTree import parse

from calibration.__main__ import main, run_action
from calibration.base import InputError
from calibration.base.files import matching
from calibration.commands.introspect_csv import command

RMS = "RMS (pix)"
ATOM = """Collection #,RMS (pix),X err (pix),Y err (pix),Trans (mm),Rot (deg)
000,0.5,0.3,0.4,1.5,0.02
001,0.9,0.6,0.5,2.5,0.04
Averages,0.7,0.45,0.45,2.0,0.03
"""


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Work in a folder with a table and a file of rules, outside of GitHub."""
    for name in [name for name in os.environ if name.startswith(("GITHUB_", "INPUT_", "RUNNER_"))]:
        monkeypatch.delenv(name)
    monkeypatch.chdir(tmp_path)
    Path("t.csv").write_text(ATOM)
    Path("rules.yml").write_text(f"rules: [{{column: {RMS}, row: Averages, max: 3}}]\n")
    return tmp_path


def introspect(*arguments: str, column: str | None = RMS) -> int:
    """Check t.csv, by default its column RMS."""
    return main(["introspect-csv", "--file", "t.csv", *(["--column", column] if column else []), *arguments])


def test_the_designs_own_line(capsys: pytest.CaptureFixture[str]) -> None:
    limits = ["--row", "Averages", "--max", "3", "--min", "0", "--every-min", "0", "--every-max", "2"]
    assert introspect(*limits) == 0
    out, err = capsys.readouterr()
    assert out.endswith("pass: 3 checks of 1 table\n")
    assert err == ""


@pytest.mark.parametrize(
    ("arguments", "code"),
    [
        (["--max", "0.9"], 0),
        (["--max", "0.89"], 1),
        (["--max", "0.9", "--exclusive"], 1),
        (["--max", "0.9", "--exclusive", "no"], 0),
        (["--min", "-1", "--row", "first"], 0),
        (["--row", "index:1", "--max", "0.8"], 1),
        (["--aggregate", "p95", "--max", "1"], 0),
        (["--aggregate", "median", "--max", "0.6"], 1),
        (["--aggregate", "mean", "--max", "0.7", "--exclude-summary-rows"], 0),
        (["--max", "3", "--min-rows", "3"], 0),
        (["--max", "3", "--min-rows", "3", "--exclude-summary-rows", "true"], 1),
        (["--max", "3", "--min-rows", "2", "--exclude-summary-rows", "--summary-rows", "Averages,001"], 1),
        (["--max", "3", "--required-rows", "000, 001"], 0),
        (["--max", "3", "--required-rows", "000,002"], 1),
        (["--contains", "0."], 0),
        (["--does-not-contain", "9"], 1),
        (["--matches", r"\d\.\d"], 0),
        (["--matches", r"\d"], 1),
        (["--row", "0.9", "--max", "0.95", "--key-column", RMS], 0),
        (["--baseline", "t.csv", "--max-increase", "0"], 0),
        (["--baseline", "t.csv", "--max-decrease", "10%", "--row", "Averages"], 0),
    ],
)
def test_options(arguments: list[str], code: int) -> None:
    assert introspect(*arguments) == code


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--file", "none.csv", "--column", RMS, "--max", "3"], "none.csv: a CSV file was expected"),
        (["--file", "*.tsv", "--column", RMS, "--max", "3"], "*.tsv: no file matches this pattern"),
        (["--file", ".", "--column", RMS, "--max", "3"], "this is no regular file"),
        (["--file", "t.csv", "--column", "RMS", "--max", "3"], "t.csv: there is no column 'RMS'"),
        (
            ["--file", "t.csv", "--column", RMS, "--row", "Mean", "--max", "3"],
            "t.csv: the column 'Collection #' has no row",
        ),
        (["--file", "t.csv", "--column", RMS, "--key-column", "Run", "--max", "3"], "there is no column 'Run'"),
        (["--file", "t.csv", "--column", RMS], "options: RMS (pix): the rule has no limit"),
        (["--file", "t.csv"], "options: there is no rule"),
        (["--file", "t.csv", "--max", "3"], "max is given without the column that it is for"),
        (["--file", "t.csv", "--exclusive"], "exclusive is given without the column that it is for"),
        (["--file", "t.csv", "--column", RMS, "--min", "3", "--max", "2"], "no number can be as asked"),
        (
            ["--file", "t.csv", "--column", RMS, "--max", "2", "--contains", "x"],
            "max is for numbers and contains for text",
        ),
        (["--file", "t.csv", "--column", RMS, "--max", "nan"], "max: found 'nan', expected a finite number"),
        (["--file", "t.csv", "--column", RMS, "--min-rows", "0"], "'0' is below 1"),
        (["--file", "t.csv", "--column", RMS, "--max", "3", "--delimiter", "ab"], "'ab' is no delimiter"),
        (["--file", "t.csv", "--column", RMS, "--max", "3", "--encoding", "x"], "encoding: 'x' is not the name"),
        (["--file", "t.csv", "--column", RMS, "--max-increase", "1%"], "base-csv is not given"),
        (
            ["--file", "t.csv", "--column", RMS, "--max", "3", "--baseline", "t.csv"],
            "nothing would be compared with it",
        ),
        (["--file", "t.csv", "--column", RMS, "--max-increase", "1%", "--baseline", "none.csv"], "none.csv"),
        (["--file", "t.csv", "--rules", "none.yml"], "none.yml: a file of rules was expected"),
        (["--file", "t.csv", "--rules", "t.csv"], "t.csv:2: this is not valid YAML"),
        (["--rules", "rules.yml"], "file is not given"),
        (["--column", RMS, "--max", "3"], "file is not given"),
        (["--file", " ,\n", "--column", RMS, "--max", "3"], "file is not given"),
        (
            ["--file", "t.csv", "--rules", "rules.yml", "--column", RMS, "--row", "Averages", "--min", "4"],
            "rules.yml and options: no number can be as asked",
        ),
    ],
)
def test_bad_input(capsys: pytest.CaptureFixture[str], arguments: list[str], message: str) -> None:
    assert main(["introspect-csv", *arguments]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("error: ")
    assert message in err
    assert err.count("\n") == 1


@pytest.mark.parametrize(
    ("table", "code"),
    [
        (ATOM.replace("0.7", "nan"), 1),
        (ATOM.replace("0.7", "inf"), 1),
        (ATOM.replace("0.7", "-Infinity"), 1),
        (ATOM.replace("0.7", ""), 1),
        (ATOM.replace("0.7", "n/a"), 1),
        (ATOM.replace("0.7", '"0,7"'), 1),
        (ATOM.splitlines()[0] + "\n", 2),  # the labelled row is missing too
        (ATOM[:-15], 2),
        (ATOM + '003,"0.1', 2),
        (ATOM + "003,0.1\n", 2),
        ("", 2),
        ("\x00\x01\x02", 2),
        ("<html><body>404</body></html>", 2),
        (ATOM.replace(",", ";"), 0),
        (ATOM.replace(",", "\t"), 0),
        ("\ufeff" + ATOM.replace("\n", "\r\n"), 0),
    ],
)
def test_tables(folder: Path, table: str, code: int) -> None:
    (folder / "t.csv").write_bytes(table.encode())
    assert introspect("--row", "Averages", "--min", "0", "--max", "3") == code


def test_no_rows_is_a_fail(folder: Path) -> None:
    (folder / "t.csv").write_text(ATOM.splitlines()[0] + "\n")
    assert introspect("--max", "3") == 1
    assert introspect("--row", "last", "--max", "3") == 1
    assert introspect("--min-rows", "1", column=None) == 1


def test_bad_input_in_one_file_wins_over_a_violation_in_another() -> None:
    assert main(["introspect-csv", "--file", "t.csv,none.csv", "--column", RMS, "--max", "0"]) == 2


def test_files_and_patterns(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (folder / "a" / "b").mkdir(parents=True)
    for name in ("a/y.csv", "a/b/x.csv", "a/[1].csv"):
        (folder / name).write_text(ATOM)
    assert matching(["t.csv", "a/**/*.csv", "t.csv"]) == ["t.csv", "a/[1].csv", "a/b/x.csv", "a/y.csv"]
    assert matching(["a/[1].csv"]) == ["a/[1].csv"]
    assert matching(["none.csv"]) == ["none.csv"]
    with pytest.raises(InputError, match=r"a/\*\.txt: no file matches this pattern"):
        matching(["a/*.txt"])
    with pytest.raises(
        InputError, match=r"^/\*\*/x\.csv: this searches the whole machine: a folder was expected before"
    ):
        matching(["/**/x.csv"])  # such as ${{ steps.calibrate.outputs.output }}/**/x.csv with an empty output
    with pytest.raises(InputError, match="no file matches"):
        matching(["?"])  # matches only the folder a
    monkeypatch.setattr(os, "access", lambda *_: False)
    with pytest.raises(InputError, match=r"^a/\*\.txt: the folder a cannot be read"):
        matching(["a/*.txt"])


def test_every_file_is_judged(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (folder / "u.csv").write_text(ATOM.replace("0.9", "9"))
    assert main(["introspect-csv", "--file", "*.csv", "--column", RMS, "--max", "0.8"]) == 1
    out, err = capsys.readouterr()
    assert out.endswith("fail: 2 violations in 4 checks of 2 tables\n")
    assert err.splitlines() == [
        "error: t.csv:3: RMS (pix), 001: found 0.9, expected at most 0.8",
        "error: u.csv:3: RMS (pix), 001: found 9, expected at most 0.8",
    ]


def test_rules_of_the_file_and_of_the_options_go_together(folder: Path) -> None:
    (folder / "rules.yml").write_text(f"file: t.csv\nmin-rows: 9\nrules: [{{column: {RMS}, row: Averages, max: 3}}]\n")
    assert main(["introspect-csv", "--rules", "rules.yml"]) == 1
    assert main(["introspect-csv", "--rules", "rules.yml", "--min-rows", "3"]) == 0
    assert main(["introspect-csv", "--rules", "rules.yml", "--min-rows", "3", "--column", RMS, "--max", "0.8"]) == 1
    (folder / "rules.yml").write_text("exclude-summary-rows: true\nmin-rows: 3\n")
    assert introspect("--rules", "rules.yml", column=None) == 1
    assert introspect("--rules", "rules.yml", "--exclude-summary-rows", "false", column=None) == 0


def test_a_rigelfile_is_accepted(folder: Path) -> None:
    (folder / "Rigelfile").write_text(
        "jobs:\n  file_introspection:\n    plugin: x\n    with:\n      file: t.csv\n"
        "      introspection_target_columns:\n"
        f"        - {RMS}: {{validation_min: 0.0, validation_max: 2.0, acceptable_max: 0.6, value_row: Averages}}\n"
    )
    assert main(["introspect-csv", "--rules", "Rigelfile"]) == 1


def test_results_are_written(folder: Path) -> None:
    assert introspect("--max", "0.8", "--output", "out/deep") == 1
    output = folder / "out" / "deep"
    assert sorted(path.name for path in output.iterdir()) == ["junit.xml", "results.json", "summary.md"]
    results = json.loads((output / "results.json").read_text())
    assert (results["schema"], results["verdict"], results["violations"]) == (1, "fail", 1)
    assert parse(output / "junit.xml").getroot().attrib["failures"] == "1"
    assert (output / "summary.md").read_text().startswith("## Tables: fail: 1 violation in 2 checks")


def test_the_same_input_gives_the_same_bytes(folder: Path) -> None:
    contents = []
    for name in ("a", "b"):
        introspect("--max", "0.8", "--output", name)
        contents.append([path.read_bytes() for path in sorted((folder / name).iterdir())])
    assert contents[0] == contents[1]


def test_a_result_of_an_earlier_run_does_not_stay(folder: Path) -> None:
    assert introspect("--max", "3", "--output", "out") == 0
    (folder / "out" / "mine.txt").write_text("x")
    (folder / "t.csv").unlink()
    assert introspect("--max", "3", "--output", "out") == 2
    assert [path.name for path in (folder / "out").iterdir()] == ["mine.txt"]


def test_the_input_is_not_changed(folder: Path) -> None:
    introspect("--max", "3", "--output", ".")
    assert (folder / "t.csv").read_text() == ATOM


def test_an_output_that_cannot_be_written_is_an_infrastructure_error(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder / "file").write_text("x")
    assert introspect("--max", "3", "--output", "file") == 3
    assert (
        capsys.readouterr().err == "error: file: the results cannot be written: it, or a folder above it, is a file\n"
    )


def test_as_an_action(folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    for name, value in {
        "GITHUB_ACTIONS": "true",
        "GITHUB_WORKSPACE": str(folder),
        "GITHUB_OUTPUT": str(folder / "outputs"),
        "GITHUB_STEP_SUMMARY": str(folder / "summary"),
        "INPUT_FILE": f"{folder}/t.csv\n",
        "INPUT_COLUMN": RMS,
        "INPUT_MAX": "0.6",
        "INPUT_MIN": "",
        "INPUT_EXCLUSIVE": "false",
        "INPUT_OUTPUT": "out",
    }.items():
        monkeypatch.setenv(name, value)
    assert run_action("introspect-csv") == 1
    out, err = capsys.readouterr()
    assert err == ""
    assert "::error file=t.csv,line=3,title=Tables::RMS (pix), 001: found 0.9, expected at most 0.6\n" in out
    assert "::error file=t.csv,line=4,title=Tables::RMS (pix), Averages: found 0.7, expected at most 0.6" in out
    assert (folder / "summary").read_text() == (folder / "out" / "summary.md").read_text()
    outputs = dict(line.split("=", 1) for line in (folder / "outputs").read_text().splitlines())
    assert (outputs["verdict"], outputs["violations"], outputs["results"]) == ("fail", "2", "out/results.json")
    assert [value["largest"] for value in json.loads(outputs["values"])] == [3, 0.9]


def test_many_violations_are_all_in_the_log_and_ten_are_annotations(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("GITHUB_ACTIONS", "true")
    (folder / "t.csv").write_text("k,v\n" + "".join(f"r{number},5\n" for number in range(30)))
    assert introspect("--max", "3", "--output", "out", column="v") == 1
    out = capsys.readouterr().out
    assert out.count("::error") == 10
    assert "and 21 more" in out
    for text in (out, (folder / "out" / "junit.xml").read_text(), (folder / "out" / "summary.md").read_text()):
        assert all(f"r{number}" in text for number in range(30))


def test_cells_command_nothing(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("GITHUB_ACTIONS", "true")
    (folder / "t.csv").write_text('k,v\n"::add-mask::a","\n::set-output name=x::y"\n"##[add-mask]b",1\n')
    assert introspect("--max", "0", column="v") == 1
    lines = capsys.readouterr().out.split("\n")
    start = next(number for number, line in enumerate(lines) if line.startswith("::stop-commands::"))
    end = lines.index(f"::{lines[start].removeprefix('::stop-commands::')}::")
    obeyed = [line for line in lines[:start] + lines[end + 1 :] if line.startswith("::") or "##[" in line]
    assert all(line.startswith("::error ") for line in obeyed)
    assert len(obeyed) == 2


def test_declared_options_are_the_documented_ones() -> None:
    assert {option.opts[0].removeprefix("--") for option in command.params} == {
        *("file", "rules", "column", "row", "aggregate", "min", "max", "exclusive", "every-min", "every-max"),
        *("contains", "does-not-contain", "matches", "required-rows", "min-rows", "key-column", "delimiter"),
        *("encoding", "exclude-summary-rows", "summary-rows", "base-csv", "max-increase", "max-decrease", "output"),
    }
    assert all(getattr(option, "help", None) for option in command.params)


def test_judging_imports_nothing_heavy() -> None:
    """So that the process needs less than 0.2 s."""
    project = Path(__file__).resolve().parents[2]
    script = (
        "import sys; from calibration.__main__ import main;"
        "code = main(['introspect-csv', '--file', 't.csv', '--column', 'RMS (pix)', '--max', '3']);"
        "heavy = {'numpy', 'scipy', 'cv2', 'rich', 'jsonschema', 'yaml', 'docker', 'boto3'};"
        "sys.exit(f'imported: {heavy & set(sys.modules)}' if heavy & set(sys.modules) else code)"
    )
    environment = {**os.environ, "PYTHONPATH": str(project)}
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, env=environment, timeout=60)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize(
    ("arguments", "code"),
    [
        (["--file", "t.csv", "--column", RMS, "--row", "Averages", "--max", "3"], 0),
        (["--file", "t.csv", "--column", RMS, "--row", "Averages", "--max", "0.6"], 1),
        (["--file", "none.csv", "--column", RMS, "--max", "3"], 2),
        (["--file", "t.csv", "--column", RMS, "--max", "3", "--output", "t.csv"], 3),
    ],
)
def test_exit_codes_of_the_process(folder: Path, arguments: list[str], code: int) -> None:
    project = Path(__file__).resolve().parents[2]
    done = subprocess.run(
        [sys.executable, "-m", "calibration", "introspect-csv", *arguments],
        capture_output=True,
        text=True,
        env={**os.environ, "PYTHONPATH": str(project)},
        timeout=60,
    )
    assert done.returncode == code
    assert "Traceback" not in done.stderr
