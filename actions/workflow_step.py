"""The entry point of the reusable workflow's steps that are no actions: runs the command that bootstrap.py names."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # the package lies beside the actions, not installed

from calibration.__main__ import action_entry

action_entry(sys.argv[1])
