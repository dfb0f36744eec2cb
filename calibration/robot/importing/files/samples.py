"""Hand-eye samples: poses of a robot arm, each with an image of the pattern, or with its measured pose."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from calibration.base import InputError
from calibration.base.arrays import Array
from calibration.base.records import field, record
from calibration.engine.dataset.document import Node
from calibration.engine.geometry.transforms import inverse
from calibration.robot.importing.files.pose_files import FilePose, PoseDocument, has_poses, open_pose_files, poses_in
from calibration.robot.importing.files.pose_form import Name, PatternPoseFiles, PoseForm
from calibration.robot.importing.results import LeftOut

ARM_KEYS = ("robot", "effector_wrt_world", "hand_world_samples")
"""Keys of the arm's poses: of easy_handeye 2, of MoveIt, of easy_handeye 1."""
PATTERN_KEYS = ("tracking", "object_wrt_sensor", "camera_marker_samples", "pattern_")
"""Keys of the pattern's poses in the same file; the begin of their columns in a table."""
EASY_HANDEYE_2 = "robot"


@record
class Samples:
    """Poses of a robot arm, one for each image, or for each pose of the pattern."""

    file: Path = field(
        "Poses: a table with x, y, z, qx, qy, qz, qw (and image; pattern_x ...), matrices, OpenCV's FileStorage, JSON, "
        "arrays of numpy, the samples of easy_handeye or MoveIt, cal_data.yaml of industrial_calibration; or a folder, "
        "or a pattern of files (poses/*.txt), with one in each.",
    )
    base: Name = field("Frame that the poses are relative to.", default="base_link")
    tool: Name = field("Frame whose poses they are: the flange.", default="tool0")
    form: PoseForm = field(flat=True, default_factory=PoseForm)
    pattern: PatternPoseFiles | None = field(
        "Measured poses of the pattern, where they are in files of their own or are written otherwise.", default=None
    )


@dataclass(frozen=True, eq=False)
class Sample:
    """Pose of the arm, with its observation."""

    where: str
    """Location in the file, for messages."""
    image: Path | None
    """The camera's image there, if the file names it."""
    T_base_tool: Array
    """(4, 4)."""
    T_camera_pattern: Array | None = None
    """(4, 4): measured pose of the pattern, if available."""
    file: Path | None = None
    """The file of this pose, if each has its own."""


def read_samples(samples: Samples, in_hand: bool) -> list[Sample]:
    """Read the poses of an arm, and those of the pattern where they were measured.

    Args:
        samples: the files, and how poses are written there.
        in_hand: whether the arm carries the camera; if it carries the pattern, easy_handeye2 stores inverse poses.

    Raises:
        InputError: a file, or one that it names, cannot be read, or something in it is missing or wrong.
    """
    documents, form = open_pose_files(samples.file), samples.form
    known = next((key for key in ARM_KEYS if form.key is None and has_poses(documents, form, key)), None)
    arm = poses_in(documents, form, (known,) if known else ())
    if known == EASY_HANDEYE_2:
        _check_mounting(documents[0], in_hand)
        if not in_hand:
            arm = [replace(each, T=inverse(each.T)) for each in arm]
    seen = _pattern_poses(samples, documents)
    if seen is not None:
        paired = same_numbers([each.file for each in arm], [each.file for each in seen], ("the arm", "the pattern"))
        if paired is not None and paired[1]:
            raise InputError(
                f"{samples.file}: found {len(arm)} poses of the arm and {len(seen)} of the pattern, of which "
                f"{len(paired[0])} have the same number, expected one of the pattern for each of the arm"
            )
        if len(seen) != len(arm):
            lacking = max(arm, seen, key=len)[min(len(arm), len(seen))]
            raise InputError(
                f"{lacking.where}: found {len(seen)} poses of the pattern and {len(arm)} of the arm, expected one of "
                "the pattern for each of the arm"
            )
    _check_images(arm)
    return [
        Sample(each.where, each.image, each.T, None if seen is None else seen[i].T, each.file)
        for i, each in enumerate(arm)
    ]


def _pattern_poses(samples: Samples, documents: Sequence[PoseDocument]) -> Sequence[FilePose] | None:
    """Return the poses of the pattern: in files of their own, or beside the arm's."""
    described = samples.pattern or PatternPoseFiles()
    form = described.form.inherited(samples.form)
    if described.file is not None:
        return poses_in(open_pose_files(described.file), form)
    if form.columns is None:
        form = replace(form, columns=samples.form.columns)
    key = form.key or next((key for key in PATTERN_KEYS if has_poses(documents, form, key)), None)
    if key is not None:
        return poses_in(documents, form, (key,))
    if samples.pattern is not None:
        raise InputError(
            f"{documents[0].file}: found no poses of the pattern, expected some: say where they are by 'file' or "
            "'key' of 'samples: pattern' in import.yml"
        )
    return None


def _check_mounting(document: PoseDocument, in_hand: bool) -> None:
    """Refuse samples of easy_handeye2 that were taken with the other mounting."""
    parameters = document.get("parameters") if isinstance(document, Node) and isinstance(document.value, dict) else None
    stated = parameters.get("calibration_type") if parameters else None
    expected = "eye_in_hand" if in_hand else "eye_on_base"
    if stated and stated.text() and stated.text() != expected:
        raise stated.unexpected(
            f"'{expected}' as import.yml has it: the parent of the {'sensor' if in_hand else 'pattern'} is the tool"
        )


def same_numbers(
    files: Sequence[Path | None], others: Sequence[Path | None], what: tuple[str, str]
) -> tuple[list[tuple[int, int]], list[LeftOut]] | None:
    """Return which files belong together by their last numbers; None if not each has a file of its own with a number.

    Args:
        files: one of each pose, or None.
        others: images, or files of other poses, likewise.
        what: what the two are called in the table of what is left out.

    Returns:
        Indices of both, in the order of the first, and what has no counterpart.

    Raises:
        InputError: no two have the same number.
    """
    one, other = _by_number(files), _by_number(others)
    if one is None or other is None:
        return None
    pairs = [(i, other[number]) for number, i in one.items() if number in other]
    if not pairs:
        raise InputError(
            f"{files[0]}: found no number of {what[1]} (such as {others[0]}) among those of {what[0]}, expected "
            "the same numbers in the names of what belongs together"
        )
    left_out = [
        LeftOut(f"{missing} has no file of its number", name, count)
        for name, missing, count in (
            (what[0], what[1], len(files) - len(pairs)),
            (what[1], what[0], len(others) - len(pairs)),
        )
        if count
    ]
    return pairs, left_out


def _by_number(files: Sequence[Path | None]) -> dict[int, int] | None:
    """Return the indices of files by their last numbers; None if one has none, or two have the same."""
    numbers = [None if file is None else _last_number(file) for file in files]
    known = {number: i for i, number in enumerate(numbers) if number is not None}
    return known if len(known) == len(files) else None


def _last_number(path: Path) -> int | None:
    """Return the last number in a file's name, else in its folder's."""
    numbers = re.findall(r"[0-9]+", path.stem) or re.findall(r"[0-9]+", path.parent.name)
    return int(numbers[-1][:18]) if numbers else None


def _check_images(arm: Sequence[FilePose]) -> None:
    images: dict[Path, str] = {}
    for each in arm:
        if each.image is not None and (other := images.setdefault(each.image, each.where)) != each.where:
            raise InputError(f"{each.where}: found the image of {other} again, expected one for each pose")
