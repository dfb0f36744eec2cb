"""Lens models of the cameras of a dataset whose intrinsics are calibrated: named by the options, or chosen."""

from collections.abc import Sequence
from dataclasses import dataclass

from calibration.base.errors import InputError
from calibration.engine.dataset.model import CornerLabels, Dataset
from calibration.engine.dataset.pattern import Pattern
from calibration.engine.estimation.solve.options import Options
from calibration.engine.estimation.start.lens_choice import SIMPLEST_FIRST, LensChoice, choose_lens
from calibration.engine.geometry.lenses import MODELS, Distortion

MAX_RMS = 5.0
"""px: a lens that fits its corners worse than this does not fit."""


@dataclass(frozen=True, eq=False)
class ChosenLenses:
    """Dataset with lens models for its free intrinsics, and how those that nobody named were chosen."""

    dataset: Dataset
    choices: dict[str, LensChoice]
    """By camera; empty where the model was given."""


def with_chosen_lenses(dataset: Dataset, options: Options) -> ChosenLenses:
    """Return the dataset with the lens models that the options name, or that fit cameras without given intrinsics.

    A camera whose model is another one than the dataset's starts from a fit to its corners.

    Raises:
        InputError: there is no such camera, or no lens model fits its corners.
    """
    for name in options.lens:
        if name not in dataset.sensors or dataset.sensors[name].camera is None:
            raise InputError(
                f"{dataset.path}: lens: found '{name}', expected a camera ({', '.join(_cameras_to_choose(dataset))})"
            )
    cameras, choices = {}, {}
    for name in _cameras_to_choose(dataset):
        camera, views = dataset.sensors[name].camera, _views_of_camera(dataset, name)
        if camera is None or not views or not options.frees_intrinsics_of(name):
            continue
        named = options.lens.get(name)
        if named == camera.distortion.ros_name or (named is None and name not in dataset.cameras_of_unknown_model):
            continue
        models = SIMPLEST_FIRST if named is None else (MODELS[named],)
        choice = fitting_lens(f"{dataset.path}: '{name}'", camera.width, camera.height, views, models)
        if named is None:
            choices[name] = choice
        if type(choice.chosen.camera.distortion) is not type(camera.distortion):
            cameras[name] = choice.guess
    return ChosenLenses(dataset.with_cameras(cameras) if cameras else dataset, choices)


def fitting_lens(
    where: str,
    width: int,
    height: int,
    views: Sequence[tuple[Pattern, CornerLabels]],
    models: Sequence[type[Distortion]] = SIMPLEST_FIRST,
) -> LensChoice:
    """Return the choice of `choose_lens`.

    Raises:
        InputError: no lens model fits the corners; the message begins with ``where``.
    """
    choice = choose_lens(width, height, views, models)
    if choice is None or not choice.chosen.rms < MAX_RMS:
        best = f" (the best, {choice.chosen.name}, leaves {choice.chosen.rms:.3g} px)" if choice else ""
        raise InputError(
            f"{where}: no lens model fits its corners{best}: are the patterns as described, with their columns, rows "
            f"and the right corners, and all images of one focus and zoom?"
        )
    return choice


def _cameras_to_choose(dataset: Dataset) -> list[str]:
    return [name for name, sensor in dataset.sensors.items() if sensor.modality.has_corners]


def _views_of_camera(dataset: Dataset, camera: str) -> list[tuple[Pattern, CornerLabels]]:
    return [
        (dataset.patterns[pattern], labels)
        for collection in dataset.collections
        for (pattern, sensor), labels in collection.labels.items()
        if sensor == camera and isinstance(labels, CornerLabels)
    ]
