"""`make lint` finds what is wrong, and says where."""

from pathlib import Path

import pytest

from tests.e2e.conftest import tool
from tests.repositories import needs_git

from . import documents, shell, yaml_lines


@pytest.fixture
def project(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder in the place of this project."""
    for module in (documents, shell):
        monkeypatch.setattr(module, "PROJECT", tmp_path)
    return tmp_path


def test_entries_know_their_lines_and_come_once(tmp_path: Path) -> None:
    file = tmp_path / "workflow.yml"
    file.write_text(
        "a: &steps\n  - run: make\n  - name: x\n    run: |\n      one\n      two\n"
        "b: *steps\nrun: {description: no script}\n"
    )
    assert sorted(yaml_lines.entries(file, "run")) == [(2, "make"), (5, "one\ntwo\n")]


def test_a_fault_in_the_shell_of_a_workflow_is_found_at_its_line(project: Path) -> None:
    tool("shellcheck")
    file = project / "workflow.yml"
    file.write_text("steps:\n  - run: |\n      set -eu\n      rm -r $folder\n")
    [(line, text)] = yaml_lines.entries(file, "run")
    found = list(shell.check(text, file, line, ("--shell", "bash")))
    assert any(each.startswith("workflow.yml:4: SC2086 ") for each in found)


@pytest.mark.parametrize(
    ("name", "text", "expected"),
    [
        ("a.sh", "", True),
        ("run", "#!/usr/bin/env bash\n", True),
        ("run", "#!/bin/sh\n", True),
        ("run", "#!/bin/bash -e\n", True),
        ("run", "#!/usr/bin/env python3\n", False),
        ("run", "#!\n", False),
        ("run", "", False),
    ],
)
def test_shell_files_are_known_by_name_or_first_line(tmp_path: Path, name: str, text: str, expected: bool) -> None:
    (tmp_path / name).write_text(text)
    assert shell.is_shell(tmp_path / name) is expected


def test_the_shell_files_of_the_project() -> None:
    needs_git()
    found = {str(path.relative_to(shell.PROJECT)) for path in shell.shell_files()}
    assert {"actions/bootstrap.sh", ".ci/run"} <= found


def test_a_fault_in_an_example_of_the_readme_is_found_at_its_line(
    project: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    tool("check-jsonschema")
    readme = project / "README.md"
    readme.write_text(
        "# Example\n\n```yaml\nsystems:\n  a: {dataset: a, ruels: []}\n```\n\n"
        "```yaml\nsystems: {a: {dataset: a}}\n```\n"
        "```yaml\nwhat: is this\n```\n```yaml\na: [\n```\n"
    )
    monkeypatch.setattr(documents, "READMES", [readme])
    monkeypatch.setattr(documents, "DOCUMENTS", {"calibration.yml": []})
    unknown, broken, fault = documents.findings()
    assert unknown.startswith("README.md:12: ")
    assert broken.startswith("README.md:15: ")
    assert "README.md, line 4.json" in fault
    assert "ruels" in fault
    assert "line 9" not in fault


def test_a_fault_in_a_workflow_is_found(project: Path) -> None:
    tool("check-jsonschema")
    file = project / "workflow.yml"
    file.write_text("on: push\njobs: {a: {runs-on: x, stepps: []}}\n")
    [fault] = documents.check(documents.WORKFLOW, [file])
    assert "stepps" in fault
    assert "workflow.yml" in fault


def test_there_is_something_of_every_kind() -> None:
    assert all(documents.DOCUMENTS.values())
