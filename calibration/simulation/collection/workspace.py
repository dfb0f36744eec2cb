"""Where an unfinished collection lies: its records and files, until all of them become a dataset at once.

The folder ``.collecting`` inside the output, which may be a volume of its own. It outlives an
interruption, and the same collection goes on from it.
"""

import fcntl
import hashlib
import json
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path

from calibration.errors import InputError, WorldError
from calibration.files import write_atomically
from calibration.simulation.collection.record import Record

FOLDER = ".collecting"
_IDENTITY = "identity.txt"
_LOCK = "lock"
_RECORDS = "*.record.json"


def identity(*parts: bytes) -> str:
    """A fingerprint of what a collection depends on."""
    digest = hashlib.sha256()
    for part in parts:
        digest.update(len(part).to_bytes(8, "little"))
        digest.update(part)
    return digest.hexdigest()


class Workspace:
    """The folder of one unfinished collection, locked while it is used."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def records(self) -> dict[int, Record]:
        """The poses that are done, by their number. One that cannot be read is not."""
        found = {}
        for path in self.folder.glob(_RECORDS):
            with suppress(OSError, ValueError, TypeError, KeyError, AttributeError):
                record = Record.from_json(path.read_bytes())
                found[record.number] = record
        return found

    def add(self, record: Record, files: Mapping[str, bytes]) -> None:
        """Write the files of a pose, then its record: where that is, the pose is done.

        Raises:
            WorldError: a file cannot be written.
        """
        for name, content in files.items():
            write_atomically(self.folder / name, content)
        write_atomically(self.folder / f"{record.number:06d}.record.json", record.to_json())


@contextmanager
def workspace(output: Path, identity: str) -> Iterator[Workspace]:
    """The workspace inside an output folder, whose content is kept only if it is of the same identity.

    When something goes wrong in the block it stays behind with what is done, if anything is; else it is
    removed, and so are folders that were made for it.

    Raises:
        InputError: another collection into this folder is running.
        WorldError: the folder cannot be made or written.
    """
    folder = output / FOLDER
    made = [path for path in (output, *output.parents) if not path.exists()]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with (folder / _LOCK).open("w") as lock:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                raise InputError(f"{output}: another collection into this folder is running; wait or stop it") from None
            if not _is_of(folder, identity):
                _clear(folder)
                write_atomically(folder / _IDENTITY, json.dumps(identity))
            unfinished = False
            try:
                yield Workspace(folder)
            except BaseException:
                unfinished = any(folder.glob(_RECORDS))
                raise
            finally:
                if not unfinished:
                    shutil.rmtree(folder, ignore_errors=True)
    except OSError as error:
        raise WorldError(f"{output}: cannot be written: {error.strerror or error}") from error
    finally:
        for path in made:
            with suppress(OSError):  # it is not empty, or was not made
                path.rmdir()


def _is_of(folder: Path, identity: str) -> bool:
    try:
        return bool(json.loads((folder / _IDENTITY).read_bytes()) == identity)
    except (OSError, ValueError):
        return False


def _clear(folder: Path) -> None:
    for path in folder.iterdir():
        if path.name == _LOCK:
            continue
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path)
        else:
            path.unlink()
