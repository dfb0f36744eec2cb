"""Choice of a lens model for a camera: each model is fitted to its corners alone, and the simplest that fits is taken.

A fit needs no guess: of some fields of view the best one is where the least squares begins, over the intrinsics and
the pose of the pattern in each view. A simpler model is rejected if the best one fits significantly better, views being
independent of each other and parameters having their price (Q. H. Vuong, "Likelihood ratio tests for model selection
and non-nested hypotheses", 1989, with Schwarz's correction for the number of parameters).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import cast

import numpy as np

from calibration.base import InputError
from calibration.base.arrays import Array
from calibration.engine.dataset.model import CornerLabels, Dataset
from calibration.engine.dataset.pattern import Pattern
from calibration.engine.estimation.least_squares.minimisation import HUBER_THRESHOLD, Termination, optimise
from calibration.engine.estimation.least_squares.noise_levels import NoiseLevels
from calibration.engine.estimation.options import LensModel, Options
from calibration.engine.estimation.problem.blocks import Block, FreeIntrinsics, Values
from calibration.engine.estimation.problem.problem import Problem
from calibration.engine.estimation.residuals.corner_residuals import CornerTerm
from calibration.engine.estimation.residuals.planar_pose import determines_pose
from calibration.engine.estimation.residuals.views import Chain, Link, ViewGroup, robust
from calibration.engine.estimation.start.ambiguous_views import unflipped
from calibration.engine.estimation.start.single_views import corner_term, refined_poses
from calibration.engine.geometry.cameras import Camera
from calibration.engine.geometry.lenses import MODELS, Distortion, PlumbBob, Rational
from calibration.engine.geometry.lenses.model import IN_FRONT

SIMPLEST_FIRST: tuple[type[Distortion], ...] = tuple(MODELS.values())
"""Models in the order in which they are preferred, if they fit as well as each other."""
MIN_WIDE_ANGLE = np.radians(60.0)
"""Angle of a corner from the optical axis, from which models of wide lenses are compared too."""
MIN_SIGNIFICANT_SCORE = 2.5
"""Standard score from which another model fits better."""
MAX_NOISE_RATIO = 1.5
"""Ratio of a model's robust noise to the best one's from which it is worse, whatever single views say."""
MAX_NEGLIGIBLE_SHARE = 0.25
"""Fraction of the best model's RMS by which another one may err, without being worse for it."""
FIELDS_OF_VIEW = (20, 30, 45, 60, 75, 90, 105, 120, 140, 160, 180, 200, 220)
"""Degrees over the longer side of the image: the least squares begins with the best of them."""
MAX_STARTS = 4
"""Number of fields of view from which a model is fitted, until it has a minimum."""
WIDEST_PINHOLE = 130
"""Degrees: a wider field of view is no start of a model that is a pinhole without its coefficients."""
TERMINATION_OF_COMPARISON = Termination(decrease=1e-2, iterations=15)
"""Enough to compare fields of view."""
PIXEL_DECIMALS, COEFFICIENT_DECIMALS = 3, 6
"""Decimals of a fitted lens, which is a guess: the last digits would differ between processors."""
GUESSED_ZERO = ("k3",)
"""Coefficients that plumb_bob has and Kalibr's radtan has not."""
MAX_PINHOLE_ANGLE = np.radians(85.0)
"""Limit of the angle at which a pinhole is fitted to another lens."""
MAX_RMS = 5.0
"""px: a lens that fits its corners worse than this does not fit."""
NUMBER_OF_RADII = 50
"""Number of radii at which a rational lens is fitted to another one."""


