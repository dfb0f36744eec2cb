"""Copies the artifacts that match a pattern, as download-artifact does; none is no error there.

Each goes to a folder of its name, unless they are merged, or there is only one.
"""

import os
import shutil
from pathlib import Path

folder = Path(os.environ["FOLDER"])
artifacts = sorted(Path(os.environ["ARTIFACTS"]).glob(os.environ["PATTERN"]))
merged = os.environ["MERGED"] == "true" or len(artifacts) == 1
for artifact in artifacts:
    shutil.copytree(artifact, folder if merged else folder / artifact.name, dirs_exist_ok=True)
