"""Players: move the pattern in a team's own simulation, and request the robot to save each pose.

A player is one file that runs in the team's image, without this package: `player_file`. `check_motion` checks
that it can play a motion.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from calibration.base import InputError

if TYPE_CHECKING:
    from calibration.robot.simulation.motion.sequence import Motion

PLAYER_FILES: Mapping[str, str] = {"ros1": "ros1.py"}
"""File of each player, by name."""


def player_file(name: str = "ros1") -> Path:
    """Return the path of a player, a single file without dependencies.

    Raises:
        InputError: there is no such player.
    """
    if name not in PLAYER_FILES:
        raise InputError(f"player: found '{name}', expected {' or '.join(PLAYER_FILES)}")
    return Path(__file__).parent / PLAYER_FILES[name]


def check_motion(motion: "Motion") -> None:
    """Check that a player can play a motion, which it reads from the file of `motion_document`.

    Raises:
        InputError: it moves joints, or nothing: a player only moves a free pattern.
    """
    if motion.joints:
        joints = ", ".join(list(motion.joints)[:3])
        raise InputError(
            f"{motion.source}: moves joints ({joints}), but our player moves a free pattern only; "
            "leave out player and let one of the containers play"
        )
    if not len(motion):
        raise InputError(f"{motion.source}: found no pose, expected one at least")