@dataclass(frozen=True, eq=False)
class LensFit:
    """Lens model fitted to the corners of one camera."""

    camera: Camera
    residuals: tuple[Array, ...]
    """Of each pattern, (V, K): px; NaN where a view does not see a corner."""
    noise: float
    """Robust standard deviation of the residuals, px."""

    @property
    def name(self) -> LensModel:
        """ROS's name of the model."""
        return cast("LensModel", self.camera.distortion.ros_name)

    @property
    def order(self) -> int:
        """Position among the models, simplest first."""
        return SIMPLEST_FIRST.index(type(self.camera.distortion))

    @cached_property
    def rms(self) -> float:
        """Root mean square of the residuals, px."""
        return float(np.sqrt(np.nanmean(np.concatenate([each.ravel() for each in self.residuals]) ** 2)))

    def costs(self, noise: float) -> Array:
        """Return the robust cost (V,) of each view, with this standard deviation of the labels, px."""
        return np.concatenate([robust(np.nan_to_num(each / noise) ** 2, HUBER_THRESHOLD)[0] for each in self.residuals])


@dataclass(frozen=True, eq=False)
class LensChoice:
    """Lens model that was chosen for a camera, and those that it was compared with."""

    chosen: LensFit
    others: tuple[LensFit, ...]
    guess: Camera
    """Where a calibration begins; coefficients of `GUESSED_ZERO` are 0, as whoever holds them expects."""

    @property
    def reason(self) -> str:
        """Reason of the choice, in words."""
        others = ", ".join(f"{each.name} {each.rms:.3g}" for each in self.others)
        return (
            f"{self.chosen.name} is the simplest lens model that fits its corners: {self.chosen.rms:.3g} px"
            f"{f' ({others})' if others else ''}"
        )


def fitting_lens(
    where: str,
    width: int,
    height: int,
    views: Sequence[tuple[Pattern, CornerLabels]],
    models: Sequence[type[Distortion]] = SIMPLEST_FIRST,
) -> LensChoice:
    """Fit lens models to the corners of one camera, and choose the simplest of those that fit best.

    Args:
        where: what the message of an error begins with.
        width: of the images, px.
        height: the same.
        views: of which pattern, and the corners, of each view.
        models: the models to compare.

    Raises:
        InputError: no lens model fits the corners.
    """
    terms = _terms_of_views(Camera(1.0, 1.0, 0.0, 0.0, width, height), views)
    fits: list[LensFit] = []
    with np.errstate(all="ignore"):  # a model that diverges is left out
        for model in sorted(models, key=lambda each: (each.is_wide, SIMPLEST_FIRST.index(each))):
            if model.is_wide and len(models) > 1 and fits and not _is_wide(fits, terms):
                continue
            found = [_from_best_start(model, width, height, terms)]
            if model is Rational:
                found += [_fit_lens(start, terms) for fit in fits if (start := _rational_like(fit.camera, terms))]
            fits += sorted(filter(None, found), key=lambda fit: fit.rms)[:1]
        choice = _choose_simplest(fits) if fits else None
        if choice is None or not choice.chosen.rms < MAX_RMS:
            best = f" (the best, {choice.chosen.name}, leaves {choice.chosen.rms:.3g} px)" if choice else ""
            raise InputError(
                f"{where}: no lens model fits its corners{best}: are the patterns as described, with their columns, "
                f"rows and the right corners, and all images of one focus and zoom?"
            )
        model = type(choice.chosen.camera.distortion)
        guess = _from_best_start(model, width, height, terms, GUESSED_ZERO) if model is PlumbBob else None
    return replace(choice, guess=guess.camera if guess else choice.chosen.camera)


def _is_wide(fits: Sequence[LensFit], terms: Sequence[CornerTerm]) -> bool:
    """Whether the lens sees corners far to the side, by the model that fits best so far."""
    camera = min(fits, key=lambda fit: fit.rms).camera
    return bool(camera.distortion.chart.angle(_radii_of_corners(camera, terms)).max(initial=0.0) > MIN_WIDE_ANGLE)


def _radii_of_corners(camera: Camera, terms: Sequence[CornerTerm]) -> Array:
    """Return the lengths (n,) of the corners' coordinates in the lens's chart."""
    return np.concatenate([np.hypot(*_seen_rays(term.seen_with(camera, ()))) for term in terms])


def _seen_rays(term: CornerTerm) -> Array:
    """Return the labels (2, n) as coordinates in the lens's chart, where they have some; not the corners unseen."""
    rays = np.swapaxes(term.rays, 0, 1).reshape(2, -1)
    seen = np.isfinite(rays).all(0) & (True if term.seen is None else term.seen.ravel())
    return np.asarray(rays[:, seen])


