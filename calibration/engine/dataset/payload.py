"""Data files of a dataset that its collections name: images and point clouds."""

import os
from pathlib import Path

from calibration.base.errors import InputError
from calibration.engine.dataset.document import Node, shown


class MissingFileError(InputError):
    """A data file is missing; the message is its name."""


def locate_existing(name: Node) -> str:
    """Return the path of a ``data_file``, like `locate`, and check that it exists.

    Raises:
        MissingFileError: there is no such file.
        InputError: as `locate`.
    """
    path = locate(name)
    try:
        os.stat(path)  # noqa: PTH116 (called for every cloud)
    except FileNotFoundError:
        raise MissingFileError(name.text()) from None
    except (OSError, ValueError):  # the reader reports why it cannot be opened
        pass
    return path


def locate(name: Node) -> str:
    """Return the path of a ``data_file``, which must be in the dataset's folder, with symbolic links resolved.

    Raises:
        InputError: the name is not a relative path, or leaves the folder.
    """
    file, folder = name.name(), name.file.parent
    try:
        path = os.path.join(folder, file)  # noqa: PTH118 (called for every cloud)
        if "/" not in file and file not in (".", "..") and not os.path.islink(path):  # noqa: PTH114
            return path
        if not os.path.isabs(file) and ".." not in Path(file).parts:  # noqa: PTH117
            real = Path(path).resolve()
            if real.is_relative_to(folder.resolve()):
                return str(real)
    except (ValueError, OSError, RuntimeError):  # a NUL or a lone surrogate; too long; a loop of links
        pass
    raise name.fault(f"found {shown(file)}, expected a file in the dataset's folder")
