"""Images of a recording's cameras, whatever they are in."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from calibration.errors import InputError
from calibration.importing.bag import ENDINGS as BAGS
from calibration.importing.bag import SECOND, open_bag
from calibration.importing.description import VIDEO_ENDINGS, ImportDescription, SensorDescription, is_video
from calibration.importing.image_views import read_image
from calibration.importing.messages import image_of
from calibration.importing.pictures import ENDINGS, find_pictures
from calibration.importing.samples import read_samples
from calibration.importing.videos import Video, decoded_frames, survey_videos
from calibration.labelling.detection import Image

MAX_CAMERAS = 16
"""Cameras that are looked at."""


class ImageSource(Protocol):
    """Images of one camera."""

    @property
    def place(self) -> str:
        """Topic, folder or file, for messages."""
        ...

    @property
    def times(self) -> Sequence[int] | None:
        """Time of every image, ns, in ascending order; None if they have none."""
        ...

    @property
    def count(self) -> int:
        """Number of images."""
        ...

    def images(self, wanted: Sequence[int]) -> Iterator[Image]:
        """Decode some images, by ascending index.

        Raises:
            InputError: one cannot be decoded.
        """
        ...


@dataclass(frozen=True)
class TopicImages:
    """Images of a topic of a bag."""

    files: Sequence[Path]
    place: str
    times: Sequence[int]
    """Recording times, ns."""

    @property
    def count(self) -> int:
        """Number of images."""
        return len(self.times)

    def images(self, wanted: Sequence[int]) -> Iterator[Image]:
        """Decode some images; see `ImageSource`."""
        with open_bag(self.files) as bag:
            for index in wanted:
                time = self.times[index]
                for message in bag.messages({self.place}, time, time + 1):
                    where = f"{bag.path}: {self.place} at {bag.stamp(message) / SECOND:.3f}"
                    yield image_of(bag.decode(message), where)
                    break


@dataclass(frozen=True)
class FileImages:
    """Images in files."""

    place: str
    files: Sequence[Path]
    times: None = None

    @property
    def count(self) -> int:
        """Number of images."""
        return len(self.files)

    def images(self, wanted: Sequence[int]) -> Iterator[Image]:
        """Decode some images; see `ImageSource`."""
        for index in wanted:
            yield read_image(self.files[index])


@dataclass(frozen=True)
class VideoImages:
    """Frames of a video."""

    video: Video

    @property
    def place(self) -> str:
        """Its file."""
        return str(self.video.path)

    @property
    def times(self) -> Sequence[int]:
        """Time of every frame, ns."""
        return self.video.stamps

    @property
    def count(self) -> int:
        """Number of frames."""
        return len(self.times)

    def images(self, wanted: Sequence[int]) -> Iterator[Image]:
        """Decode some frames; see `ImageSource`."""
        for frame in decoded_frames(self.video.path, wanted, wanted[-1] + 1):
            if frame.image is not None:
                yield frame.image


def described_images(described: ImportDescription) -> dict[str, ImageSource]:
    """Return the images of the cameras in folders and videos that import.yml names.

    Raises:
        InputError: a folder or a file is missing or wrong, or there are no images.
    """
    found: dict[str, ImageSource] = {}
    for sensor in [each for each in described.sensors if each.images][:MAX_CAMERAS]:
        if is_video(sensor.images or ""):
            found[sensor.name] = VideoImages(survey_videos([sensor])[sensor.name])
        else:
            pictures = find_pictures(sensor.name, sensor.images or "")
            found[sensor.name] = FileImages(pictures.place, pictures.files)
    if not found and described.samples is not None:
        images = [each.image for each in read_samples(described.samples, described.in_hand) if each.image]
        if gone := [each for each in images if not each.is_file()]:
            raise InputError(f"{gone[0]}: found no such file, expected an image of {described.samples.file}")
        if images:
            found[described.sensors[0].name] = FileImages(str(described.samples.file), images)
    if not found:
        place = described.samples.file if described.samples else "sensors"
        raise InputError(f"{place}: found no image, expected some to look at: poses alone tell nothing here")
    return found


def images_at(path: Path) -> dict[str, ImageSource]:
    """Return the images of a video, of a folder of images, or of each folder of images in a folder.

    Raises:
        InputError: it is none of them.
    """
    if is_video(path.name) and not path.is_dir():
        return {path.stem: VideoImages(survey_videos([SensorDescription(path.stem, images=str(path))])[path.stem])}
    if not path.is_dir():
        raise InputError(
            f"{path}: found no such folder or recording, expected a bag (.bag, .db3, .mcap, or a folder with "
            f"metadata.yaml), a folder of images, a video ({', '.join(VIDEO_ENDINGS)}) or an import.yml"
        )
    folders = [path, *sorted(each for each in path.iterdir() if each.is_dir())]
    with_images = [each for each in folders if any(file.suffix.lower() in ENDINGS for file in each.iterdir())]
    if not with_images:
        recordings = [file.name for file in sorted(path.iterdir()) if file.suffix.lower() in (*BAGS, *VIDEO_ENDINGS)]
        hint = f"; name a recording in it: {recordings[0]}" if recordings else ""
        raise InputError(
            f"{path}: found no image in it or in its folders, expected files in {', '.join(ENDINGS)}{hint}"
        )
    chosen = with_images[:1] if with_images[0] == path else with_images[:MAX_CAMERAS]
    return {each.name: FileImages(str(each), find_pictures(each.name, str(each)).files) for each in chosen}
