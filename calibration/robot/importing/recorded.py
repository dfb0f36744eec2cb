"""Recorded and detected data as collections of a dataset: intrinsics, range data, rejections."""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from calibration.base.arrays import Array
from calibration.base.errors import InputError
from calibration.engine.dataset.configuration import Configuration, PatternConfiguration
from calibration.engine.dataset.lens_uncertainty import LensUncertainty
from calibration.engine.dataset.model import Edge
from calibration.engine.estimation.start.lens_choice import LensChoice
from calibration.engine.geometry.cameras import Camera
from calibration.robot.importing.bags.board_motion import MovingBoards
from calibration.robot.importing.bags.range_views import RangeView
from calibration.robot.importing.document import Imported
from calibration.robot.importing.files.camera_files import KnownLens
from calibration.robot.importing.patterns.image_views import LabelledMoment, View, check_sizes, read_image
from calibration.robot.importing.patterns.near_miss import check_board, check_spacing, never_seen
from calibration.robot.importing.patterns.range_data import LabelledRange, labelled_ranges
from calibration.robot.importing.patterns.starting_intrinsics import starting_intrinsics
from calibration.robot.importing.results import LeftOut, RejectedView
from calibration.robot.labelling.detection import Image, NotDetected
from calibration.robot.labelling.points import PatternPoints


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
    """(N, 3, 6): velocity, acceleration and jerk of frames that move, see `calibration.engine.dataset.velocities`."""
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
