"""Command ``static-analysis``: a repository, a change, a verdict."""

import json
import os
from pathlib import Path
from typing import Any

import jsonschema
import pytest

from calibration.__main__ import main, run_action
from calibration.addons import analysis
from calibration.addons.analysis import copies
from tests.repositories import commit, git, write

NAME = "static-analysis"
SCHEMA = json.loads(Path(analysis.__file__ or "").with_name("results.schema.json").read_text())
GOOD = '"""Names."""\n\n\ndef joined(*names):\n    return "_".join(names)\n'
BAD = "\n\ndef calculated(text):\n    return eval(text)\n"
FINDING = "naming.py:9"
SARIF = {
    "type": "object",
    "required": ["version", "runs"],
    "properties": {
        "version": {"const": "2.1.0"},
        "runs": {
            "type": "array",
            "items": {
                "required": ["tool", "results"],
                "properties": {
                    "tool": {"properties": {"driver": {"required": ["name"]}}, "required": ["driver"]},
                    "columnKind": {"enum": ["utf16CodeUnits", "unicodeCodePoints"]},
                    "results": {
                        "items": {
                            "required": ["message", "ruleId", "locations", "partialFingerprints"],
                            "properties": {
                                "level": {"enum": ["none", "note", "warning", "error"]},
                                "baselineState": {"enum": ["new", "unchanged", "updated", "absent"]},
                                "message": {"required": ["text"], "properties": {"text": {"minLength": 1}}},
                                "locations": {
                                    "minItems": 1,
                                    "items": {
                                        "properties": {
                                            "physicalLocation": {
                                                "properties": {
                                                    "artifactLocation": {
                                                        "properties": {"uri": {"pattern": "^[!-~]+$"}}
                                                    },
                                                    "region": {
                                                        "properties": {"startLine": {"type": "integer", "minimum": 1}}
                                                    },
                                                }
                                            }
                                        }
                                    },
                                },
                            },
                        }
                    },
                },
            },
        },
    },
}
"""Schema of SARIF 2.1.0 for the parts that are written."""


