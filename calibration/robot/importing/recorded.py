"""Moments of a recording: the best of those at standstill, and the collections of a dataset that they become."""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from calibration.base import CalibrationError, InputError, UndeterminedError, temporary_folder
from calibration.base.arrays import Array, BoolArray
from calibration.engine.dataset.configuration import Configuration, PatternConfiguration
from calibration.engine.dataset.model import CornerLabels, Dataset, Edge, LensUncertainty
from calibration.engine.dataset.reading import FILE_NAME, read_dataset
from calibration.engine.dataset.writing import write_document
from calibration.engine.estimation.calibrate import calibrate
from calibration.engine.estimation.covariance.result import Solution
from calibration.engine.estimation.least_squares.observability import choose, informations
from calibration.engine.estimation.options import Options
from calibration.engine.estimation.start.lens_choice import SIMPLEST_FIRST, LensChoice, fitting_lens
from calibration.engine.geometry.cameras import Camera
from calibration.engine.geometry.lenses import MODELS
from calibration.robot.importing.bags.motion import MovingBoards
from calibration.robot.importing.bags.range_views import LabelledRange, RangeView, labelled_ranges
from calibration.robot.importing.bags.stillness import BagMoment, evenly
from calibration.robot.importing.document import Imported, dataset_document
from calibration.robot.importing.files.camera_files import KnownLens
from calibration.robot.importing.image_views import LabelledMoment, View, check_sizes, read_image
from calibration.robot.importing.near_miss import check_board, check_spacing, never_seen
from calibration.robot.importing.results import LeftOut, RejectedView
from calibration.robot.labelling.detection import Image, NotDetected
from calibration.robot.labelling.points import PatternPoints
from calibration.robot.simulation.record import image_cells

LEAST_VIEWS = 5
"""Minimum of views: fewer views of a plane do not determine the intrinsics."""
MOST_VIEWS = 60
"""Limit of views: more do not improve the initial guess."""
MAX_CANDIDATES = 1000
"""Limit of the moments to choose from; of more, evenly spaced ones are taken."""


