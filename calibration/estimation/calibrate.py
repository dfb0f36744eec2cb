"""Calibrate a dataset: from its labels to transforms, their covariances, and warnings."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from calibration.dataset.modalities import BORDERS
from calibration.dataset.model import Dataset, Edge, PointLabels
from calibration.errors import InputError, UndeterminedError, solvable
from calibration.estimation.blocks import Pose, Values
from calibration.estimation.build import Setup, build
from calibration.estimation.error_bars import ErrorBars, error_bars
from calibration.estimation.holding import held_blocks
from calibration.estimation.intrinsics import CalibratedIntrinsics
from calibration.estimation.least_squares import Termination, minimise
from calibration.estimation.linear_start import (
    LinearStart,
    free_patterns,
    linear_start,
    pattern_poses,
    place_gauge_patterns,
)
from calibration.estimation.noise_levels import NoiseLevels, estimate_scales
from calibration.estimation.normal_equations import Weighting
from calibration.estimation.observability import considered_covariance, open_directions
from calibration.estimation.optimisation import HUBER, WeightedOptimum, optimise, unflipped
from calibration.estimation.options import Options as Options
from calibration.estimation.result import CalibratedJoint, Calibration, RejectedLabel, Solution, ViewResiduals
from calibration.estimation.starting_noise import StartingNoise, perturb
from calibration.estimation.suspects import explains_all
from calibration.estimation.unknown_intrinsics import contradicted_priors
from calibration.estimation.wrong_views import without, wrong_views
from calibration.frozen import frozen
from calibration.geometry.transforms import adjoint, inverse, translation
from calibration.geometry.types import Array, BoolArray, IntArray

FLIP_ROUNDS = 3
TRIAL = Termination(decrease=1e-3, iterations=300)
"""Enough if the optimum explains all views; wrong views make the convergence slow."""


def calibrate(dataset: Dataset, options: Options | None = None, noise: StartingNoise | None = None) -> Calibration:
    """Calibrate the sensors of a dataset.

    Args:
        dataset: the labels, and transforms that serve as the initial guess. It is not changed.
        options: options of the calibration.
        noise: noise that is added to the initial guess.

    Raises:
        UndeterminedError: the data do not determine the parameters; the message names what is missing.
        InputError: the labels cannot be used.
    """
    with solvable(dataset.path):
        try:
            return _calibrate_what_is_determined(dataset, options or Options(), noise or StartingNoise())
        except UndeterminedError as error:
            if not dataset.missing_files:
                raise
            missing = "; ".join(map(dataset.missing_files_of, dataset.missing_files))
            raise UndeterminedError(f"{error}; {missing}") from error


def _calibrate_what_is_determined(dataset: Dataset, options: Options, noise: StartingNoise) -> Calibration:
    """Calibrate; if the robot's motion is insufficient for that, calibrate the sensors relative to each other."""
    try:
        return _calibrate(dataset, options, noise)
    except UndeterminedError as error:
        if (relative := _relative(dataset, options, noise)) is None:
            raise
        why = str(error).removeprefix(f"{dataset.path}: ")
        return replace(relative, not_determined=why)


def _relative(dataset: Dataset, options: Options, noise: StartingNoise) -> Calibration | None:
    """Calibrate the sensors that see a fixed pattern together, with the pattern's pose free in each collection.

    Then nothing depends on the motion of the robot between collections, and the poses of the sensors on the robot
    are not determined. None if there are no such sensors, or their relative poses are not determined either.
    """
    fixed = [name for name, pattern in dataset.patterns.items() if pattern.fixed]
    if len(dataset.sensors) < 2 or not fixed or set(fixed) & set(options.hold):
        return None
    patterns = {name: replace(pattern, fixed=False) for name, pattern in dataset.patterns.items()}
    try:
        found = _calibrate(replace(dataset, patterns=patterns), options, noise)
    except InputError:
        return None
    return found if found.converged and found.gauge else None


