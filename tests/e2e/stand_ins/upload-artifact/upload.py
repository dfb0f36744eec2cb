"""Copies a folder without what `!` patterns exclude, as upload-artifact does; refuses what GitHub refuses."""

import os
import re
import shutil
import sys
from fnmatch import fnmatch
from pathlib import Path

name = os.environ["NAME"]
if re.search(r'[":<>|*?\r\n\\/]', name):
    sys.exit(f"GitHub refuses the artifact name {name!r}")
if name == os.environ.get("LOSE"):
    sys.exit(0)
folder, *excluded = (line.strip() for line in os.environ["FILES"].splitlines() if line.strip())
for source in sorted(Path(folder).rglob("*")):
    if source.is_file() and not any(fnmatch(str(source), pattern.removeprefix("!")) for pattern in excluded):
        target = Path(os.environ["ARTIFACTS"], name, source.relative_to(folder))
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(source, target)
