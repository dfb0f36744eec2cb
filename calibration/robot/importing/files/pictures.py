"""Image files of each camera, and their association across cameras."""

import csv
import io
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from glob import has_magic
from itertools import pairwise
from pathlib import Path
from typing import Literal

from calibration.base import InputError, read_bytes
from calibration.base.files import matching

IMAGE_ENDINGS = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".pgm", ".ppm", ".webp")
"""Endings of image files, in lower case."""
MOST_IMAGES = 20_000
"""Limit of the images of one camera."""
MAX_CSV = 10_000_000
_NUMBER_IN_NAME = re.compile(r"\d+")

_STAMP_IN_NAME = re.compile(r"\d{15,19}")
MAX_STAMP_DIFFERENCE_NS = 20_000_000
"""ns: limit of the difference of stamps of associated images; Kalibr's default."""

Pairs = Literal["name", "number", "stamp"] | Path | None


@dataclass(frozen=True)
class Pictures:
    """Images of one camera."""

    sensor: str
    place: str
    """The folder, or the glob pattern, for messages."""
    files: tuple[Path, ...]
    """Sorted by number."""


@dataclass(frozen=True)
class Moment:
    """Images of one moment."""

    name: str
    """Common part of their names, for messages."""
    files: Mapping[str, Path]
    """Image file of each sensor."""
    lag: float = 0.0
    """Time between the first and the last of them, s, if their names are stamps."""


def find_pictures(sensor: str, place: str, endings: Sequence[str] = IMAGE_ENDINGS, what: str = "image") -> Pictures:
    """Find the images, or other files by their endings, in a folder or of a glob pattern.

    Raises:
        InputError: there are none, or too many.
    """
    if has_magic(place) and not Path(place).exists():
        found = [Path(name) for name in matching([place])]
    elif Path(place).is_dir():
        found = [path for path in Path(place).iterdir() if path.is_file()]
    else:
        raise InputError(f"{place}: found no such folder, expected each {what} of '{sensor}'")
    files = [path for path in found if path.suffix.lower() in endings]
    if not files:
        raise InputError(f"{place}: found no {what} of '{sensor}', expected files that end in {', '.join(endings)}")
    if len(files) > MOST_IMAGES:
        raise InputError(f"{place}: found {len(files)} files of '{sensor}', expected {MOST_IMAGES} at most")
    return Pictures(sensor, place, tuple(sorted(files, key=order_by_number)))


def moments_of(pictures: Sequence[Pictures], pairs: Pairs = None) -> list[Moment]:
    """Associate images across cameras, in the order of the first camera's; some cameras may be missing.

    Args:
        pictures: of each camera.
        pairs: criterion: names, their last numbers, the stamps in nanoseconds that they are, or a CSV file.
            By default stamps if all names are, names if two cameras have a common one, else numbers.

    Raises:
        InputError: two cameras have no images in common, one image belongs to two moments, or the CSV is invalid.
    """
    if isinstance(pairs, Path):
        return _by_table(pictures, pairs)
    stamped = all(_STAMP_IN_NAME.fullmatch(path.stem) for each in pictures for path in each.files)
    if pairs == "stamp" or (pairs is None and stamped and len(pictures) > 1):
        return _by_stamp(pictures)
    if pairs == "name" or len(pictures) == 1:
        return _moments_of_keys(pictures, [_by_stem(each) for each in pictures], "name")
    if pairs is None:
        named = [_by_stem(each) for each in pictures]
        if any(set(one) & set(other) for i, one in enumerate(named) for other in named[:i]):
            return _moments_of_keys(pictures, named, "name")
    return _moments_of_keys(pictures, [_by_last_number(each) for each in pictures], "number")


def order_by_number(path: Path) -> tuple[list[int], str]:
    """Return the key by which images are sorted: the last number in their names, and the names."""
    return [int(number) for number in _NUMBER_IN_NAME.findall(path.stem)[-1:]], path.name


def _by_stem(pictures: Pictures) -> dict[str, Path]:
    """Return the images by their names without the ending and the sensor's name."""
    found: dict[str, Path] = {}
    for path in pictures.files:
        name = path.stem.replace(pictures.sensor, "").strip("_-. ") or path.stem
        if (other := found.setdefault(name, path)) is not path:
            raise _ambiguity_error(pictures, other, path, f"the name '{name}'")
    return found


def _by_last_number(pictures: Pictures) -> dict[str, Path]:
    """Return the images by the last numbers in their names."""
    found: dict[str, Path] = {}
    for path in pictures.files:
        numbers = _NUMBER_IN_NAME.findall(path.stem)
        if not numbers:
            raise InputError(
                f"{path}: found no number in its name, expected one that tells which images belong together; or give "
                "a CSV file: pairs"
            )
        if (other := found.setdefault(str(int(numbers[-1])), path)) is not path:
            raise _ambiguity_error(pictures, other, path, f"the number {int(numbers[-1])}")
    return found


@dataclass(frozen=True, order=True)
class _Stamped:
    """Image whose name is its stamp, ns."""

    stamp: int
    sensor: str
    path: Path


