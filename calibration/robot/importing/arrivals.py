"""Images that arrive while a recording is made: as files in folders, or in a bag that is being written.

No library reads a file whose recorder has not closed it: an MCAP and a bag of ROS 1 have their index at the end, and a
database in use is not consistent. Recorders split bags, and every file but the last is closed.
"""

import os
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from glob import has_magic, iglob
from pathlib import Path

from calibration.base import InputError, write_atomically
from calibration.ci.execution.tasks import run_tasks
from calibration.engine.dataset.modalities import RGB
from calibration.robot.importing.bags.bag import BAG_ENDINGS, NS_PER_S, Bag, open_bag
from calibration.robot.importing.bags.recordings import detection_tasks, image_at, images_by_camera
from calibration.robot.importing.bags.stillness import BagImage, BagMoment, still_groups, still_moments
from calibration.robot.importing.bags.survey import SensorTopic, Survey, modality_of_topic
from calibration.robot.importing.bags.video_packets import ImageReader
from calibration.robot.importing.description import ImportDescription
from calibration.robot.importing.files.camera_files import KnownLens
from calibration.robot.importing.files.pictures import IMAGE_ENDINGS, order_by_number
from calibration.robot.importing.image_views import View, encoded
from calibration.robot.importing.importing import SurveyedBag, surveyed_bag
from calibration.robot.importing.recorded import Recorded

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


QUIET_SECONDS = 3.0
"""s: a bag's last file is finished when it has not changed for as long, or metadata.yaml is beside it."""
SEARCHED_EVERY = 0.25
"""s: from one image of a camera that is searched for patterns to the next; a standstill takes three."""


@dataclass(frozen=True, eq=False)
class _Extracted:
    """Moment of a bag whose images are files."""

    moment: BagMoment
    paths: Mapping[str, Path]
    """By camera."""