def _calibrate(dataset: Dataset, options: Options, noise: StartingNoise) -> Calibration:
    started = _started(dataset, options, noise)
    dropped = wrong_views(started.setup, started.linear.values)
    if not dropped:
        return _solved(dataset, started, options)
    if (whole := _explained(dataset, started, options)) is not None:
        return whole
    try:
        rest = _started(without(dataset, dropped), options, noise)
        return replace(_solved(dataset, rest, options), dropped_views=dropped)
    except UndeterminedError as error:
        views = ", ".join(dict.fromkeys(view.collection for view in dropped))
        raise UndeterminedError(f"{error} (left out, as their views contradict the others: {views})") from error


def _explained(dataset: Dataset, started: "_Started", options: Options) -> Calibration | None:
    """Calibrate with all views, if an error of a fixed parameter explains their contradictions; else None."""
    problem, start = started.setup.problem, started.linear
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        scales = estimate_scales(problem, start.values, {}, robust=True)
        trial = minimise(problem, start.values, Weighting(scales, HUBER), TRIAL)
    if not trial.reached:  # other weights would not help, after many iterations
        return None
    try:
        whole = _solved(dataset, replace(started, linear=replace(start, values=trial.values)), options)
    except UndeterminedError:
        return None
    return whole if whole.converged and explains_all(whole.solution.model) else None


@frozen(eq=False)
class _Started:
    """Problem with its initial values."""

    setup: Setup
    exact: Values
    """By the dataset."""
    guess: Values
    """The same with noise."""
    linear: LinearStart


def _started(dataset: Dataset, options: Options, noise: StartingNoise) -> _Started:
    setup = build(dataset, options.hold, options.intrinsics, options.known_intrinsics())
    exact = initial_values(setup)
    guess = perturb(setup, exact, noise)
    return _Started(setup, exact, guess, linear_start(setup, guess))


class _OpenCoefficientsError(UndeterminedError):
    """The labels do not determine some distortion coefficients, which can be fixed."""

    def __init__(self, message: str, hold: Sequence[str]) -> None:
        super().__init__(message)
        self.hold = tuple(dict.fromkeys(hold))
        """By their names, such as "intrinsics-left-k6"."""


def _solved(dataset: Dataset, started: _Started, options: Options) -> Calibration:
    """Calibrate from initial values; distortion coefficients that are not determined are fixed, with a note."""
    try:
        return _solved_for_all(dataset, started, options)
    except _OpenCoefficientsError as error:
        found = _solved(dataset, _holding(started, error.hold), options)
        names = ", ".join(f"'{name}'" for name in error.hold)
        note = f"the labels do not determine {names} beside the others: held at what the dataset says"
        return replace(found, notes=(note, *found.notes))


def _holding(started: _Started, names: Sequence[str]) -> _Started:
    """Return the same initial values with some distortion coefficients fixed at their nominal values."""
    setup, problem = started.setup, started.setup.problem
    blocks = held_blocks(setup.dataset, problem.blocks, names)
    values = list(started.linear.values)
    for i, (before, now) in enumerate(zip(problem.blocks, blocks, strict=True)):
        if before.intrinsics and now.intrinsics and before is not now:
            held = [k for k in before.intrinsics.at if now.held or k not in now.intrinsics.at]
            values[i] = values[i].copy()
            values[i][held] = before.intrinsics.camera.intrinsics[held]
    setup = replace(setup, problem=replace(problem, blocks=blocks))
    return replace(started, setup=setup, linear=replace(started.linear, values=tuple(values)))


def _solved_for_all(dataset: Dataset, started: _Started, options: Options) -> Calibration:
    setup, start = started.setup, started.linear
    robust = options.loss == "huber"
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        if options.start == "linear":
            result, reason = _from_linear_start(setup, start.values, options)
        else:
            # as in ATOM: the patterns' poses are those from the guess without noise
            seen_from_guess = pattern_poses(setup, started.exact)
            patterns = free_patterns(setup)
            values = tuple(seen_from_guess[i] if i in patterns else T for i, T in enumerate(started.guess))
            result = optimise(setup.problem, values, options.known_noise(), robust)
            reason = _false_minimum(setup, result, start.values)
    return _result(dataset, setup, result, reason, start.guessed, options)


