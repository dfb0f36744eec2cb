"""Findings of an earlier analysis by its SARIF: known by rule, file and content."""

import json
import os
from pathlib import Path

import pytest

from calibration.__main__ import main
from calibration.addons.analysis.report import read_earlier
from calibration.base import InputError
from tests.repositories import commit

BAD = "def calculated(text):\n    return eval(text)\n"


def analysed(folder: Path, *arguments: str) -> tuple[int, dict[str, list[dict[str, object]]]]:
    """Run the command in a folder, and return its exit code and results."""
    before = Path.cwd()
    os.chdir(folder)
    try:
        code = main(["static-analysis", "--tools", "ruff", "--output", "out", *arguments])
    finally:
        os.chdir(before)
    return code, json.loads((folder / "out" / "results.json").read_text())


def test_only_what_the_earlier_findings_lack_is_new(tmp_path: Path) -> None:
    root = tmp_path / "robot"
    commit(root, {"naming.py": BAD})
    assert analysed(root)[0] == 0  # nothing to compare with
    earlier = tmp_path / "earlier.sarif"
    (root / "out" / "findings.sarif").rename(earlier)
    commit(root, {"naming.py": "# a line more\n\n" + BAD})
    code, results = analysed(root, "--base-sarif", str(earlier))
    assert (code, len(results["new"]), len(results["unchanged"])) == (0, 0, 1)
    commit(root, {"naming.py": "# a line more\n\n" + BAD + "\n\ndef again(text):\n    return eval(text + text)\n"})
    code, results = analysed(root, "--base-sarif", str(earlier))
    assert (code, [each["line"] for each in results["new"]]) == (1, [8])
    commit(root, {"naming.py": "fine = 1\n"})
    code, results = analysed(root, "--base-sarif", str(earlier))
    assert (code, len(results["new"]), len(results["fixed"])) == (0, 0, 1)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "[]",
        '{"runs": 1}',
        '{"runs": [{"results": [{}]}]}',
        "[" * 100_000,
        (
            '{"runs": [{"results": [{"level": "x", "ruleId": "a/b", "message": {"text": ""}, "partialFingerprints": {},'
            ' "locations": [{"physicalLocation": {"artifactLocation": {"uri": ""}, "region": {"startLine": 1}}}]}]}]}'
        ),
    ],
)
def test_another_document_is_one_line(text: str, tmp_path: Path) -> None:
    path = tmp_path / "base.sarif"
    path.write_text(text)
    with pytest.raises(InputError, match=r"findings.sarif of an earlier static-analysis was expected"):
        read_earlier(path)


def test_base_and_base_sarif_exclude_each_other(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    commit(tmp_path, {"naming.py": BAD})
    before = Path.cwd()
    os.chdir(tmp_path)
    try:
        assert main(["static-analysis", "--base", "HEAD", "--base-sarif", "x"]) == 2
    finally:
        os.chdir(before)
    assert "base and base-sarif exclude each other" in capsys.readouterr().err
