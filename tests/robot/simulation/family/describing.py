"""A system in a few lines: its frames as a table, its sensors and patterns by where they are."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import yaml

from calibration.robot.simulation.system import System, read_system

OPTICAL = "0 0 0 -1.5707963267949 0 -1.5707963267949"
CAMERA = {"width": 1200, "height": 800, "hfov_deg": 60}
SIMULATED = {
    "rgb": CAMERA,
    "depth": {"width": 320, "height": 240, "hfov_deg": 60},
    "lidar3d": {"rings": 16, "vertical_deg": [-15, 15], "azimuths": 1875},
}
BOARD = {"dimension": {"x": 11, "y": 8}, "size": 0.06, "inner_size": 0.045, "border_size": 0.03}
SMALL = {"dimension": {"x": 7, "y": 7}, "size": 0.02, "inner_size": 0.015, "border_size": 0.02}
CHESSBOARD = {"pattern_type": "chessboard", "dimension": {"x": 10, "y": 7}, "size": 0.1, "border_size": 0.1}

UR10E = """
    base      shoulder   revolute 0 0 1 -6 6   0 0 0.1807
    shoulder  upper_arm  revolute 0 0 1 -6 6   0 0 0  1.5707963267949 0 0
    upper_arm forearm    revolute 0 0 1 -3 3   -0.6127 0 0
    forearm   wrist_1    revolute 0 0 1 -6 6   -0.57155 0 0.17415
    wrist_1   wrist_2    revolute 0 0 1 -6 6   0 -0.11985 0  1.5707963267949 0 0
    wrist_2   flange     revolute 0 0 1 -6 6   0 0.11655 0  -1.5707963267949 0 0
"""
"""An arm of six joints, from its base to its flange."""


@dataclass(frozen=True)
class Robot:
    """What makes a system. A place is "parent x y z roll pitch yaw", of which the last ones may be absent (0)."""

    name: str
    sensors: Mapping[str, tuple[str, str]]
    """By name: the modality, and the place of its link, the calibrated transform."""
    patterns: Mapping[str, tuple[str, Mapping[str, object]]]
    """By name: the place of one that is fixed, or the frame that a moved one is relative to; and what it looks like."""
    frames: str = ""
    """A line for each: parent, child, then the place; a joint has its kind, its axis and its limits before that."""
    joints: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    """By the name of its child: the parameters under calibration, and their errors."""
    anchored: str = ""
    additional: tuple[str, str] | None = None
    motion: Mapping[str, object] = field(default_factory=dict)

    def system(self, folder: Path) -> System:
        """The system, read from files in a folder."""
        config, simulation = self._config(), self._simulation()
        (folder / "robot.urdf").write_text(self._urdf())
        (folder / "config.yml").write_text(yaml.safe_dump(config, sort_keys=False))
        (folder / "simulation.yml").write_text(yaml.safe_dump(simulation, sort_keys=False))
        return read_system(folder)

    def _urdf(self) -> str:
        lines = [line.split() for line in self.frames.splitlines() if line.split()]
        for name, (modality, place) in self.sensors.items():
            parent, *numbers = place.split()
            optical = OPTICAL if modality != "lidar3d" else "0 0 0"
            lines += [[parent, f"{name}_link", *numbers], [f"{name}_link", f"{name}_frame", *optical.split()]]
        for name, (place, _) in self.patterns.items():
            parent, *numbers = place.split()
            lines += [[parent, f"{name}_link", *numbers]] if numbers else []
        links = dict.fromkeys(frame for line in lines for frame in line[:2])
        body = "".join(f'<link name="{link}"/>' for link in links) + "".join(_joint(*line) for line in lines)
        return f'<robot name="{self.name}">{body}</robot>'

    def _config(self) -> dict[str, object]:
        return {
            "world_link": "world",
            "anchored_sensor": self.anchored,
            "sensors": {
                name: {
                    "modality": modality,
                    "parent_link": place.split()[0],
                    "child_link": f"{name}_link",
                    "link": f"{name}_frame",
                    "topic_name": f"/{name}/data",
                }
                for name, (modality, place) in self.sensors.items()
            },
            "additional_tfs": {"more": dict(zip(("parent_link", "child_link"), self.additional, strict=True))}
            if self.additional
            else None,
            "joints": {f"to_{child}": {"params_to_calibrate": list(own)} for child, own in self.joints.items()} or None,
            "calibration_patterns": {
                name: {
                    "link": f"{name}_link",
                    "parent_link": place.split()[0],
                    "fixed": len(place.split()) > 1,
                    "pattern_type": "charuco",
                    "dictionary": "DICT_5X5_100",
                    **look,
                }
                for name, (place, look) in self.patterns.items()
            },
        }

    def _simulation(self) -> dict[str, object]:
        return {
            "sensors": {name: SIMULATED[modality] for name, (modality, _) in self.sensors.items()},
            "joints": {f"to_{child}": dict(own) for child, own in self.joints.items()},
            "motion": dict(self.motion),
        }


def _joint(parent: str, child: str, *words: str) -> str:
    moves = bool(words) and words[0] in ("revolute", "prismatic")
    kind, axis, limits, numbers = "fixed", "0 0 1", ("0", "0"), words
    if moves:
        kind, axis, limits, numbers = words[0], " ".join(words[1:4]), (words[4], words[5]), words[6:]
    place = [*numbers, *["0"] * (6 - len(numbers))]
    return (
        f'<joint name="to_{child}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{" ".join(place[:3])}" rpy="{" ".join(place[3:])}"/>'
        f'<axis xyz="{axis}"/><limit lower="{limits[0]}" upper="{limits[1]}"/></joint>'
    )