def initial_values(setup: Setup) -> Values:
    """Return the transforms of the first collection, and the nominal parameters of joints and intrinsics.

    Patterns have no pose yet, unless they are fixed.
    """
    dataset, joints = setup.dataset, {joint.edge: joint.values for joint in setup.dataset.joints.values()}
    values: list[Array] = []
    for block in setup.problem.blocks:
        pattern = dataset.patterns.get(block.name)
        if block.intrinsics:
            values.append(block.intrinsics.camera.intrinsics)
        elif pattern and (not block.held or pattern.name in setup.gauge_patterns):
            shape = (setup.problem.collections, 4, 4) if block.per_collection else (4, 4)
            values.append(np.broadcast_to(np.eye(4), shape).copy())
        elif block.edge in joints:
            values.append(joints[block.edge])
        elif block.edge:
            T = dataset.transforms[block.edge] if block.per_collection else dataset.transform(*block.edge)[0]
            values.append(T @ translation(pattern.centre) if pattern else T)
    return place_gauge_patterns(setup, tuple(values))


def _from_linear_start(setup: Setup, start: Values, options: Options) -> tuple[WeightedOptimum, str]:
    """Optimise from the linear initial guess, or return the reason of a failure; flipped patterns are corrected."""
    result = optimise(setup.problem, start, options.known_noise(), options.loss == "huber")
    for _ in range(FLIP_ROUNDS):
        if trouble := _not_reached(setup, result):
            return result, trouble
        values, flipped = _unflipped(setup, result)
        if not len(flipped):
            return result, ""
        result = optimise(setup.problem, values, options.known_noise(), options.loss == "huber")
    return result, _trouble(setup, result)


def _unflipped(setup: Setup, result: WeightedOptimum) -> tuple[Values, IntArray]:
    optimum = result.optimum
    values, flipped = unflipped(setup.problem, optimum.values, result.weighting, optimum.equations.cost)
    return values, np.flatnonzero(flipped)


def _not_reached(setup: Setup, result: WeightedOptimum) -> str:
    impossible = np.flatnonzero(~np.isfinite(result.optimum.equations.cost))
    if len(impossible):
        behind = _behind(setup, result.optimum.values)[impossible].any()
        keys = ", ".join(setup.dataset.keys[i] for i in impossible[:5])
        why = "the pattern lies behind a camera" if behind else "labels lie too far off to be compared with the pattern"
        return f"the start is not possible: {why} in {len(impossible)} collections ({keys})"
    if not result.optimum.reached:
        return f"no minimum was reached in {result.optimum.iterations} iterations"
    return ""


def _behind(setup: Setup, values: Values) -> BoolArray:
    """Return a mask (N,) of the collections with a corner behind its camera."""
    behind = np.zeros(setup.problem.collections, bool)
    for group in setup.problem.groups:
        for term in setup.problem.terms(group, values):
            magnitudes = term.magnitudes(setup.problem.poses(group, values))
            behind[group.collections] |= np.count_nonzero(~np.isnan(magnitudes), axis=-1) < term.counts
    return behind


def _trouble(setup: Setup, result: WeightedOptimum) -> str:
    """Return the reason why an optimum is invalid; empty if it is valid."""
    if trouble := _not_reached(setup, result):
        return trouble
    _, flipped = _unflipped(setup, result)
    if len(flipped):
        keys = ", ".join(setup.dataset.keys[i] for i in flipped[:5])
        return f"the pattern is left in its mirrored pose in {len(flipped)} collections ({keys})"
    return ""


def _false_minimum(setup: Setup, result: WeightedOptimum, start: Values) -> str:
    """Return the reason why a result from the given guess is not the optimum: flipped, or worse than the linear one."""
    trouble = _trouble(setup, result)
    if trouble:
        return trouble
    best = minimise(setup.problem, start, result.weighting)
    if best.reached and best.cost < result.optimum.cost * (1 - 1e-6) - 1e-6:
        return f"a false minimum: cost {result.optimum.cost:.6g}, while {best.cost:.6g} can be reached"
    return ""