@pytest.fixture(autouse=True)
def root(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Work in a repository with one commit, outside of GitHub."""
    for name in [name for name in os.environ if name.startswith(("GITHUB_", "INPUT_", "RUNNER_"))]:
        monkeypatch.delenv(name)
    root = tmp_path / "p"
    root.mkdir()
    git(root, "init")
    commit(root, {"naming.py": GOOD})
    monkeypatch.chdir(root)
    return root


def results(output: Path) -> Any:
    """Return the results, validated against their schema, and SARIF against its own."""
    jsonschema.validate(json.loads((output / "findings.sarif").read_text()), SARIF)
    document = json.loads((output / "results.json").read_text())
    jsonschema.validate(document, SCHEMA)
    return document


def run(root: Path, *arguments: str) -> tuple[int, Any]:
    """Run the command in the repository; return exit code and results."""
    output = root.parent / "output"
    code = main([NAME, "--output", str(output), *arguments])
    return code, results(output) if code < 2 else None


def test_the_section_of_a_configuration_says_what_options_do_not(root: Path, capfd: pytest.CaptureFixture[str]) -> None:
    write(root, {"naming.py": GOOD + BAD, "calibration.yml": "systems: 3\nanalysis: {max-new: [all=1]}\n"})
    arguments = ("--base", "HEAD", "--tools", "ruff", "--config", "calibration.yml")
    assert run(root, *arguments)[0] == 0
    assert run(root, *arguments, "--max-new", "all=0")[0] == 1
    write(root, {"calibration.yml": "analysis: {tools: 3}"})
    assert run(root, *arguments)[0] == 2
    assert "calibration.yml: analysis: tools: found 3" in capfd.readouterr().err


def test_findings_of_a_change_fail_at_their_lines(root: Path, capfd: pytest.CaptureFixture[str]) -> None:
    write(root, {"naming.py": GOOD + BAD})
    code, found = run(root, "--base", "HEAD")
    assert code == 1
    assert [f"{each['path']}:{each['line']}" for each in found["new"]] == [FINDING]
    assert found["reasons"] == ["new findings (security): found 1, expected at most 0"]
    output = capfd.readouterr()
    assert f"warning: {root}/{FINDING}: " in output.err
    assert output.out.splitlines()[-1].startswith("fail: new findings (security): found 1, expected at most 0; 1 file")


def test_the_same_in_the_base_is_not(root: Path) -> None:
    commit(root, {"naming.py": GOOD + BAD})
    write(root, {"naming.py": "# a line more\n" + GOOD + BAD, "other.py": GOOD})
    git(root, "add", ".")
    code, found = run(root, "--base", "HEAD")
    assert code == 0
    assert (found["new"], len(found["unchanged"]), found["fixed"]) == ([], 1, [])


def test_removed_findings_are_fixed(root: Path) -> None:
    commit(root, {"naming.py": GOOD + BAD})
    git(root, "mv", "naming.py", "names.py")
    write(root, {"names.py": GOOD})
    code, found = run(root, "--base", "HEAD")
    assert code == 0
    assert [each["path"] for each in found["fixed"]] == ["naming.py"]


def test_a_stricter_rule_alone_makes_nothing_new(root: Path) -> None:
    commit(root, {"naming.py": GOOD + BAD, "ruff.toml": 'lint.select = ["F"]\n'})
    write(root, {"naming.py": GOOD + BAD + "\nX = 1\n", "ruff.toml": 'lint.select = ["F", "S"]\n'})
    code, found = run(root, "--base", "HEAD")
    assert code == 0
    assert len(found["unchanged"]) == 1


def test_without_a_base_all_findings_are_reported_and_none_is_new(root: Path) -> None:
    write(root, {"naming.py": GOOD + BAD})
    code, found = run(root)
    assert (code, found["base"], found["new"], len(found["unchanged"])) == (0, None, [], 1)
    assert "there is no base to compare with" in found["remarks"][0]
    assert run(root, "--max-total", "security=0")[0] == 1


def test_files_with_too_many_findings_are_named_the_worst_first(root: Path) -> None:
    commit(root, {"two.py": GOOD + BAD + BAD, "three.py": GOOD + BAD * 3, "one.py": GOOD + BAD})
    code, found = run(root, "--max-file", "security=1, error=0")
    assert code == 1
    assert found["problems"] == [
        "findings (security) of three.py: found 3, expected at most 1",
        "findings (security) of two.py: found 2, expected at most 1",
    ]
    assert run(root, "--max-file", "all=5")[0] == 0


def test_accepted_findings_are_counted_and_do_not_fail(root: Path) -> None:
    text = "suppressions:\n- {rule: ruff/S307, reason: only our own texts}\n"
    write(root, {"naming.py": GOOD + BAD, ".static-analysis.yml": text})
    code, found = run(root, "--base", "HEAD")
    assert code == 0
    assert [each["reason"] for each in found["suppressed"]] == ["only our own texts"]
    log = json.loads((root.parent / "output" / "findings.sarif").read_text())
    told = [each.get("suppressions") for run in log["runs"] for each in run["results"]]
    assert told == [[{"kind": "external", "justification": "only our own texts"}]]


def test_fingerprints_stay_when_code_moves(root: Path) -> None:
    prints = []
    for text in (GOOD + BAD, "# more\n\n" + GOOD + BAD.replace("    return", "        return").replace("def", "  def")):
        write(root, {"naming.py": text.replace("  def", "def").replace("        return", "    return")})
        run(root)
        log = json.loads((root.parent / "output" / "findings.sarif").read_text())
        prints.append([each["partialFingerprints"] for run in log["runs"] for each in run["results"]])
    assert prints[0] == prints[1] != [[], []]


def test_an_action_annotates_the_line(
    root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    write(root, {"naming.py": GOOD + BAD})
    for name in ("GITHUB_OUTPUT", "GITHUB_STEP_SUMMARY"):
        (tmp_path / name).touch()
        monkeypatch.setenv(name, str(tmp_path / name))
    monkeypatch.setenv("GITHUB_ACTIONS", "true")
    monkeypatch.setenv("GITHUB_WORKSPACE", str(root))
    monkeypatch.setenv("INPUT_BASE", "HEAD")
    assert run_action(NAME) == 1
    assert "::warning file=naming.py,line=9,title=ruff/S307::" in capfd.readouterr().out
    assert "security" in (tmp_path / "GITHUB_STEP_SUMMARY").read_text()


def test_links_large_and_binary_files_are_not_read(root: Path, tmp_path: Path) -> None:
    write(tmp_path, {"outside.py": BAD})
    (root / "link.py").symlink_to(tmp_path / "outside.py")
    (root / "folder").symlink_to(tmp_path)
    large = b"x = eval(y)\n" * 100_000
    write(root, {"large.py": large, "binary.py": b"\0eval(x)", "picture.png": b"\0", "tab\t.py": "eval(x)\n"})
    git(root, "add", ".")
    code, found = run(root)
    assert code == 0
    assert found["unchanged"] == []
    assert sorted(found["left_out"]) == ["binary.py", "large.py", "tab\t.py"]


@pytest.mark.parametrize(
    ("arguments", "code", "said"),
    [
        (["--base", "nowhere"], 2, "base nowhere: no such commit is in this checkout"),
        (["--paths", "nowhere"], 2, "there is no file in git that an analyser looks at"),
        (["--tools", "ruf"], 2, "ros: did you mean 'ruff'?"),
        (["--max-new", "erorr=0"], 2, "max-new: found 'erorr', expected one of all, error"),
        (["--suppressions", "nowhere.yml"], 2, "nowhere.yml: a file of suppressions was expected"),
        (["--timeout", "0.000001s"], 3, "took longer than"),
    ],
)
def test_errors_are_one_line(
    root: Path, capfd: pytest.CaptureFixture[str], arguments: list[str], code: int, said: str
) -> None:
    assert run(root, *arguments)[0] == code
    [line] = capfd.readouterr().err.splitlines()
    assert line.startswith("error: ")
    assert said in line


@pytest.mark.parametrize("others", [0, 5])
def test_a_file_that_kills_an_analyser_is_named_and_the_others_are_analysed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], others: int
) -> None:
    root = tmp_path / "robot"
    commit(root, {"b.py": f"x = {'-' * 100_000}1\n", **{f"{number}.py": GOOD + BAD for number in range(others)}})
    monkeypatch.chdir(root)
    assert main([NAME, "--tools", "ruff", "--output", str(tmp_path / "output")]) == 0
    found = json.loads((tmp_path / "output/results.json").read_text())["unchanged"]
    rules = [(each["path"], each["rule"]) for each in found if each["rule"] in ("ruff/S307", "ruff/not-analysed")]
    assert sorted(rules) == [
        *((f"{number}.py", "ruff/S307") for number in range(others)),
        ("b.py", "ruff/not-analysed"),
    ]
    assert main([NAME, "--tools", "ruff", "--max-total", "error=0"]) == 1
    capsys.readouterr()


def test_an_analyser_that_fails_on_every_file_is_an_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for count in (1, 3, 30):
        root = tmp_path / str(count)
        commit(root, {"ruff.toml": "lint.select = [", **{f"{number}.py": GOOD for number in range(count)}})
        monkeypatch.chdir(root)
        assert main([NAME, "--tools", "ruff"]) == 3
        assert "ruff failed with exit code 2" in capsys.readouterr().err


def test_paths_are_what_counts_in_a_large_repository(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Neither files outside of the paths count nor those that no analyser looks at; the settings are still read."""
    monkeypatch.setattr(copies, "MAX_FILES", 10)
    root = tmp_path / "robot"
    others = {f"large/{number}.py": BAD for number in range(11)}
    data = {f"mine/{number}.{suffix}": "1\n" for number in range(8) for suffix in ("txt", "json", "xyz")}
    commit(root, {"mine/a.py": GOOD + BAD, "ruff.toml": 'lint.select = ["S307"]', **others, **data})
    monkeypatch.chdir(root)
    assert main([NAME, "--tools", "ruff"]) == 2
    assert "more than 10 files are to be analysed: name folders (paths)" in capsys.readouterr().err
    assert main([NAME, "--tools", "ruff", "--paths", "large"]) == 2
    for chosen in (["--paths", "mine"], ["--paths", "mine/a.py"], ["--exclude", "large"]):
        assert main([NAME, "--tools", "ruff", *chosen, "--output", str(tmp_path / "output")]) == 0
        found = json.loads((tmp_path / "output/results.json").read_text())
        assert [(each["path"], each["rule"]) for each in found["unchanged"]] == [("mine/a.py", "ruff/S307")]


def test_the_base_of_a_large_repository_is_compared_with(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(copies, "MAX_FILES", 10)
    root = tmp_path / "robot"
    base = commit(root, {"mine/a.py": GOOD, **{f"large/{number}.py": GOOD for number in range(11)}})
    commit(root, {"mine/a.py": GOOD + BAD, "large/0.py": GOOD + BAD})
    monkeypatch.chdir(root)
    options = ["--tools", "ruff", "--base", base, "--output", str(tmp_path / "output")]
    assert main([NAME, *options, "--paths", "mine", "--max-new", "security=0"]) == 1
    found = json.loads((tmp_path / "output/results.json").read_text())
    assert [each["path"] for each in found["new"]] == ["mine/a.py"]
