"""The entry point of the action: runs `calibration check` with its inputs from the environment."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))  # the package lies beside the actions, not installed

from calibration.__main__ import action_entry

action_entry("check")
