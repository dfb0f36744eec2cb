"""Every kind of planted defect at its line, and no finding in packages without one."""

from pathlib import Path

import pytest

from benchmarks.ros_defects import found_in
from benchmarks.ros_defects.kinds import KINDS, Kind, planted
from benchmarks.ros_defects.workspace import Workspace
from calibration.addons.analysis.ros import RULES

PAGE = Path(__file__).parents[4] / "docs" / "static-analysis.md"


@pytest.mark.parametrize("version", [1, 2])
@pytest.mark.parametrize("seed", range(3))
def test_packages_without_a_defect_have_no_finding(version: int, seed: int) -> None:
    assert found_in(Workspace(version, seed).files) == []


@pytest.mark.thorough(but_first=12)
@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.name)
def test_a_planted_defect_is_found_at_its_line(kind: Kind) -> None:
    for seed in range(len(kind.edits)):
        defect = planted(kind, seed)
        found = [(each.path, each.line, each.rule) for each in found_in(defect.files)]
        assert (*defect.place, f"ros/{kind.rule}") in found


def test_every_rule_has_a_planted_defect_and_is_documented() -> None:
    assert {kind.rule for kind in KINDS} == set(RULES)
    rows = {line.split("`")[1]: line for line in PAGE.read_text().splitlines() if line.startswith("| `ros/")}
    assert list(rows) == [f"ros/{name}" for name in RULES]
    for name, rule in RULES.items():
        assert rows[f"ros/{name}"] == f"| `ros/{name}` | {rule.severity} | {rule.meaning} |"
