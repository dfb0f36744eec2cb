"""Folder of a dataset, which is replaced completely or not at all."""

import filecmp
import json
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

from calibration.base.errors import InfrastructureError, InputError
from calibration.base.files import link_or_copy, temporary_folder, write_atomically
from calibration.engine.dataset import truth
from calibration.engine.dataset.reading import FILE_NAME
from calibration.engine.dataset.writing import write_document
from calibration.robot.simulation.collection.document import dataset_document, truth_document
from calibration.robot.simulation.collection.record import Record
from calibration.robot.simulation.motion.sequence import motion_document
from calibration.robot.simulation.placement import Play
from calibration.robot.simulation.system import MOTION_FILE


def write_dataset(new: Path, play: Play, kept: Sequence[Record], files: Path) -> None:
    """Write a collected dataset into a new folder: JSON, truth, motion, and the system's description.

    So it is also the folder of a system, from which the dataset can be collected again.

    Args:
        new: the folder, which must exist.
        play: the played motion.
        kept: the collections, at least one.
        files: the folder with the images and clouds that their records name; they are linked or copied.

    Raises:
        InfrastructureError: something cannot be written.
    """
    for name, content in play.system.sources.items():
        write_atomically(new / name, content)
    for record in kept:
        for message in record.collection["data"].values():
            name = message.get("data_file")  # the ranges of a 2D LiDAR are in the dataset itself
            if name and (files / name).exists():
                link_or_copy(files / name, new / name)
    write_document(motion_document(play.motion), new / MOTION_FILE)
    write_document(truth_document(play, kept), new / truth.FILE_NAME)
    write_document(dataset_document(play.system, kept), new / FILE_NAME)


def refuse_existing(folder: Path, overwrite: bool) -> None:
    """Check that a dataset may be written into a folder, which need not exist.

    Raises:
        InputError: it has a dataset and must not be overwritten, or is not a folder.
    """
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{folder}: is a file, expected a folder for the dataset")
    if not overwrite and (folder / FILE_NAME).exists():
        raise InputError(f"{folder / FILE_NAME}: exists already; --overwrite replaces the dataset")


@contextmanager
def replacing_dataset(folder: Path, overwrite: bool) -> Iterator[Path]:
    """A temporary folder for a new dataset, whose files move to ``folder`` when all are written.

    The dataset's JSON is moved last, and an old one is removed first, with the files that it names: so
    a reader finds the old dataset, none, or the new one at any time. After any failure, an
    interruption too, the folder is unchanged. The temporary one is inside it, as it may be a volume of
    its own.
    """
    refuse_existing(folder, overwrite)
    created = _make_with_parents(folder)
    try:
        with temporary_folder(prefix=".collecting-", parent=folder) as temporary:
            new, old = temporary / "new", temporary / "old"
            new.mkdir()
            old.mkdir()
            yield new
            if not overwrite:
                _refuse_other_files(folder, new)
            _exchange_datasets(folder, new, old)
    except OSError as error:
        raise InfrastructureError(f"{folder}: cannot be written: {error.strerror or error}") from error
    finally:
        for path in created:
            with suppress(OSError):  # not empty: something was written meanwhile
                path.rmdir()


def _make_with_parents(folder: Path) -> list[Path]:
    """Make a folder and its parents; return the new ones, innermost first."""
    missing = [path for path in (folder, *folder.parents) if not path.exists()]
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InfrastructureError(f"{folder}: cannot be made: {error.strerror or error}") from error
    return missing


def _refuse_other_files(folder: Path, new: Path) -> None:
    """Refuse to replace files that are not part of a dataset, such as a recorded motion."""
    for path in sorted(new.iterdir()):
        old = folder / path.name
        if old.exists() and not (old.is_file() and filecmp.cmp(path, old, shallow=False)):
            raise InputError(f"{old}: exists already and differs; --overwrite replaces it")


def _exchange_datasets(folder: Path, new: Path, old: Path) -> None:
    """Exchange the old dataset for the new one; all or nothing."""
    arriving = sorted((path.name for path in new.iterdir()), key=lambda name: name == FILE_NAME)
    leaving = [FILE_NAME, *sorted({*arriving, *_data_files_of(folder / FILE_NAME)} - {FILE_NAME})]
    try:
        for name in leaving:
            if (folder / name).exists():
                (folder / name).rename(old / name)
        for name in arriving:
            (new / name).rename(folder / name)
    except BaseException:
        for name in arriving:
            if not (new / name).exists():
                (folder / name).unlink(missing_ok=True)
        for path in old.iterdir():
            path.rename(folder / path.name)
        raise


def _data_files_of(dataset: Path) -> set[str]:
    """Return the data files that a dataset's collections name; empty if it cannot be read."""
    try:
        collections = json.loads(dataset.read_bytes())["collections"].values()
        named = {data["data_file"] for c in collections for data in c["data"].values() if "data_file" in data}
    except (OSError, ValueError, LookupError, TypeError, AttributeError, RecursionError):
        return set()
    return {name for name in named if isinstance(name, str) and Path(name).name == name}
