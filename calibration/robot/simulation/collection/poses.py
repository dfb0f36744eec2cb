"""Collection of all poses of a motion: each is captured, labelled and checked, and its record is stored."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial

import cv2

from calibration.ci.execution.tasks import Task, run_tasks
from calibration.ci.execution.workspace import Workspace
from calibration.robot.simulation.collection.capture import Requirements, capture, reasons_to_lose
from calibration.robot.simulation.collection.record import Record, data_file, record
from calibration.robot.simulation.placement import Play

Done = Callable[[int, int, Record], None]
"""Callback after each pose: number of finished poses, number of all poses, record."""


def collect_pose(
    play: Play, number: int, requirements: Requirements, images: bool = True
) -> tuple[Record, dict[str, bytes]]:
    """Collect one pose.

    Args:
        play: the motion.
        number: index of the pose, from 0.
        requirements: requirements of the collection.
        images: whether images are written too; point clouds always are, as labels refer to them.

    Returns:
        The record, and the contents of its files by name.
    """
    seen = capture(play, number)
    files = {
        data_file(name, sensor, number): sensor.encode(seen.data[name])
        for name, sensor in play.system.sensors.items()
        if sensor.file_ending and (images or sensor.modality.points)
    }
    return record(play, seen, reasons_to_lose(play.system, seen, requirements)), files


def collect(
    play: Play,
    requirements: Requirements,
    workspace: Workspace[Record],
    jobs: int | None = None,
    done: Done = lambda *_: None,
) -> list[Record]:
    """Collect every pose without a record in the workspace.

    Args:
        play: the motion.
        requirements: requirements of each collection.
        workspace: folder of records and files; existing ones are not made again.
        jobs: number of processes; None for one per core.
        done: called after each pose; first for those already finished.

    Returns:
        All records, in the order of the poses.

    Raises:
        InfrastructureError: a file cannot be written, or a process died.
    """

    def collect_into(number: int) -> Record:
        found, files = collect_pose(play, number, requirements)
        return workspace.keep(str(number), found, files)

    tasks = [Task.call(str(number), partial(collect_into, number)) for number in range(len(play))]
    with single_threaded_opencv():
        return list(run_tasks(tasks, workers=jobs, find=workspace.find, done=done).values())


@contextmanager
def single_threaded_opencv() -> Iterator[None]:
    """Limit OpenCV to one thread: the parallelism is by processes, and its threads do not survive a fork."""
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(threads)


def kept(records: Sequence[Record]) -> list[Record]:
    """Return the records that are part of the dataset."""
    return [record for record in records if record.kept]
