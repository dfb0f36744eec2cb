"""Players: what moves the pattern of the team's own simulation, and has the robot save what it sees.

A player is one file that runs in the team's image, without this package: `player_file`. `check_motion` says
whether it can play a motion.
"""

from calibration.simulation.players.host import check_motion, player_file

__all__ = ["check_motion", "player_file"]
