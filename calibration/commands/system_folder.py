"""The folder of a system that a command names."""

from pathlib import Path

from calibration.errors import InputError

SYSTEMS = Path("datasets")
"""Where the name of a system is looked up, from the working directory."""


def find_system(system: str) -> Path | None:
    """The folder of a system, by its name in `SYSTEMS` or by its path; None where there is none."""
    return next((folder for folder in (SYSTEMS / system, Path(system)) if system and folder.is_dir()), None)


def system_folder(system: str) -> Path:
    """The folder of a system, as `find_system` finds it.

    Raises:
        InputError: there is none.
    """
    if (folder := find_system(system)) is not None:
        return folder
    known = sorted(folder.parent.name for folder in SYSTEMS.glob("*/simulation.yml"))
    names = f"one of {', '.join(known)} or a folder" if known else "a folder"
    raise InputError(f"system: found '{system}', expected {names}")