def starting_intrinsics(
    sensor: str,
    size: tuple[int, int],
    views: Sequence[tuple[PatternConfiguration, CornerLabels]],
    model: str | None = None,
) -> LensChoice:
    """Fit intrinsics to the corners, of the simplest lens model that fits.

    Args:
        sensor: the camera, for messages.
        size: of its images, width and height.
        views: corners of which pattern, by view.
        model: the lens model, where it is chosen.

    Raises:
        UndeterminedError: there are too few views.
        InputError: no lens fits them.
    """
    if len(views) < LEAST_VIEWS:
        raise UndeterminedError(
            f"'{sensor}' has no intrinsics, and {len(views)} images with a pattern to calibrate them from; expected "
            f"{LEAST_VIEWS} or more, or a file: intrinsics"
        )
    some = views[:: -(-len(views) // MOST_VIEWS)]
    patterns = {id(pattern): pattern.pattern() for pattern, _ in some}
    models = SIMPLEST_FIRST if model is None else (MODELS[model],)
    return fitting_lens(f"'{sensor}'", *size, [(patterns[id(pattern)], labels) for pattern, labels in some], models)


@dataclass(frozen=True, eq=False)
class Recorded:
    """Recorded data, and the patterns detected in them."""

    configuration: Configuration
    lenses: Mapping[str, KnownLens]
    """Intrinsics of the cameras that have known ones, by sensor."""
    moments: Sequence[LabelledMoment]
    transforms: Mapping[Edge, Array]
    """(N, 4, 4): at each moment."""
    rough: bool
    """Whether the calibrated transforms are only an initial guess."""
    searched: int = 0
    """Number of moments to choose from."""
    evenly: str | None = None
    """Reason why the moments are evenly spaced, and not those that calibrate best."""
    lag: float = 0.0
    """Largest time between the images of a moment, s."""
    ranges: Sequence[Mapping[str, RangeView]] = ()
    """Data of LiDARs and depth cameras at each moment; empty without such sensors."""
    rejected: Mapping[str, Sequence[RejectedView]] = field(default_factory=dict)
    """Images of a bag in which no pattern is detected, by camera."""
    left_out: tuple[LeftOut, ...] = ()
    motions: Mapping[Edge, Array] = field(default_factory=dict)
    """(N, 3, 6): velocity, acceleration and jerk of frames that move, see `calibration.engine.dataset.frames`."""
    boards: MovingBoards | None = None
    """What the motion of boards is taken from; None where all stands still."""
    models: Mapping[str, str] = field(default_factory=dict)
    """Lens models that are chosen, of cameras without given intrinsics."""
    notes: tuple[str, ...] = ()
    """What was read otherwise than recorded."""


def check_views(recorded: Recorded) -> None:
    """Refuse a camera whose images are inconsistent, or show no pattern, or another one.

    Raises:
        InputError: names the camera, and the pattern that it shows instead.
    """
    for name in recorded.configuration.sensors:
        if views := [moment.views[name] for moment in recorded.moments if name in moment.views]:
            check_sizes(name, views)
            check_seen(name, recorded.configuration.patterns, views)
            patterns = recorded.configuration.patterns.values()
            for pattern in patterns:
                check_board(name, pattern, views, [each for each in patterns if each is not pattern])
                check_spacing(name, pattern, views)


def imported_moments(robot: str, recorded: Recorded) -> Imported:
    """Return the collections: moments at which at least one sensor sees a pattern.

    Raises:
        InputError: a camera has no image, or other sizes than its intrinsics, or too few views for intrinsics; a
            LiDAR or a depth camera sees no pattern.
    """
    cameras: dict[str, Camera] = {}
    lenses: dict[str, str] = {}
    configuration, moments = recorded.configuration, recorded.moments
    for name, sensor in configuration.sensors.items():
        if not sensor.has_corners:
            if name in recorded.lenses:
                cameras[name] = recorded.lenses[name].camera
            continue
        views = [moment.views[name] for moment in moments if name in moment.views]
        if not views:
            raise InputError(f"'{name}' has no image in any moment")
        if (lens := recorded.lenses.get(name)) is not None:
            cameras[name] = _given_camera(name, lens, views[0])
            _check_model(name, lens, recorded.models.get(name))
            continue
        choice = _fitted_lens(name, configuration, views, recorded.models.get(name))
        cameras[name], lenses[name] = choice.guess, choice.reason
    kept = [i for i, moment in enumerate(moments) if any(view.labelled for view in moment.views.values())]
    ranges = _label_ranges(recorded, cameras)
    of_boards = recorded.boards.motions(configuration, cameras) if recorded.boards else {}
    return Imported(
        robot=robot,
        configuration=configuration,
        cameras=cameras,
        uncertainties={name: known for name in cameras if (known := _lens_uncertainty(recorded, name))},
        estimated=lenses,
        chosen=[name for name in lenses if name in recorded.models],
        moments=[moments[i] for i in kept],
        ranges=[ranges[i] for i in kept],
        transforms={edge: T[kept] for edge, T in recorded.transforms.items()},
        rough=recorded.rough,
        motions={edge: motion[kept] for edge, motion in {**recorded.motions, **of_boards}.items()},
    )


def _lens_uncertainty(recorded: Recorded, name: str) -> LensUncertainty | None:
    lens = recorded.lenses.get(name)
    return lens.uncertainty if lens else None


def _label_ranges(recorded: Recorded, cameras: Mapping[str, Camera]) -> Sequence[Mapping[str, LabelledRange]]:
    """Detect the patterns in the data of LiDARs and depth cameras.

    Raises:
        InputError: one sees none at any moment.
    """
    configuration = recorded.configuration
    measuring = [name for name, sensor in configuration.sensors.items() if not sensor.has_corners]
    if not measuring:
        return [{} for _ in recorded.moments]
    ranges = labelled_ranges(recorded.ranges, recorded.moments, configuration, cameras, recorded.transforms)
    for name in measuring:
        found = [each for own in ranges if name in own for each in own[name].found.values()]
        if not any(isinstance(each, PatternPoints) for each in found):
            reasons = Counter(each.reason for each in found if isinstance(each, NotDetected)).most_common(1)
            why = reasons[0][0] if reasons else "nothing was recorded at any of the moments"
            raise InputError(
                f"'{name}' sees no pattern at any of {len(ranges)} moments where a camera sees it (mostly: {why}); its "
                "place relative to the cameras must be known to 10 cm: is it in /tf, the robot description or 'pose'?"
            )
    return ranges


def check_seen(
    name: str,
    patterns: Mapping[str, PatternConfiguration],
    views: Sequence[View],
    read_view: Callable[[int], Image] | None = None,
) -> None:
    """Refuse a camera that sees none of the patterns."""
    if not any(view.labelled for view in views):
        raise never_seen(
            name, next(iter(patterns.values())), views, read_view or (lambda i: read_image(Path(views[i].file)))
        )


def _fitted_lens(name: str, configuration: Configuration, views: Sequence[View], model: str | None) -> LensChoice:
    """Return an initial guess of the intrinsics, from the corners."""
    seen = [
        (configuration.patterns[pattern], labels)
        for view in views
        for pattern, found in view.found.items()
        if (labels := found.labels) is not None
    ]
    return starting_intrinsics(name, (views[0].width, views[0].height), seen, model)


def _check_model(name: str, lens: KnownLens, model: str | None) -> None:
    """Refuse another lens model than that of known intrinsics."""
    known = lens.camera.distortion.ros_name
    if model not in (None, known):
        raise InputError(
            f"{lens.path}: '{name}' has intrinsics of {known} there, found 'model: {model}' in import.yml, expected "
            "the same: leave it out, or give 'intrinsics' of that model"
        )


def _given_camera(name: str, lens: KnownLens, view: View) -> Camera:
    """Return the given intrinsics, for images of the size of a view."""
    if lens.has_size and (lens.camera.width, lens.camera.height) != (view.width, view.height):
        raise InputError(
            f"{view.file}: found an image of {view.width} x {view.height} pixels, expected {lens.camera.width} x "
            f"{lens.camera.height} as {lens.path} has for '{name}'"
        )
    return replace(lens.camera, width=view.width, height=view.height)


def best_moments(
    moments: Sequence[BagMoment], most: int, recorded: Callable[[Sequence[BagMoment]], Recorded]
) -> tuple[list[BagMoment], str | None]:
    """Select moments, in their order; and the reason why they are evenly spaced, if they cannot be calibrated.

    All of them are calibrated once, by the cameras alone; the information of each is additive
    (`calibration.engine.estimation.least_squares.observability`).

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
