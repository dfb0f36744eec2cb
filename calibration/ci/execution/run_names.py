"""Unique names: of runs, and of what a run creates."""

import os


def new_run() -> str:
    """Return a unique name for a run."""
    return os.urandom(4).hex()
