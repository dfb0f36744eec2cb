"""Merges the artifacts that match a pattern into one folder, as download-artifact does; none is no error there."""

import os
import shutil
from pathlib import Path

for artifact in sorted(Path(os.environ["ARTIFACTS"]).glob(os.environ["PATTERN"])):
    shutil.copytree(artifact, os.environ["FOLDER"], dirs_exist_ok=True)
