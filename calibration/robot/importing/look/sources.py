"""Images of a recording's cameras, whatever they are in."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from calibration.base import InputError
from calibration.robot.importing.bags.bag import BAG_ENDINGS, open_bag
from calibration.robot.importing.bags.video_packets import ImageReader
from calibration.robot.importing.description import VIDEO_ENDINGS, ImportDescription, SensorDescription, is_video
from calibration.robot.importing.files.pictures import IMAGE_ENDINGS, find_pictures
from calibration.robot.importing.files.samples import read_samples
from calibration.robot.importing.patterns.image_views import read_image
from calibration.robot.importing.videos import decoded_frames, survey_videos
from calibration.robot.labelling.detection import Image

MAX_CAMERAS = 16
"""Cameras that are looked at."""


@dataclass(frozen=True)
class ImageSource:
    """Images of one camera."""

    place: str
    """Topic, folder or file, for messages."""
    count: int
    """Number of images."""
    images: Callable[[Sequence[int]], Iterator[Image]]
    """Function that decodes some images, by ascending index; it raises an `InputError` for one that cannot be."""
    times: Sequence[int] | None = None
    """Time of every image, ns, in ascending order; None if they have none."""


def topic_images(
    files: Sequence[Path], topic: str, times: Sequence[int], key_frames: Mapping[str, Sequence[int]]
) -> ImageSource:
    """Return the images of a topic of a bag, by their recording times, ns, and those of the key frames of videos."""

    def images(wanted: Sequence[int]) -> Iterator[Image]:
        with open_bag(files) as bag:
            reader = ImageReader(bag, key_frames)
            for time in [times[index] for index in wanted]:
                for image in [image for _, image in reader.images({topic}, time, time + 1)][:1]:
                    yield image()

    return ImageSource(topic, len(times), images, times)


def file_images(place: str, files: Sequence[Path]) -> ImageSource:
    """Return images in files."""
    return ImageSource(place, len(files), lambda wanted: (read_image(files[index]) for index in wanted))


def video_images(sensor: SensorDescription) -> ImageSource:
    """Return the frames of a sensor's video.

    Raises:
        InputError: it is no video.
    """
    video = survey_videos([sensor])[sensor.name]

    def images(wanted: Sequence[int]) -> Iterator[Image]:
        frames = decoded_frames(video.path, wanted, wanted[-1] + 1)
        return (frame.image for frame in frames if frame.image is not None)

    return ImageSource(str(video.path), len(video.stamps), images, video.stamps)


def described_images(described: ImportDescription) -> dict[str, ImageSource]:
    """Return the images of the cameras in folders and videos that import.yml names.

    Raises:
        InputError: a folder or a file is missing or wrong, or there are no images.
    """
    found: dict[str, ImageSource] = {}
    for sensor in [each for each in described.sensors if each.images][:MAX_CAMERAS]:
        if is_video(sensor.images or ""):
            found[sensor.name] = video_images(sensor)
        else:
            pictures = find_pictures(sensor.name, sensor.images or "")
            found[sensor.name] = file_images(pictures.place, pictures.files)
    if not found and described.samples is not None:
        images = [each.image for each in read_samples(described.samples, described.in_hand) if each.image]
        if gone := [each for each in images if not each.is_file()]:
            raise InputError(f"{gone[0]}: found no such file, expected an image of {described.samples.file}")
        if images:
            found[described.sensors[0].name] = file_images(str(described.samples.file), images)
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
        return {path.stem: video_images(SensorDescription(path.stem, images=str(path)))}
    if not path.is_dir():
        raise InputError(
            f"{path}: found no such folder or recording, expected a bag (.bag, .db3, .mcap, or a folder with "
            f"metadata.yaml), a folder of images, a video ({', '.join(VIDEO_ENDINGS)}) or an import.yml"
        )
    folders = [path, *sorted(each for each in path.iterdir() if each.is_dir())]
    with_images = [each for each in folders if any(file.suffix.lower() in IMAGE_ENDINGS for file in each.iterdir())]
    if not with_images:
        endings = (*BAG_ENDINGS, *VIDEO_ENDINGS)
        recordings = [file.name for file in sorted(path.iterdir()) if file.suffix.lower() in endings]
        hint = f"; name a recording in it: {recordings[0]}" if recordings else ""
        raise InputError(
            f"{path}: found no image in it or in its folders, expected files in {', '.join(IMAGE_ENDINGS)}{hint}"
        )
    chosen = with_images[:1] if with_images[0] == path else with_images[:MAX_CAMERAS]
    return {each.name: file_images(str(each), find_pictures(each.name, str(each)).files) for each in chosen}
