"""Selection of those moments at standstill that determine the calibration best."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from calibration.base.arrays import Array, BoolArray
from calibration.base.errors import CalibrationError
from calibration.base.files import temporary_folder
from calibration.engine.dataset.model import CornerLabels, Dataset
from calibration.engine.dataset.reading import FILE_NAME, read_dataset
from calibration.engine.dataset.writing import write_document
from calibration.engine.estimation.calibrate import calibrate
from calibration.engine.estimation.covariance.result import Solution
from calibration.engine.estimation.solve.design import choose, informations
from calibration.engine.estimation.solve.options import Options
from calibration.robot.importing.bags.stillness import BagMoment, evenly
from calibration.robot.importing.document import dataset_document
from calibration.robot.importing.recorded import Recorded, imported_moments
from calibration.robot.simulation.collection.record import image_cells

MAX_CANDIDATES = 1000
"""Limit of the moments to choose from; of more, evenly spaced ones are taken."""


def best_moments(
    moments: Sequence[BagMoment], most: int, recorded: Callable[[Sequence[BagMoment]], Recorded]
) -> tuple[list[BagMoment], str | None]:
    """Select moments, in their order; and the reason why they are evenly spaced, if they cannot be calibrated.

    All of them are calibrated once, by the cameras alone; the information of each is additive
    (`calibration.engine.estimation.solve.design`).

    Args:
        moments: to choose from.
        most: number of selected moments.
        recorded: function that returns the cameras' data of moments; images need not be files.
    """
    if len(moments) <= most:
        return list(moments), None
    candidates = evenly(moments, MAX_CANDIDATES)
    try:
        chosen = _choose_moments(recorded(candidates), most)
    except CalibrationError as error:
        return evenly(moments, most), str(error)
    return [candidates[i] for i in sorted(chosen)], None


def _choose_moments(recorded: Recorded, most: int) -> list[int]:
    """Return the indices of the best moments, at most this many; of repeated poses the first one."""
    imported = imported_moments("", _of_cameras(recorded))
    with temporary_folder() as folder:
        write_document(dataset_document(imported), folder / FILE_NAME)
        dataset = read_dataset(folder)
    solution = calibrate(dataset, Options(description="rough", intrinsics=tuple(imported.estimated))).solution
    once = np.unique(solution.clusters)  # the first collection of each pose that is repeated, and all others
    used = [dataset.keys.index(solution.setup.dataset.keys[i]) for i in once]
    each, calibrated = _information_of_collections(solution)
    cells, partial = _covered_cells(dataset.with_collections(used))
    return [used[i] for i in choose(each[once], calibrated, partial, float(partial.mean()), cells, most)]


def _of_cameras(recorded: Recorded) -> Recorded:
    """Return the recording without LiDARs and depth cameras."""
    known = recorded.configuration
    cameras = {name: sensor for name, sensor in known.sensors.items() if sensor.has_corners}
    anchored = known.anchored_sensor
    if anchored is not None and anchored not in cameras:
        anchored = next(iter(cameras))
    configuration = replace(known, sensors=cameras, anchored_sensor=anchored)
    return replace(recorded, configuration=configuration, ranges=())


def _information_of_collections(solution: Solution) -> tuple[Array, int]:
    """Return the information (N, S, S) of collections in comparable units, calibrated ones first; and their number."""
    problem, patterns = solution.setup.problem, solution.setup.dataset.patterns
    distances = [np.linalg.norm(problem.poses(group, solution.values)[:, :3, 3], axis=-1) for group in problem.groups]
    unit = problem.units(float(np.concatenate(distances).mean()))
    each = unit[:, None] * informations(problem, solution.values, solution.weighting) * unit
    of_patterns = np.zeros(len(unit), bool)
    for block, at in problem.shared_parameters.items():
        of_patterns[at] = problem.blocks[block].name in patterns
    order = np.argsort(of_patterns, kind="stable")
    return each[:, order[:, None], order], int((~of_patterns).sum())


def _covered_cells(dataset: Dataset) -> tuple[BoolArray, Array]:
    """Return a mask (N, C) of the image cells with corners in each collection, and its share (N,) of partial views."""
    places: list[set[tuple[str, int]]] = []
    partial = np.zeros(len(dataset.collections))
    for i, collection in enumerate(dataset.collections):
        own: set[tuple[str, int]] = set()
        views = [(p, s, each) for (p, s), each in collection.labels.items() if isinstance(each, CornerLabels)]
        for _, sensor, label in views:
            if camera := dataset.sensors[sensor].camera:
                own.update((sensor, cell) for cell in image_cells(camera.width, camera.height, [label]))
        whole = [len(label.ids) == len(dataset.patterns[pattern].corners) for pattern, _, label in views]
        partial[i] = 1 - np.mean(whole) if whole else 0.0
        places.append(own)
    every = sorted(set().union(*places))
    return np.array([[cell in own for cell in every] for own in places], bool), partial