def _result(
    dataset: Dataset,
    setup: Setup,
    result: WeightedOptimum,
    reason: str,
    guessed: tuple[str, ...],
    options: Options,
) -> Calibration:
    problem, optimum, weighting = setup.problem, result.optimum, result.weighting
    names = [block.name for block in problem.blocks]
    notes = [f"no equation gives '{name}' a linear start; it starts from its guess" for name in guessed]
    notes += [
        f"pattern '{name}' is held where the guess puts it: only poses relative to it can be known"
        for name in setup.gauge_patterns
    ]
    warnings: list[str] = []
    weak: tuple[str, ...] = ()
    by_block: Mapping[int, Array] = {}
    bars: ErrorBars | None = None
    at_optimum = _calibrated(setup, optimum.values, setup.dataset)
    solution = Solution(setup, optimum.values, weighting, at_optimum, options.assume)
    if not reason:
        size = max(pattern.size for pattern in setup.dataset.patterns.values())
        undetermined, weakly = open_directions(problem, optimum.equations, size)
        if undetermined:
            coefficients = [
                f"{names[each.block]}-{name}" for each in undetermined for name in each.coefficients_to_hold()
            ]
            named = "; ".join(direction.describe(names) for direction in undetermined[:3])
            has_names = any(problem.blocks[i].parameters.free for i in problem.shared)
            several = has_names or setup.dataset.additional_transforms
            held = next((name for each in undetermined if (name := each.to_hold(names))), "")
            hold = f", or hold one of them{f', such as {held!r}' if held else ''}" if several else ""
            message = (
                f"{setup.dataset.path}: the labels do not determine {named}; "
                f"add collections with other rotations of the pattern or the robot{hold}"
            )
            raise _OpenCoefficientsError(message, coefficients) if coefficients else UndeterminedError(message)
        weak = tuple(direction.describe(names) for direction in weakly)
        considered = considered_covariance(problem, optimum.values, weighting)
        at = problem.shared_parameters
        poses = [block for block in at if isinstance(problem.blocks[block].parameters, Pose)]
        bars = error_bars(solution.model, at, poses, considered)
        by_block = bars.total
        warnings = contradicted_priors(problem.blocks, optimum.values)
    return Calibration(
        dataset=_calibrated(setup, optimum.values, dataset),
        solution=solution,
        transforms=_transforms(setup, optimum.values),
        covariances=_of_transforms(setup, by_block),
        label_covariances=_of_transforms(setup, bars.labels if bars else {}),
        error_bars=bars,
        converged=not reason,
        reason=reason,
        cost=optimum.cost,
        degrees_of_freedom=problem.residuals - round(sum(result.parameters.values())),
        iterations=optimum.iterations,
        noise_levels=NoiseLevels(**{str(kind): scale for kind, scale in weighting.scales.items()}),
        residuals=_residuals(setup, optimum.values),
        rejected=_rejected(setup, result),
        weak_directions=weak,
        warnings=tuple(warnings),
        notes=(*setup.ignored, *notes),
        gauge=setup.gauge,
        joints=_joints(setup, optimum.values, by_block, bars.labels if bars else {}),
        intrinsics=_intrinsics(setup, optimum.values, by_block),
    )


def _joints(
    setup: Setup, values: Values, covariance: Mapping[int, Array], labels: Mapping[int, Array]
) -> dict[str, CalibratedJoint]:
    """Return the joints with free parameters; covariances by block, empty if it has not converged."""
    joints = {}
    for name, joint in setup.dataset.joints.items():
        i = setup.block(joint.edge)
        block = setup.problem.blocks[i]
        if block.joint and not block.held:
            free = block.joint.free
            joints[name] = CalibratedJoint(
                name=name,
                parameters=free,
                values=values[i][block.joint.at],
                units=tuple(joint.model.unit(parameter) for parameter in free),
                covariance=covariance.get(i, np.full((len(free), len(free)), np.nan)),
                label_covariance=labels.get(i, np.full((len(free), len(free)), np.nan)),
            )
    return joints


def _intrinsics(setup: Setup, values: Values, covariance: Mapping[int, Array]) -> dict[str, CalibratedIntrinsics]:
    """Return the cameras with free intrinsics; ``covariance`` as in `_joints`."""
    found = {}
    for i, block in enumerate(setup.problem.blocks):
        if (intrinsics := block.intrinsics) and not block.held:
            k = len(intrinsics.free)
            found[intrinsics.sensor] = CalibratedIntrinsics(
                model=intrinsics.camera.distortion.ros_name,
                parameters=intrinsics.free,
                values=values[i][intrinsics.at],
                covariance=covariance.get(i, np.full((k, k), np.nan)),
            )
    return found