def _by_stamp(pictures: Sequence[Pictures]) -> list[Moment]:
    """Associate images within `MAX_STAMP_DIFFERENCE_NS`, each with the nearest one of the first camera."""
    by_sensor = {each.sensor: sorted(_with_stamps(each)) for each in pictures}
    after = {one: other.stamp for images in by_sensor.values() for one, other in pairwise(images)}
    groups: list[dict[str, _Stamped]] = []
    for image in sorted(image for images in by_sensor.values() for image in images):
        first = next(iter(groups[-1].values())) if groups else image
        apart = image.stamp - first.stamp
        nearer = first not in after or apart <= abs(after[first] - image.stamp)
        if groups and image.sensor not in groups[-1] and apart <= MAX_STAMP_DIFFERENCE_NS and nearer:
            groups[-1][image.sensor] = image
        else:
            groups.append({image.sensor: image})
    for each in pictures[1:]:
        if not any(each.sensor in group and len(group) > 1 for group in groups):
            one, other = (by_sensor[sensor][0] for sensor in (pictures[0].sensor, each.sensor))
            raise InputError(
                f"{each.place}: no image of '{each.sensor}' was taken within {MAX_STAMP_DIFFERENCE_NS / 1e9:g} s of "
                "another camera's, "
                f"by the stamps that are their names ({other.path.name}, '{pictures[0].sensor}' {one.path.name}): are "
                "their clocks synchronised?"
            )
    return [_as_moment(group) for group in groups]


def _with_stamps(pictures: Pictures) -> list[_Stamped]:
    """Return the images with their stamps."""
    for path in pictures.files:
        if not _STAMP_IN_NAME.fullmatch(path.stem):
            raise InputError(f"{path}: found '{path.stem}' as its name, expected a stamp in nanoseconds (pairs: stamp)")
    found = {int(path.stem): path for path in pictures.files}
    if len(found) < len(pictures.files):
        stem = next(path.stem for path in pictures.files if path not in found.values())
        raise InputError(f"{pictures.place}: found two images with the stamp {int(stem)}, expected each once")
    return [_Stamped(stamp, pictures.sensor, path) for stamp, path in found.items()]


def _as_moment(group: Mapping[str, _Stamped]) -> Moment:
    stamps = [image.stamp for image in group.values()]
    files = {sensor: image.path for sensor, image in group.items()}
    return Moment(str(stamps[0]), files, (stamps[-1] - stamps[0]) / 1e9)


def _ambiguity_error(pictures: Pictures, one: Path, other: Path, what: str) -> InputError:
    return InputError(
        f"{pictures.place}: found {what} in {one.name} and {other.name}, expected each once to tell which images "
        "belong together; give a CSV file: pairs"
    )


def _moments_of_keys(pictures: Sequence[Pictures], keyed: Sequence[Mapping[str, Path]], by: str) -> list[Moment]:
    for each, own in zip(pictures[1:], keyed[1:], strict=True):
        if not any(set(own) & set(others) for others in keyed if others is not own):
            one, other = pictures[0], each
            raise InputError(
                f"{other.place}: no image of '{other.sensor}' belongs to one of '{one.sensor}' by its {by} (such as "
                f"{other.files[0].name} and {one.files[0].name}); give a CSV file: pairs"
            )
    keys = dict.fromkeys(key for own in keyed for key in own)
    return [
        Moment(key, {p.sensor: own[key] for p, own in zip(pictures, keyed, strict=True) if key in own}) for key in keys
    ]


def _by_table(pictures: Sequence[Pictures], path: Path) -> list[Moment]:
    """Associate images by a CSV file with a column for each sensor; an empty cell for a missing image."""
    content = read_bytes(path, MAX_CSV, "a CSV file of images")
    try:
        rows = list(csv.reader(io.StringIO(content.decode("utf-8-sig")), strict=True))
    except (csv.Error, UnicodeDecodeError) as error:
        raise InputError(f"{path}: this is no CSV file: {error}") from None
    header = [cell.strip() for cell in rows[0]] if rows else []
    columns = {}
    for each in pictures:
        if header.count(each.sensor) != 1:
            raise InputError(
                f"{path}: found the columns {', '.join(header) or 'none'}, expected one for each sensor: {each.sensor}"
            )
        columns[each.sensor] = header.index(each.sensor), {file.name: file for file in each.files}
    moments, seen = [], set[Path]()
    for line, row in enumerate(rows[1:], 2):
        files = {}
        for sensor, (column, known) in columns.items():
            cell = row[column].strip() if column < len(row) else ""
            if not cell:
                continue
            if (file := known.get(Path(cell).name)) is None:
                raise InputError(f"{path}:{line}: found '{cell}', expected an image of '{sensor}'")
            if file in seen:
                raise InputError(f"{path}:{line}: found '{cell}' again, expected every image in one row")
            seen.add(file)
            files[sensor] = file
        if files:
            moments.append(Moment(f"{path.name}:{line}", files))
    if not moments:
        raise InputError(f"{path}: found no row with images, expected one for each moment")
    return moments