class FollowedBag:
    """Cameras of a bag that is being written; LiDARs are not looked at. As `Arrivals` of images in folders."""

    def __init__(self, described: ImportDescription, lenses: Mapping[str, KnownLens], folder: Path) -> None:
        """Follow the bag of a description.

        Args:
            described: the import; it has bags.
            lenses: known intrinsics.
            folder: for images of the bag.
        """
        self._described, self._lenses, self._folder = described, lenses, folder
        self._files = described.bags.files if described.bags else ()
        self.places = {str(file): str(file) for file in self._files}
        self.faults: dict[str, str] = {}
        """Why a file could not be read at the last poll."""
        self._opened: dict[Path, bool] = {}
        """By file that looked finished, whether it could be opened; then,"""
        self._states: dict[Path, FileState] = {}
        """in this state."""
        self._surveyed: SurveyedBag | None = None
        self._searched: dict[str, int] = {}
        """By camera, when the last image was recorded that was searched, ns."""
        self._images: dict[str, list[BagImage]] = {}
        self._standstills: set[tuple[str, int]] = set()
        """Cameras and first stamps of those that have arrived."""
        self._extracted: list[_Extracted] = []

    def poll(self) -> list[Arrival]:
        """Return the images of new standstills, if another file of the bag is finished."""
        self.faults = {}
        try:
            if not self._open_finished():
                return []
            files = [file for file in self._candidates() if self._opened.get(file)]
            with open_bag(files) as bag:
                return list(self._arrivals(bag))
        except InputError as error:
            self.faults = {"bag": str(error)}
            return []

    def is_gone(self, arrival: Arrival) -> bool:
        """Whether an image has vanished since: never."""
        return False

    def refuse(self, arrival: Arrival) -> None:
        """Nothing: an image of a bag does not change."""

    def recorded(self, used: Mapping[str, Mapping[Path, View]]) -> Recorded:
        """Return what was recorded at the moments of the used views, by camera and file.

        Raises:
            InputError: the frames of a moment are not in the bag.
        """
        if self._surveyed is None:
            raise InputError("no file of the bag is finished yet")
        moments = [
            {
                name: replace(each.moment.images[name], view=used[name][path])
                for name, path in each.paths.items()
                if path in used.get(name, {})
            }
            for each in self._extracted
        ]
        return self._surveyed.recorded([BagMoment(images) for images in moments if images])

    def _candidates(self) -> Iterator[Path]:
        """Yield all files of the bag, in order.

        Raises:
            InputError: there are none yet.
        """
        found = list[Path]()
        for place in self._files:
            inside = [each for each in place.iterdir() if each.suffix in BAG_ENDINGS] if place.is_dir() else [place]
            found += sorted((each for each in inside if state_of(str(each))), key=order_by_number)
        if not found:
            raise InputError(f"{self._files[0]}: found no file of a bag ({', '.join(BAG_ENDINGS)}) yet")
        yield from found

    def _open_finished(self) -> bool:
        """Open the files that look finished, and return whether another one is."""
        candidates, is_new = list(self._candidates()), False
        for file in candidates:
            state = state_of(str(file))
            if state is None or self._opened.get(file) or self._states.get(file) == state:
                continue
            is_last, is_closed = file == candidates[-1], (file.parent / "metadata.yaml").is_file()
            if is_last and not is_closed and time.time() - state[1] / NS_PER_S < QUIET_SECONDS:
                continue
            self._states[file] = state
            try:
                with open_bag([file]) as bag:
                    self._opened[file] = bag.span is not None
            except InputError as error:
                self._opened[file] = False
                self.faults = {str(file): str(error)}
            is_new = is_new or self._opened[file]
        return is_new

    def _arrivals(self, bag: Bag) -> Iterator[Arrival]:
        """Yield the images of the standstills that are new."""
        named = self._described.sensors
        cameras = tuple(s for s in named if s.topic not in bag.topics or modality_of_topic(bag, s) == RGB)
        if named and not cameras:
            raise InputError(
                f"{bag.path}: found no camera among the sensors, expected one that sees where the pattern is"
            )
        described = replace(self._described, sensors=cameras)
        self._surveyed = surveyed = surveyed_bag(bag, described, self._lenses)
        self._search(bag, surveyed)
        reader = ImageReader(bag, surveyed.found.key_frames)
        start = min(own[0].stamp for own in self._images.values() if own)
        groups = {name: still_groups(own) for name, own in self._images.items()}
        for moment in still_moments(self._images):
            of = {
                (name, group.start)
                for name, image in moment.images.items()
                for group in groups[name]
                if group.start <= image.stamp <= group.end
            }
            if of & self._standstills:
                continue
            paths = {}
            for name, image in moment.images.items():
                path = self._folder / name.replace("/", "_") / f"{(image.stamp - start) / NS_PER_S:.2f}s.png"
                path.parent.mkdir(exist_ok=True)
                write_atomically(
                    path, encoded(image_at(bag, surveyed.found.cameras[name].topic, image.recorded, reader))
                )
                paths[name] = path
                yield Arrival(name, path, (0, image.stamp))
            self._standstills |= of
            self._extracted.append(_Extracted(moment, paths))

    def _search(self, bag: Bag, surveyed: SurveyedBag) -> None:
        """Search the images for patterns that were not yet, a few each second."""
        found = surveyed.found
        thinned = {name: replace(each, stamps=self._to_search(name, each)) for name, each in found.cameras.items()}
        some = Survey({name: each for name, each in thinned.items() if each.stamps}, found.log, found.key_frames)
        if not some.cameras:
            return
        seen = list(run_tasks(detection_tasks(bag, some, surveyed.mounted.detectors), workers=1).values())
        for name, own in images_by_camera({name: each.stamps for name, each in some.cameras.items()}, seen).items():
            self._images.setdefault(name, []).extend(own)
            self._searched[name] = max(some.cameras[name].stamps)

    def _to_search(self, name: str, camera: SensorTopic) -> dict[int, int]:
        last, chosen = self._searched.get(name, -1), dict[int, int]()
        for recorded, stamp in camera.stamps.items():
            if last < 0 or recorded - last >= SEARCHED_EVERY * NS_PER_S:
                chosen[recorded], last = stamp, recorded
        return chosen
