"""Robot descriptions that are wrong, each at its line, and one that is right."""

from pathlib import Path

import pytest

from .test_analysers import look

GOOD = """<robot name="r">
  <link name="base"/>
  <link name="arm">
    <inertial><mass value="2"/>
      <inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial>
  </link>
  <joint name="turn" type="revolute">
    <parent link="base"/>
    <child link="arm"/>
    <limit lower="-1" upper="1" effort="1" velocity="1"/>
  </joint>
</robot>
"""


def rules(folder: Path, text: str) -> list[tuple[str, int]]:
    return [(each.rule.removeprefix("urdf/"), each.line) for each in look(folder, "urdf", {"r.urdf": text})]


def test_a_right_one_has_no_finding(tmp_path: Path) -> None:
    assert rules(tmp_path, GOOD) == []


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ('<parent link="base"/>', '<parent link="bas"/>', [("no-such-link", 8)]),
        ('<child link="arm"/>', "", [("no-such-link", 7), ("no-tree", 1)]),
        ('<link name="base"/>', '<link name="base"/><link name="base"/>', [("name-twice", 2)]),
        ('<link name="base"/>', '<link name="base"/><link name="loose"/>', [("no-tree", 1)]),
        ('<limit lower="-1" upper="1" effort="1" velocity="1"/>', "", [("no-limits", 7)]),
        ('lower="-1"', 'lower="2"', [("limits", 10)]),
        ('lower="-1"', 'lower="1"', [("limits", 10)]),
        ('lower="-1"', 'lower="nan"', [("limits", 10)]),
        ('<mass value="2"/>', '<mass value="0"/>', [("mass", 4)]),
        ('ixx="0.1"', 'ixx="-0.1"', [("inertia", 5)]),
        ('ixy="0"', 'ixy="0.2"', [("inertia", 5)]),
        ('iyz="0"', 'iyz="0.2"', [("inertia", 5)]),
        ('izz="0.1"', 'izz="thin"', [("inertia", 5)]),
        (
            "</robot>",
            '<joint name="back" type="fixed"><parent link="arm"/><child link="base"/></joint></robot>',
            [("no-tree", 1)],
        ),
        (
            "</robot>",
            '<joint name="more" type="fixed"><parent link="base"/><child link="arm"/></joint></robot>',
            [("two-parents", 12)],
        ),
    ],
)
def test_a_wrong_one_has_one_at_its_line(tmp_path: Path, old: str, new: str, expected: list[tuple[str, int]]) -> None:
    assert old in GOOD
    assert rules(tmp_path, GOOD.replace(old, new, 1)) == expected


def test_the_nearest_link_is_named(tmp_path: Path) -> None:
    [finding] = look(tmp_path, "urdf", {"r.urdf": GOOD.replace('parent link="base"', 'parent link="bas"')})
    assert "did you mean 'base'?" in finding.message


@pytest.mark.parametrize("text", ["", "<robot>", "<a/>", '<!DOCTYPE a [<!ENTITY b "c">]><robot>&b;</robot>'])
def test_what_is_no_urdf_is_not_judged(tmp_path: Path, text: str) -> None:
    assert rules(tmp_path, text) == []
