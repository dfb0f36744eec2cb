"""All poses of a motion: each is captured, labelled and checked, and leaves its record."""

from collections.abc import Callable, Sequence
from functools import partial

import cv2

from calibration.dataset.configuration import SensorConfiguration
from calibration.execution.parallel import in_parallel
from calibration.simulation.collection.capture import capture
from calibration.simulation.collection.checks import Requirements, reasons_to_lose
from calibration.simulation.collection.payload import data_file, encode
from calibration.simulation.collection.play import Play
from calibration.simulation.collection.record import Record, collection_key, record
from calibration.simulation.collection.workspace import Workspace

Done = Callable[[int, int, Record], None]
"""Called after each pose with how many are done, how many there are, and its record."""


def collect_pose(
    play: Play, number: int, requirements: Requirements, images: bool = True
) -> tuple[Record, dict[str, bytes]]:
    """Collect at one pose.

    Args:
        play: the motion.
        number: of the pose, from 0.
        requirements: what the collection has to keep to.
        images: whether files of images are made too; point clouds always are, as labels refer to them.

    Returns:
        The record, and the content of its files by their names.
    """
    seen = capture(play, number)
    files = {
        data_file(sensor, collection_key(number)): encode(seen, sensor.name)
        for sensor in play.system.configuration.sensors.values()
        if sensor.name not in seen.scans and (images or _is_labelled_by_index(sensor))
    }
    return record(play, seen, reasons_to_lose(play.system, seen, requirements)), files


def _is_labelled_by_index(sensor: SensorConfiguration) -> bool:
    return sensor.modality != "rgb"


def collect(
    play: Play, requirements: Requirements, workspace: Workspace, jobs: int | None = None, done: Done | None = None
) -> list[Record]:
    """Collect at every pose that the workspace has no record of.

    Args:
        play: the motion.
        requirements: what each collection has to keep to.
        workspace: where records and files go; those that are there are not made again.
        jobs: processes; None for one a core.
        done: called after each pose; first for those that were done before.

    Returns:
        All records, in the order of the poses.

    Raises:
        WorldError: a file cannot be written, or a process died.
    """
    records = workspace.records()
    if done:
        for count, number in enumerate(sorted(records)):
            done(count + 1, len(play), records[number])
    left = [number for number in range(len(play)) if number not in records]
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)  # the processes are the parallel ones; and OpenCV's threads do not survive a fork
    try:
        for _, found in in_parallel(partial(_collect_into, play, requirements, workspace), left, jobs):
            records[found.number] = found
            if done:
                done(len(records), len(play), found)
    finally:
        cv2.setNumThreads(threads)
    return [records[number] for number in range(len(play))]


def _collect_into(play: Play, requirements: Requirements, workspace: Workspace, number: int) -> Record:
    found, files = collect_pose(play, number, requirements)
    workspace.add(found, files)
    return found


def kept(records: Sequence[Record]) -> list[Record]:
    """The records that make the dataset."""
    return [record for record in records if record.kept]
