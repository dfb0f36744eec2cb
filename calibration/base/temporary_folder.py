"""Temporary folders that signals do not leave behind."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

from calibration.base.signals import held_back


@contextmanager
def temporary_folder(
    prefix: str = "calibration-", parent: Path | str | None = None, *, ignore_cleanup_errors: bool = False
) -> Iterator[Path]:
    """Yield a new folder (mode 0700), and remove it at the end of the block.

    Unlike `tempfile.TemporaryDirectory`, a signal interrupts neither its creation nor its removal.

    Args:
        prefix: beginning of its name.
        parent: folder that it is created in; that of the system for temporary files by default.
        ignore_cleanup_errors: leave what cannot be removed, such as files of another user.

    Raises:
        OSError: it cannot be created or removed.
    """
    folder: TemporaryDirectory[str] | None = None
    try:
        with held_back():
            folder = TemporaryDirectory(prefix=prefix, dir=parent, ignore_cleanup_errors=ignore_cleanup_errors)
        yield Path(folder.name)
    finally:
        if folder is not None:
            with held_back():
                folder.cleanup()
