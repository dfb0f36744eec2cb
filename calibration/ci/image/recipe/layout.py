"""Paths in the build context of a recipe, from which its Dockerfile copies.

They do not depend on the names of the user's files, which may need quoting.
"""

from pathlib import Path

from calibration.ci.image.specification import CopiedFile

DOCKERFILE_NAME = "Dockerfile"
ENTRYPOINT_NAME = "entrypoint.sh"


def requirements(number: int) -> str:
    """Return the path of a requirements file for pip."""
    return f"requirements/{number}.txt"


def copied(number: int) -> str:
    """Return the path of a file or folder to copy."""
    return f"files/{number}"


def source(number: int) -> str:
    """Return the path of a folder of the workspace's sources."""
    return f"sources/{number}"


def manifests(number: int) -> str:
    """Return the path of a copy of such a folder that contains only its package.xml files."""
    return f"manifests/{number}"


def folder_name(path: Path) -> str:
    """Return the name of a source folder in the workspace, which is its own."""
    return path.resolve().name or "source"


def target_of(file: CopiedFile) -> str:
    """Return the path of a file or folder in the image."""
    if file.target.endswith("/") and not file.source.is_dir():
        return file.target + file.source.name
    return file.target