def _choose_simplest(fits: Sequence[LensFit]) -> LensChoice:
    """Choose the simplest model that does not fit significantly worse than the best."""
    noise = min(fit.noise for fit in fits)
    costs = {fit.order: fit.costs(noise) for fit in fits}
    price = {fit.order: len(fit.camera.parameters) * np.log(len(costs[fit.order])) for fit in fits}
    best = min(fits, key=lambda fit: float(costs[fit.order].sum() + price[fit.order]))

    def fits_worse(fit: LensFit) -> bool:
        if fit.rms**2 - best.rms**2 < (MAX_NEGLIGIBLE_SHARE * best.rms) ** 2:
            return False
        if fit.noise > MAX_NOISE_RATIO * best.noise:  # one view that it does not fit at all hides all others
            return True
        more = costs[fit.order] - costs[best.order]
        excess = more.sum() + price[fit.order] - price[best.order]
        return bool(excess > MIN_SIGNIFICANT_SCORE * np.sqrt(len(more)) * more.std())

    chosen = next(fit for fit in fits if fit is best or not fits_worse(fit))
    return LensChoice(chosen, tuple(fit for fit in fits if fit is not chosen), chosen.camera)


def _terms_of_views(camera: Camera, views: Sequence[tuple[Pattern, CornerLabels]]) -> list[CornerTerm]:
    """Return the views that determine a pose, pattern by pattern."""
    terms = []
    for pattern in dict.fromkeys(pattern for pattern, _ in views):
        term = corner_term(camera, pattern, [labels for each, labels in views if each is pattern])
        seen = np.ones(term.pixels[:, 0].shape, bool) if term.seen is None else term.seen
        usable = np.flatnonzero(determines_pose(term.corners, seen))
        if len(usable):
            terms.append(term.take(usable))
    return terms


def _from_best_start(
    model: type[Distortion], width: int, height: int, terms: Sequence[CornerTerm], held: Sequence[str] = ()
) -> LensFit | None:
    """Fit a model from the field of view that fits best, or else from the next ones; None without a minimum."""
    starts = _starts_of_model(model, width, height, terms)[:MAX_STARTS]
    return next((fit for start in starts if (fit := _fit_lens(start, terms, held)) is not None), None)


def _starts_of_model(
    model: type[Distortion], width: int, height: int, terms: Sequence[CornerTerm]
) -> list[tuple[Camera, list[Array]]]:
    """Return cameras without coefficients, and their poses ``T_camera_centre``; those that fit best come first."""
    found = []
    for degrees in FIELDS_OF_VIEW:
        half = np.radians(degrees) / 2
        lens = model(*model.start)
        if degrees > WIDEST_PINHOLE and (model.chart is IN_FRONT or not lens.sees(np.array(np.cos(half)))):
            continue
        f = max(width, height) / 2 / float(lens.distort(np.array([model.chart.radius(half)]), np.zeros(1))[0][0])
        camera = Camera(f, f, (width - 1) / 2, (height - 1) / 2, width, height, lens)
        poses, rms = _poses_and_rms(camera, terms)
        found.append((float(np.median(rms)), (camera, poses)))
    return [start for rms, start in sorted(found, key=lambda each: each[0]) if np.isfinite(rms)]


def _poses_and_rms(camera: Camera, terms: Sequence[CornerTerm]) -> tuple[list[Array], Array]:
    """Return the poses of each term's views, and the RMS (V,) of all views, px; infinite where there is no pose."""
    poses, rms = [], []
    for term in (term.seen_with(camera, ()) for term in terms):
        T, own = refined_poses(term, term.linear_poses, until=TERMINATION_OF_COMPARISON)
        poses.append(T)
        rms.append(np.where(np.isfinite(own), own, np.inf))
    return poses, np.concatenate(rms)


