"""Workspaces without a defect, with names that are drawn by a seed."""

import random
import re
from pathlib import Path

from benchmarks.ros_defects import ros1, ros2, shared

_ROBOTS = ("rover", "atlas", "mule", "heron", "spider", "gecko", "otter", "badger", "kestrel", "lynx")
_MESSAGES = ("RobotState", "BaseReport", "DriveStatus", "PowerState", "Health")
_TOPICS = ("front", "left", "lower", "main", "rear", "top")
Files = dict[str, str]
"""Texts of files by path."""


class Workspace:
    """Files of a workspace of ROS 1 or 2, and the names that were drawn for it."""

    def __init__(self, version: int, seed: int) -> None:
        draw = random.Random(seed)
        message = draw.choice(_MESSAGES)
        self._names = {
            "ROBOT": draw.choice(_ROBOTS),
            "STATUS_SNAKE": re.sub(r"(?<!^)(?=[A-Z])", "_", message).lower(),
            "STATUS": message,
            "TOPIC": draw.choice(_TOPICS),
        }
        self._pattern = re.compile("|".join(self._names))  # the longer one of two that begin alike first
        templates = {**(ros1 if version == 1 else ros2).FILES, **shared.FILES}
        self.files: Files = {self.filled(path): self.filled(text) for path, text in templates.items()}

    def filled(self, text: str) -> str:
        """Return a text with the names that were drawn."""
        return self._pattern.sub(lambda match: self._names[match[0]], text)


def write(folder: Path, files: Files) -> None:
    """Write files below a folder."""
    for path, text in files.items():
        place = folder / path
        place.parent.mkdir(parents=True, exist_ok=True)
        place.write_text(text)
