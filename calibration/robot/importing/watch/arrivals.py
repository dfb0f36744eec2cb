"""Image files that arrive in the folders of cameras: polled, and each waited for until it is written whole."""

import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from glob import has_magic, iglob
from pathlib import Path

from calibration.base import InputError
from calibration.robot.importing.files.pictures import IMAGE_ENDINGS

FileState = tuple[int, int]
"""Size in bytes and time of the last change in ns."""
MAX_REFUSED = 100
"""Latest images that are not used, whose changes are looked for."""


@dataclass(frozen=True)
class Arrival:
    """Image file that is written."""

    sensor: str
    path: Path
    state: FileState


class Arrivals:
    """Images of cameras that arrive in folders, or match patterns of file names."""

    def __init__(self, places: Mapping[str, str]) -> None:
        """Watch the places of the cameras' images.

        Raises:
            InputError: a folder is not there.
        """
        for name, place in places.items():
            folder = Path(place).parent if has_magic(place) else Path(place)
            if not has_magic(str(folder)) and not folder.is_dir():
                raise InputError(f"{folder}: found no such folder, expected one in which images of '{name}' arrive")
        self.places = places
        self.faults: dict[str, str] = {}
        """Why a camera's folder could not be read at the last poll, by camera."""
        self._taken: dict[str, set[str]] = {name: set() for name in places}
        self._unfinished: dict[str, FileState] = {}
        self._refused: dict[str, Arrival] = {}

    def poll(self) -> list[Arrival]:
        """Return the images that are new and have not changed since the last poll, oldest first."""
        found, self.faults = list[Arrival](), {}
        for sensor, place in self.places.items():
            try:
                names = list(_image_files(place))
            except OSError as error:
                self.faults[sensor] = f"{place}: {error.strerror}"
                continue
            found += self._written(sensor, [name for name in names if name not in self._taken[sensor]])
        found += self._written_again()
        return sorted(found, key=lambda each: (each.state[1], each.path.name))

    def is_gone(self, arrival: Arrival) -> bool:
        """Whether an image has vanished since; then it arrives anew when it is back."""
        if gone := state_of(str(arrival.path)) is None:
            self._taken[arrival.sensor].discard(str(arrival.path))
        return gone

    def refuse(self, arrival: Arrival) -> None:
        """Take an image that is not used again, once it is changed: its writer may have paused."""
        self._refused[str(arrival.path)] = arrival
        if len(self._refused) > MAX_REFUSED:
            del self._refused[next(iter(self._refused))]

    def _written(self, sensor: str, names: list[str]) -> Iterator[Arrival]:
        for name in names:
            state = state_of(name)
            if state is not None and state[0] and self._unfinished.get(name) == state:
                self._taken[sensor].add(name)
                del self._unfinished[name]
                yield Arrival(sensor, Path(name), state)
            elif state is not None:
                self._unfinished[name] = state

    def _written_again(self) -> Iterator[Arrival]:
        changed = [name for name, each in self._refused.items() if state_of(name) not in (None, each.state)]
        for name in changed:
            yield from self._written(self._refused[name].sensor, [name])
            if name not in self._unfinished:
                del self._refused[name]


def _image_files(place: str) -> Iterator[str]:
    """Yield the names of the images in a folder or of a pattern.

    Raises:
        OSError: the folder cannot be read.
    """
    if has_magic(place) and not Path(place).exists():
        yield from (name for name in iglob(place) if name.lower().endswith(IMAGE_ENDINGS))  # noqa: PTH207 (of any folder)
        return
    with os.scandir(place) as entries:
        yield from (entry.path for entry in entries if entry.name.lower().endswith(IMAGE_ENDINGS))


def state_of(name: str) -> FileState | None:
    """Return the state of a regular file; None if it is gone, or something else."""
    path = Path(name)
    try:
        found = path.stat()
    except OSError:
        return None
    return (found.st_size, found.st_mtime_ns) if path.is_file() else None
