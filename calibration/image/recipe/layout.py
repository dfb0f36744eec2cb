"""Where things lie in the build context that is made for a recipe; the Dockerfile copies them from there.

The names are ours and plain, whatever the user's files are called.
"""

from pathlib import Path

from calibration.image.specification import CopiedFile

DOCKERFILE = "Dockerfile"
ENTRYPOINT = "entrypoint.sh"


def requirements(number: int) -> str:
    """A file of requirements for pip."""
    return f"requirements/{number}.txt"


def copied(number: int) -> str:
    """A file or folder to copy."""
    return f"files/{number}"


def source(number: int) -> str:
    """A folder of the workspace's sources."""
    return f"sources/{number}"


def manifests(number: int) -> str:
    """The package.xml files of such a folder, in the same folders and nothing else."""
    return f"manifests/{number}"


def folder_name(path: Path) -> str:
    """The name that a folder of sources has in the workspace: its own."""
    return path.resolve().name or "source"


def target_of(file: CopiedFile) -> str:
    """The path that a file or folder gets in the image."""
    if file.target.endswith("/") and not file.source.is_dir():
        return file.target + file.source.name
    return file.target
