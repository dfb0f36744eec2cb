"""Hand-eye samples of a simulated arm, in the file formats of several tools."""

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from calibration.base.arrays import Array
from calibration.engine.geometry import rotations
from calibration.engine.geometry.transforms import inverse, retract, transform

MM, DEG = 1.0, 0.1
"""Standard deviations of the poses of the pattern, each axis."""
X = transform(rotations.exp([0.1, -0.2, 0.3]), [0.03, -0.05, 0.08])
"""``T_tool_camera``, or ``T_tool_pattern`` if the camera is fixed."""
Y = transform(rotations.exp([0.3, 2.0, 0.2]), [0.8, 0.1, 0.1])
"""``T_base_pattern``, or ``T_base_camera``."""


@dataclass(frozen=True, eq=False)
class Samples:
    """Pairs of poses."""

    in_hand: bool
    """Whether the arm carries the camera."""
    arm: Array
    """(N, 4, 4): ``T_base_tool``."""
    seen: Array
    """(N, 4, 4): ``T_camera_pattern``, with noise."""


def simulated(in_hand: bool, seed: int = 1, count: int = 20, noise: float = 1.0) -> Samples:
    """Samples of an arm that turns about all axes; noise in multiples of what is usual."""
    random = np.random.default_rng(seed)
    turns, places = (
        random.uniform(-0.6, 0.6, (count, 3)),
        random.uniform(-0.3, 0.3, (count, 3)) + np.array([0.5, 0, 0.5]),
    )
    arm = transform(rotations.exp(turns), places + np.array([0.5, 0.0, 0.5]))
    seen = inverse(arm @ X) @ Y if in_hand else inverse(Y) @ arm @ X
    errors = random.normal(size=(count, 6)) * ([1e-3 * MM] * 3 + [np.radians(DEG)] * 3)
    return Samples(in_hand, arm, retract(seen, noise * errors))


def message(T: Array) -> dict[str, Any]:
    """A geometry_msgs/Transform."""
    quaternion = rotations.to_quaternion(T[:3, :3]).tolist()
    return {
        "translation": dict(zip("xyz", T[:3, 3].tolist(), strict=True)),
        "rotation": dict(zip("xyzw", quaternion, strict=True)),
    }


def easy_handeye(samples: Samples, path: Path) -> None:
    """Write the format of easy_handeye2: the inverse of the arm's poses if the camera is fixed."""
    arm = samples.arm if samples.in_hand else inverse(samples.arm)
    pairs = [{"robot": message(a), "tracking": message(b)} for a, b in zip(arm, samples.seen, strict=True)]
    path.write_text(yaml.safe_dump({"parameters": {"name": "", "calibration_type": ""}, "samples": pairs}))


def moveit(samples: Samples, path: Path) -> None:
    """As MoveIt: matrices."""
    pairs = zip(samples.arm, samples.seen, strict=True)
    path.write_text(
        yaml.safe_dump(
            [{"effector_wrt_world": a.ravel().tolist(), "object_wrt_sensor": b.ravel().tolist()} for a, b in pairs]
        )
    )


def table(samples: Samples, path: Path) -> None:
    """A CSV file."""
    names = ("x", "y", "z", "qx", "qy", "qz", "qw")
    lines = [",".join((*names, *(f"pattern_{name}" for name in names)))]
    for pair in zip(samples.arm, samples.seen, strict=True):
        numbers = [[*T[:3, 3].tolist(), *rotations.to_quaternion(T[:3, :3]).tolist()] for T in pair]
        lines.append(",".join(map(repr, [*numbers[0], *numbers[1]])))
    path.write_text("\n".join(lines))


WRITERS: Mapping[str, Callable[[Samples, Path], None]] = {
    "robot.samples": easy_handeye,
    "moveit.yaml": moveit,
    "pairs.csv": table,
}
"""By a file's name."""


def write_import(folder: Path, samples: Samples, file: str) -> Path:
    """Write samples and their import.yml into a folder."""
    WRITERS[file](samples, folder / file)
    sensor, pattern = ("tool0", "base_link") if samples.in_hand else ("base_link", "tool0")
    description = {
        "sensors": {"camera": {"parent": sensor}},
        "patterns": {"board": {"parent": pattern}},
        "samples": {"file": file},
    }
    (folder / "import.yml").write_text(json.dumps(description))
    return folder / "import.yml"
