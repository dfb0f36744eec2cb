"""Prints the notes of a release, its section of CHANGELOG.md; refuses a tag that is not the version of the package.

python3 -I .github/release_notes.py v1.2.3
"""

import re
import sys
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]


def notes(tag: str, root: Path = ROOT) -> str:
    """Return the section of the changelog; end the program in one line where something does not fit the tag."""
    version = tag.removeprefix("v")
    if not re.fullmatch(r"v\d+\.\d+\.\d+", tag):
        sys.exit(f"{tag}: a tag such as v1.2.3 was expected")
    declared = tomllib.loads((root / "pyproject.toml").read_text())["project"]["version"]
    code = re.findall(r'^__version__ = "(.*)"$', (root / "calibration/__init__.py").read_text(), re.MULTILINE)
    for where, found in (("pyproject.toml", [declared]), ("calibration/__init__.py", code)):
        if found != [version]:
            sys.exit(f"{where}: found version {', '.join(found) or 'none'}, {version} was expected by the tag {tag}")
    sections = re.split(r"^## \[(.+?)\].*$", (root / "CHANGELOG.md").read_text(), flags=re.MULTILINE)
    text = dict(zip(sections[1::2], sections[2::2], strict=True)).get(version, "").strip()
    if not text:
        sys.exit(f"CHANGELOG.md: has no section [{version}] with text: write what has changed, then tag again")
    return text


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit("usage: release_notes.py TAG")
    print(notes(sys.argv[1]))