def _rational_like(camera: Camera, terms: Sequence[CornerTerm]) -> tuple[Camera, list[Array]] | None:
    """Return a rational lens whose radial curve is that of another one at the labels, and its poses.

    The curve ``s(r) = (1 + a r^2 + b r^4 + c r^6) / (1 + d r^2 + e r^4 + f r^6)`` gives an equation for a to f that is
    linear, for each radius r.
    """
    chart = camera.distortion.chart
    angles = np.minimum(chart.angle(_radii_of_corners(camera, terms)), MAX_PINHOLE_ANGLE)
    r = np.linspace(0, float(np.tan(angles.max(initial=0.0))), NUMBER_OF_RADII + 1)[1:]
    at = r if chart is IN_FRONT else np.arctan(r)
    s = camera.distortion.distort(at, np.zeros_like(at))[0] / r
    powers = np.stack([r**2, r**4, r**6], -1)
    k1, k2, k3, k4, k5, k6 = np.linalg.lstsq(np.hstack([powers, -s[:, None] * powers]), s - 1, rcond=None)[0].tolist()
    lens = Rational(k1, k2, 0.0, 0.0, k3, k4, k5, k6)
    rational = Camera(camera.fx, camera.fy, camera.cx, camera.cy, camera.width, camera.height, lens)
    poses, rms = _poses_and_rms(rational, terms)
    return (rational, poses) if np.isfinite(rms).all() else None


def _fit_lens(
    start: tuple[Camera, list[Array]], terms: Sequence[CornerTerm], held: Sequence[str] = ()
) -> LensFit | None:
    """Minimise over intrinsics, but some that are held, and poses; None without a minimum."""
    camera, poses = start
    T = np.concatenate(poses)
    if not np.isfinite(T).all():
        return None
    terms = [term.seen_with(camera, ()) for term in terms]
    rays = np.concatenate([_seen_rays(term) for term in terms], 1)
    parameters = tuple(each for each in camera.parameters if each not in held)
    free = FreeIntrinsics("camera", camera, parameters, rays)
    problem = _problem_of_camera(free, terms)
    found = optimise(problem, (T, camera.intrinsics), NoiseLevels(), robust=True)
    values: Values = found.optimum.values
    values, _ = unflipped(problem, values, found.weighting, found.optimum.equations.cost)
    found = optimise(problem, values, NoiseLevels(), robust=True)
    values = found.optimum.values
    if not (found.optimum.reached and np.isfinite(values[1]).all() and free.possible(values[1])):
        return None
    exact = camera.with_intrinsics(values[1])
    residuals = tuple(
        term.magnitudes(problem.poses(group, values))
        for group in problem.groups
        for term in problem.terms(group, values)
    )
    decimals = [PIXEL_DECIMALS] * 4 + [COEFFICIENT_DECIMALS] * len(exact.distortion.names())
    rounded = np.array([round(value, k) for value, k in zip(values[1].tolist(), decimals, strict=True)])
    return LensFit(exact.with_intrinsics(rounded), residuals, found.weighting.scales["pixel"])


def _problem_of_camera(free: FreeIntrinsics, terms: Sequence[CornerTerm]) -> Problem:
    """Return the problem of one camera, with a pose for each view and all intrinsics free."""
    counts = [len(term.counts) for term in terms]
    views = np.split(np.arange(sum(counts)), np.cumsum(counts)[:-1])
    chain = Chain(None, (Link(0, inverted=False),))
    groups = [
        ViewGroup("camera", f"{k}", at, chain, (term,), 1)
        for k, (at, term) in enumerate(zip(views, terms, strict=True))
    ]
    blocks = (Block("view", per_collection=True), Block("intrinsics", parameters=free))
    return Problem(blocks, tuple(groups), sum(counts))


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


def _cameras_to_choose(dataset: Dataset) -> list[str]:
    return [name for name, sensor in dataset.sensors.items() if sensor.modality.has_corners]


def _views_of_camera(dataset: Dataset, camera: str) -> list[tuple[Pattern, CornerLabels]]:
    return [
        (dataset.patterns[pattern], labels)
        for collection in dataset.collections
        for (pattern, sensor), labels in collection.labels.items()
        if sensor == camera and isinstance(labels, CornerLabels)
    ]
