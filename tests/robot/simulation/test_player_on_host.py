import ast
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from calibration.base import InputError
from calibration.robot.simulation.motion import PLAYER_FILE, Motion, check_motion, moving_joints, moving_model


def test_a_player_is_one_file_that_needs_neither_this_package_nor_a_new_python(tmp_path: Path) -> None:
    source = PLAYER_FILE.read_text()
    tree = ast.parse(source, feature_version=(3, 6))
    imported = {name.name for node in ast.walk(tree) if isinstance(node, ast.Import) for name in node.names}
    imported |= {node.module or "." for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}
    assert {name.partition(".")[0] for name in imported} <= set(sys.stdlib_module_names)
    alone = tmp_path / "player.py"
    alone.write_text(source)
    shown = subprocess.run([sys.executable, "-I", alone, "--help"], capture_output=True, text=True, check=True)
    assert "--pose-topic" in shown.stdout


def test_a_free_pattern_can_be_played() -> None:
    check_motion(moving_model(np.eye(4)[None]))


@pytest.mark.parametrize(
    ("motion", "message"),
    [
        (
            moving_joints({"elbow": np.zeros(2), "wrist": np.ones(2)}),
            r"a generated motion: moves joints \(elbow, wrist\)",
        ),
        (Motion(np.zeros((0, 3)), np.zeros((0, 4)), {}, "m.json"), "m.json: found no pose"),
    ],
)
def test_other_motions_cannot(motion: Motion, message: str) -> None:
    with pytest.raises(InputError, match=message):
        check_motion(motion)