def _of_transforms(setup: Setup, covariance: Mapping[int, Array]) -> dict[Edge, Array]:
    """Return the covariances of the shared poses; those of patterns in their own frame, not at their centre."""
    blocks = setup.problem.blocks
    found = {
        edge: C for i, C in covariance.items() if isinstance(blocks[i].parameters, Pose) and (edge := blocks[i].edge)
    }
    for name, pattern in setup.dataset.patterns.items():
        if (edge := setup.pattern_edge(name)) in found:
            to_frame = adjoint(translation(pattern.centre))
            found[edge] = to_frame @ found[edge] @ to_frame.T
    return found


def _transforms(setup: Setup, values: Values) -> dict[Edge, Array]:
    """Return the transforms of the shared blocks; those of patterns in their own frame, not at their centre."""
    patterns = {setup.pattern_edge(name): p for name, p in setup.dataset.patterns.items()}
    return {
        edge: value @ inverse(translation(patterns[edge].centre)) if edge in patterns else value
        for block, value in zip(setup.problem.blocks, values, strict=True)
        if (edge := block.edge) and value.ndim == 2
    }


def _calibrated(setup: Setup, values: Values, dataset: Dataset) -> Dataset:
    """Return the whole dataset with the new transforms, joints and intrinsics.

    Moving patterns have a pose where a view of them is used, else NaN; other moving transforms keep their guess there.
    """
    moving = {}
    kept = set(setup.dataset.keys)
    used = np.array([i for i, key in enumerate(dataset.keys) if key in kept])
    for i, block in enumerate(setup.problem.blocks):
        if not block.per_collection or block.held or not block.edge:
            continue
        seen = setup.problem.collections_with(i)
        if pattern := setup.dataset.patterns.get(block.name):
            poses = np.full((len(dataset.collections), 4, 4), np.nan)
            poses[used[seen]] = values[i][seen] @ inverse(translation(pattern.centre))
        else:
            poses = dataset.transforms[block.edge].copy()
            poses[used[seen]] = values[i][seen]
        moving[block.edge] = poses
    joints = {name: values[setup.block(joint.edge)] for name, joint in setup.dataset.joints.items()}
    cameras = {
        block.intrinsics.sensor: block.intrinsics.camera.with_intrinsics(value)
        for block, value in zip(setup.problem.blocks, values, strict=True)
        if block.intrinsics and not block.held
    }
    moved = dataset.with_transforms({**_transforms(setup, values), **moving})
    return moved.with_joints(joints).with_cameras(cameras)


def _residuals(setup: Setup, values: Values) -> tuple[ViewResiduals, ...]:
    keys = setup.dataset.keys
    residuals = []
    for group in setup.problem.groups:
        T = setup.problem.poses(group, values)
        collections = tuple(keys[i] for i in group.collections)
        residuals += [
            ViewResiduals(group.sensor, group.pattern, term.kind, collections, term.magnitudes(T))
            for term in setup.problem.terms(group, values)
        ]
    return tuple(residuals)


def _rejected(setup: Setup, result: WeightedOptimum) -> tuple[RejectedLabel, ...]:
    huber = result.weighting.huber
    if huber is None:
        return ()
    labels = {collection.key: collection.labels for collection in setup.dataset.collections}
    rejected = []
    for r in _residuals(setup, result.optimum.values):
        limit = 2 * huber * result.weighting.scales[r.kind]
        for v, k in zip(*np.nonzero(np.nan_to_num(r.magnitudes) > limit), strict=True):
            view, magnitude = labels[r.collections[v]][r.pattern, r.sensor], float(r.magnitudes[v, k])
            label = int(view.limits[k] if isinstance(view, PointLabels) and r.kind in BORDERS else k)
            rejected.append(RejectedLabel(r.collections[v], r.sensor, r.pattern, r.kind, label, magnitude))
    return tuple(sorted(rejected, key=lambda label: (label.collection, label.sensor, label.label, label.kind)))
