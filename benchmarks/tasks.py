"""Errors of robots where they work, against what is stated of them.

A robot has usual errors: what is held is off as is assumed (`Assumptions`: lenses, boards, links of arms, ranges), and
its labels have noise. It carries out its tasks with its calibration, and is off by as much as that makes: all of it
without linearisation.
"""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from benchmarks.rows import Bar, Row
from benchmarks.scenes import rig
from benchmarks.shared_data import load, missing
from benchmarks.timing import interleaved
from benchmarks.verdict.case import BY_NAME, Case, Colour, colour_of, fits_as_well, judged, with_nothing_set
from benchmarks.verdict.catalogue import cases
from benchmarks.verdict.kind import ALL
from benchmarks.verdict.recordings import ARM, NO_ARM, PAPER, real_arm
from benchmarks.verdict.scene import Scene
from benchmarks.verdict.strata import clean, generator, moving_edges, with_noise, without_noise
from benchmarks.verdict.unforeseen import UNFORESEEN
from benchmarks.workers import on_all_cores
from calibration.base import CalibrationError
from calibration.base.arrays import Array
from calibration.engine.dataset.model import Dataset, Edge, Labels, PointLabels
from calibration.engine.diagnosis.robot_tasks import BY_RECORDING
from calibration.engine.estimation.calibrate import calibrate
from calibration.engine.estimation.covariance.error_bars import SourceKind
from calibration.engine.estimation.covariance.fixed_inputs import STILL_TOLERANCE
from calibration.engine.estimation.covariance.lens_errors import lens_errors
from calibration.engine.estimation.covariance.result import Calibration
from calibration.engine.estimation.least_squares.noise_levels import NoiseLevels
from calibration.engine.estimation.options import Assumptions, Options
from calibration.engine.geometry.transforms import apply, inverse, retract, translation
from calibration.engine.statistics import quantile_of_norm
from calibration.engine.tasks.placed_task import UNIT_PER_SI
from calibration.engine.tasks.robot_task import Box, RobotTask
from calibration.engine.tasks.task_errors import MOST, TaskError, errors_of_robot, task_errors

ROBOTS, ROBOTS_OF_PARTS = 200, 20
"""Of each system: whose tasks are counted, and that are calibrated again without each cause. 1000 robots in all."""
HALVES = 100
"""Times that a recording of others is cut into two halves."""
WORLDS = 4
"""Recordings of each system that its robots share but for their errors."""
NOISE = NoiseLevels(pixel=0.1, range=0.008)
ASSUMED = replace(Assumptions(), border=0.0)
"""As is usual; but the border of a board, which these labels have exact."""
SEEDS_OF_VERDICTS = 6
"""Of each kind of defect, as many cases."""
TASKS: Mapping[str, tuple[RobotTask, ...]] = {
    "t2rgb": (
        RobotTask("depth", seen_by=("left_camera", "right_camera"), distance=3.0),
        RobotTask("in the other image", seen_by=("left_camera",), image="right_camera", distance=3.0),
        RobotTask("near", seen_by=("left_camera", "right_camera"), box=Box((-0.1, -0.1, 0.8), (0.1, 0.1, 1.2))),
        RobotTask(
            "direction",
            seen_by=("left_camera",),
            frame="camera_right_rgb_optical_frame",
            points=((0.0, 0.0, 4.0),),
            limit_deg=1.0,
        ),
    ),
    "rlbot": (
        RobotTask("far in the image", seen_by=("lidar_right",), image="rgb_left", distance=20.0),
        RobotTask("near in the image", seen_by=("lidar_right",), image="rgb_left", distance=4.0),
        RobotTask(
            "obstacle", seen_by=("lidar_right",), frame="rgb_left_optical_frame", box=Box((-1, -0.5, 4), (1, 0.5, 8))
        ),
        RobotTask("camera in the cloud", seen_by=("rgb_left",), frame="lidar_right", distance=5.0),
    ),
    "riwbot": (
        RobotTask("grasp", seen_by=("rgb_world",), frame="base_link", distance=1.2),
        RobotTask("in the hand", seen_by=("rgb_world",), frame="flange", distance=1.0),
        RobotTask("on the table", seen_by=("rgb_world",), plane="base_link", points=((0.5, 0.0, 0.0), (0.6, 0.2, 0.0))),
        RobotTask("tool in the image", of="flange", image="rgb_world", points=((0.0, 0.0, 0.1),)),
    ),
    "softbot": (
        RobotTask("far in the image", seen_by=("lidar3d",), image="front_left_camera", distance=20.0),
        RobotTask("depth", seen_by=("front_left_camera", "front_right_camera"), distance=3.0),
        RobotTask("on the ground", seen_by=("front_right_camera",), plane="base_footprint", points=((2.5, 0.0, 0.0),)),
        RobotTask("heading", seen_by=("lidar3d",), frame="base_footprint", points=((10.0, 0.0, 0.5),), limit_deg=1.0),
    ),
    "spjbot": (
        RobotTask("grasp", seen_by=("rgb_hand",), frame="end_effector_link", distance=0.6),
        RobotTask("over the base", seen_by=("rgb_hand",), frame="base_link", distance=0.6),
        RobotTask("tip", of="end_effector_link", frame="base_link", box=Box((-0.05, 0, 0.1), (0.05, 0, 0.2))),
        RobotTask("on the board", seen_by=("rgb_hand",), plane="pattern_link", points=((0.3, 0.2, 0.0),)),
    ),
}
HARM_OF_DEFECT = 0.5
"""Share of a limit by which a defect makes a task worse than its robot's own small errors, to be what is harmful."""
PARTS: tuple[SourceKind, ...] = ("labels", "lens", "board", "arm", "ranges")


@dataclass(frozen=True, eq=False)
class Carried:
    """A task that a robot has carried out."""

    stated: TaskError
    errors: Array
    """(n, m): how far off it was, in the task's unit."""
    drawn: Mapping[str, Array]
    """By source of error, its draws: what the robot takes for true less what is, in standard deviations."""

    def expected(self, kind: SourceKind) -> Array:
        """(n, m): how far off it would be, to first order, by what was drawn of one kind of source."""
        moves = [each.columns @ self.drawn[each.name] for each in self.stated.sources if each.name in self.drawn]
        kinds = [each.kind for each in self.stated.sources if each.name in self.drawn]
        return np.asarray(self.stated.jacobian @ sum(d for d, of in zip(moves, kinds, strict=True) if of == kind))

    def by_point(self, values: Array) -> Array:
        """Return values (n, m) by pose and number of the point, (V, P, m); NaN where no sensor sees it."""
        out = np.full((*self.stated.placed.seen.shape, values.shape[-1]), np.nan)
        out[self.stated.placed.at] = values
        return out

    @property
    def sizes(self) -> Array:
        """(n,)."""
        return np.asarray(np.linalg.norm(self.errors, axis=1))


def measure(quick: bool) -> Iterator[Row]:
    """Coverage, parts, time, and verdicts with limits on tasks."""
    yield from _coverage(10 if quick else ROBOTS)
    yield from _halves(10 if quick else HALVES)
    yield from _parts(4 if quick else ROBOTS_OF_PARTS)
    yield from _time(3 if quick else 15)
    yield from _verdicts(quick)


def robot(system: str, number: int, without: Collection[SourceKind] = ()) -> dict[str, Carried]:
    """The tasks of a robot with usual errors, but for those of some kinds; the others are the same ones."""
    scene = without_noise(system, number % WORLDS)
    told, world = scene.told, scene.world

    def drawn(kind: SourceKind, *shape: int) -> Array:
        normal = generator("task", system, number, kind).normal(size=shape)
        return 0.0 * normal if kind in without else normal

    edges = moving_edges(scene)
    twists = drawn("arm", len(edges), 6) * ([ASSUMED.arm_translation] * 3 + [ASSUMED.arm_rotation] * 3)
    moved = {e: retract(world.transforms[e], twist) for e, twist in zip(edges, twists, strict=True)}
    size, stretch, *bent = drawn("board", 5) * (
        ASSUMED.pattern_size,
        ASSUMED.pattern_stretch,
        *(ASSUMED.flatness,) * 3,
    )
    pattern = scene.pattern
    factors = 1 + size + np.array([stretch / 2, -stretch / 2, 0.0])
    inside = np.ptp(pattern.corners[:, :2], axis=0) / np.ptp(pattern.outline, axis=0)  # of the board, by its corners
    along_x, along_y, twist = np.array(bent) * (*(inside**2), inside.prod())
    printed = replace(pattern, corners=pattern.centre + (pattern.corners - pattern.centre) * factors)
    other = replace(world.with_transforms(moved), patterns={pattern.name: printed})
    scene = scene.seen_as_in(replace(scene, world=other, shape=(-along_x, -along_y, twist)))
    lenses = drawn("lens", len(told.sensors), 40)
    cameras = {}
    for name, z in zip(told.sensors, lenses, strict=True):
        if (camera := told.sensors[name].camera) is not None:
            errors = lens_errors(camera, ASSUMED, None)
            off = dict(zip(errors.parameters, errors.root @ z[: errors.root.shape[1]], strict=True))
            cameras[name] = camera.with_intrinsics(
                camera.intrinsics + np.array([off.get(each, 0.0) for each in camera.parameters])
            )
    ranges = drawn("ranges", len(told.sensors), 3) * (ASSUMED.range_bias, ASSUMED.range_scale, ASSUMED.beam_elevation)
    off_ranges = dict(zip(told.sensors, ranges, strict=True))

    def ranged(i: int, sensor: str, labels: Labels) -> Labels:
        if isinstance(labels, PointLabels):
            T = scene.pose(sensor)[i] @ translation(pattern.centre)
            points = apply(T, apply(inverse(T), labels.points) * factors)  # the border is as large as the print
            return replace(labels, points=points + _range_errors(points, off_ranges[sensor]))
        return labels

    scene = scene.labelled(ranged)
    if "labels" not in without:
        scene = with_noise(scene, generator("task noise", system, number), 0.0, NOISE.pixel)
    options = Options(assume=ASSUMED, noise_levels=NOISE, loss="linear")
    found = calibrate(scene.told.with_cameras(cameras), options)
    carried, draws = {}, _draws(scene, edges, twists, (size, stretch, *bent), lenses, ranges)
    for error in task_errors(found, TASKS[system]):
        placed, unit = error.placed, UNIT_PER_SI[error.task.unit]
        measured = None
        if error.task.seen_by and not world.sensors[error.task.seen_by[0]].modality.has_corners:
            sensor = world.sensors[error.task.seen_by[0]]
            T = other.transform(sensor.frame, placed.frame, placed.collections)[placed.at[0]]
            points = np.einsum("nij,nj->ni", T[:, :3, :3], placed.places) + T[:, :3, 3]
            measured = _range_errors(points, off_ranges[sensor.name])
        with np.errstate(all="ignore"):
            carried[error.task.name] = Carried(
                error, unit * errors_of_robot(placed, other, found.dataset, measured), draws
            )
    return carried


def _draws(
    scene: Scene, edges: list[Edge], twists: Array, board: tuple[float, ...], lenses: Array, ranges: Array
) -> dict[str, Array]:
    """By name of the source of error, what was drawn of it, in standard deviations."""
    pattern, a = scene.pattern.name, ASSUMED
    size, stretch, along_x, along_y, twist = board
    of_link = np.array([a.arm_translation] * 3 + [a.arm_rotation] * 3)
    drawn = {f"link of {'-'.join(edge)}": -twist / of_link for edge, twist in zip(edges, twists, strict=True)}
    drawn |= {
        f"size of {pattern}": np.array([-size / a.pattern_size]),
        f"stretch of {pattern}": np.array([-stretch / a.pattern_stretch]),
        f"bow of {pattern}": np.array([-along_x, -along_y]) / a.flatness,
        f"twist of {pattern}": np.array([-twist / a.flatness]),
    }
    for sensor, z, off in zip(scene.told.sensors.values(), lenses, ranges, strict=True):
        if sensor.camera is not None:
            drawn[f"camera_info of {sensor.name}"] = z[: lens_errors(sensor.camera, a, None).root.shape[1]]
        of_ranges = (a.range_bias, a.range_scale, a.beam_elevation)
        for what, value, sigma in zip(("range bias", "range scale", "beam elevation"), off, of_ranges, strict=True):
            drawn[f"{what} of {sensor.name}"] = np.array([-value / sigma])
    return drawn


def _range_errors(points: Array, off: Array) -> Array:
    """By how much (n, 3) a LiDAR measures points (n, 3) elsewhere: ranges too long, beams lower than it believes."""
    bias, scale, elevation = off
    far, flat = np.linalg.norm(points, axis=-1, keepdims=True), np.hypot(points[:, 0], points[:, 1])
    lower = np.stack([points[:, 0] * points[:, 2] / flat, points[:, 1] * points[:, 2] / flat, -flat], -1)
    return np.asarray(points * (bias / far + scale) + elevation * lower)


def _covered(of: tuple[str, int]) -> list[tuple[str, str, float, float]]:
    """System, task, share of its points within the 95 % and within the median."""
    found = []
    for name, each in robot(*of).items():
        sizes, ok = each.sizes, np.isfinite(each.sizes)
        shares = [float((sizes <= bound)[ok].mean()) for bound in (each.stated.most, each.stated.median)]
        found.append((of[0], name, shares[0], shares[1]))
    return found


def _coverage(robots: int) -> Iterator[Row]:
    rows = [row for each in on_all_cores(_covered, [(s, k) for s in ALL for k in range(robots)]) for row in each]
    of_robots = np.array([row[2] for row in rows]).reshape(robots * len(ALL), -1).mean(1)
    sure = 100 * 1.96 * of_robots.std() / np.sqrt(len(of_robots))
    note = f"± {sure:.1f} (95 %); {len(rows)} tasks of {len(of_robots)} robots with usual errors, all points of each"
    yield Row("tasks/within 95 %", 100 * float(np.mean([row[2] for row in rows])), "%", Bar(93, 97), note)
    note = "50 % and more: what is held makes collections disagree, and counts by both"
    yield Row("tasks/within the median", 100 * float(np.mean([row[3] for row in rows])), "%", Bar(45, 65), note)
    for system in ALL:
        own = [row for row in rows if row[0] == system]
        each = {name: [row[2] for row in own if row[1] == name] for name in dict.fromkeys(row[1] for row in own)}
        said = ", ".join(f"{name} {100 * np.mean(shares):.1f}" for name, shares in each.items())
        yield Row(f"tasks/within 95 %, {system}", 100 * float(np.mean([row[2] for row in own])), "%", None, said)


TASKS_OF_ARM = (
    RobotTask("grasp", seen_by=("camera",), frame="base", distance=1.0),
    RobotTask("direction", seen_by=("camera",), frame="base", distance=2.0, limit_deg=1.0),
    RobotTask("point in the image", of="base", image="camera", distance=1.0),
)
"""Of the photographs of an arm: between frames that do not move."""


def _halves(cuts: int) -> Iterator[Row]:
    """How often one half of a recording of others predicts what the other half says, within what both state."""
    for name, tasks, reason in (
        (PAPER, TASKS["t2rgb"], missing(PAPER)),
        ("real-arm", TASKS_OF_ARM, "" if ARM.is_dir() else NO_ARM),
    ):
        row = f"tasks/halves of {name} within 95 %"
        if reason:
            yield Row(row, skipped=reason)
            continue
        shares = np.concatenate(on_all_cores(_within_other_half, [(name, tasks, number) for number in range(cuts)]))
        each = ", ".join(f"{task.name} {100 * share:.0f}" for task, share in zip(tasks, shares.mean(0), strict=True))
        yield Row(row, 100 * float(shares.mean()), "%", Bar(90, 98), f"{len(shares)} cuts into two halves; {each}")


def _within_other_half(of: tuple[str, tuple[RobotTask, ...], int]) -> Array:
    """The shares (1, tasks) of points at which two halves of a recording agree; none if one does not calibrate."""
    name, tasks, number = of
    whole = real_arm() if name == "real-arm" else load(name)
    order = generator("halves", name, number).permutation(len(whole.collections)).tolist()
    middle = len(order) // 2
    try:
        one, other = (calibrate(whole.with_collections(sorted(half))) for half in (order[:middle], order[middle:]))
        errors = [task_errors(each, tasks) for each in (one, other)]
    except CalibrationError:
        return np.zeros((0, len(tasks)))
    shares = []
    for mine, its in zip(*errors, strict=True):
        off = UNIT_PER_SI[mine.task.unit] * np.linalg.norm(
            errors_of_robot(mine.placed, other.dataset, one.dataset), axis=1
        )
        apart = _covariance_of_difference(mine, its)
        known = np.isfinite(apart).all((1, 2)) & np.isfinite(off)
        shares.append(float((off[known] <= quantile_of_norm(apart[known], MOST)).mean()))
    return np.array([shares])


def _covariance_of_difference(mine: TaskError, its: TaskError) -> Array:
    """Covariance (n, m, m) of what two calibrations make of a task; NaN where the second one does not see a point.

    What is held errs alike in both, and differs by how each takes it up; the rest is independent.
    """
    jacobian = np.full((*its.placed.seen.shape, *its.jacobian.shape[1:]), np.nan)
    jacobian[its.placed.at] = its.jacobian
    other = {each.name: jacobian[mine.placed.at] @ each.columns for each in its.sources}
    covariance = np.zeros((len(mine.jacobian), mine.jacobian.shape[1], mine.jacobian.shape[1]))
    for each in mine.sources:
        moved = mine.jacobian @ each.columns
        independent = each.kind in BY_RECORDING
        parts = (moved, other[each.name]) if independent else (moved - other[each.name],)
        covariance += sum(part @ np.swapaxes(part, 1, 2) for part in parts)
    return covariance


def _squares_by_part(of: tuple[str, int]) -> list[tuple[SourceKind, float, float, float]]:
    """By task and kind of source: by how much switching it off changes the error, and how much that should be.

    Both are mean squares, over that of the whole; what should be is what was drawn, to first order. Of the labels it is
    what is stated, and what is compared with it the error that is left where all else is switched off: what the ends of
    a scan line miss of a border is no noise that could be. And how far the sum of all parts is from the whole.
    """
    whole = robot(*of)
    found: list[tuple[SourceKind, float, float, float]] = []
    for kind in PARTS:
        rest = robot(*of, without=[each for each in PARTS if each != kind] if kind == "labels" else [kind])
        for name, each in whole.items():
            total = float(np.einsum("nii->n", each.stated.covariance).mean())
            stated = float(sum(each.stated.variances[s.name].mean() for s in each.stated.sources if s.kind == kind))
            summed = float(sum(each.stated.variances[s.name].mean() for s in each.stated.sources))
            if stated <= 1e-3 * total:
                continue
            left = rest[name].by_point(rest[name].errors)
            changed = left if kind == "labels" else each.by_point(each.errors) - left
            both = np.isfinite(changed).all(-1)
            expected = (
                stated if kind == "labels" else float((each.by_point(each.expected(kind))[both] ** 2).sum(-1).mean())
            )
            found.append((kind, float((changed[both] ** 2).sum(-1).mean()) / total, expected / total, summed / total))
    return found


def _parts(robots: int) -> Iterator[Row]:
    rows = [r for each in on_all_cores(_squares_by_part, [(s, k) for s in ALL for k in range(robots)]) for r in each]
    worst = max(abs(row[3] - 1) for row in rows)
    yield Row("tasks/sum of parts", 100 * worst, "% off", Bar(high=2), f"the worst of {len(rows)}")
    for kind in PARTS:
        own = [row for row in rows if row[0] == kind]
        ratio = float(np.sqrt(sum(row[1] for row in own) / sum(row[2] for row in own)))
        of = "stated" if kind == "labels" else "what was drawn of it, to first order"
        by = "what is left where all else is switched off" if kind == "labels" else "what switching it off changes"
        note = f"{by}, over {of}: {len(own)} tasks in which it is more than a thousandth"
        yield Row(f"tasks/part of {kind}", ratio, "", Bar(0.9, 1.1), note)


def _time(rounds: int) -> Iterator[Row]:
    for count in (20, 2000):
        dataset, _ = rig(count, seed=1)
        names = list(dataset.sensors)[:2]
        tasks = [
            RobotTask("depth", seen_by=tuple(names), distance=3.0),
            RobotTask("image", seen_by=(names[0],), image=names[1], distance=3.0),
            RobotTask("box", seen_by=tuple(names), box=Box((-0.2, -0.2, 1.5), (0.2, 0.2, 2.5))),
            RobotTask("mount", seen_by=(names[1],), frame=dataset.sensors[names[0]].frame, distance=3.0),
        ]
        found = calibrate(dataset)

        def work() -> None:
            for each in task_errors(found, tasks):  # noqa: B023
                each.parts()

        times = interleaved({"tasks": work, "calibrate": lambda: calibrate(dataset)}, rounds)  # noqa: B023
        took, calibration = map(min, times.values())
        note = f"four tasks beside a calibration of {1e3 * calibration:.0f} ms; the fastest of {rounds} rounds"
        yield Row(f"tasks/time, N={count}", 1e3 * took, "ms", Bar(high=50), note)
        yield Row(f"tasks/share of a calibration, N={count}", took / calibration, "", Bar(high=0.5), note)


@cache
def limited(system: str, seed: int) -> tuple[RobotTask, ...]:
    """The tasks of a system, each with a limit that a good robot keeps: one and a half times its 95 %."""
    scene = with_nothing_set(clean("good", system, seed))
    found = []
    for error in task_errors(calibrate(scene.told, scene.system.options), TASKS[system]):
        limit = 1.5 * float(error.most.max())
        key = {"mm": "limit_mm", "px": "limit_px", "deg": "limit_deg"}[error.task.unit]
        found.append(replace(error.task, **{key: limit}))
    return tuple(found)


@dataclass(frozen=True)
class JudgedTasks:
    """Verdict on a case by the limits of its tasks, and its harm to them."""

    case: Case
    share: float
    """Largest error of a task against the truth, in limits."""
    clean_share: float
    """The same of the robot without the defect."""
    colour: Colour
    reason: str

    @property
    def is_harmful(self) -> bool:
        """Whether the defect makes a task worse than its limit: by more than its robot's own small errors do."""
        return self.share > 1 and self.share - self.clean_share > HARM_OF_DEFECT

    @property
    def must_be_green(self) -> bool:
        """Whether no task is beyond its limit, and no sensor was moved."""
        return self.share <= 1 and not BY_NAME[self.case.kind].displaces


def judged_tasks(case: Case) -> JudgedTasks | None:
    """Judge a case by the limits of its tasks; None if nothing can be compared, or no data could tell."""
    planted = BY_NAME[case.kind]
    if case.system in planted.memory or planted.spoils or planted.sizes[case.size] in planted.wanted:
        return None
    if planted.group == "LiDAR":  # at work it errs as in the recording, which cancels, and is not simulated
        return None
    tasks, scene = limited(case.system, case.seed), with_nothing_set(case.scene())
    with np.errstate(all="ignore"):
        result, _, found = judged(replace(scene, system=replace(scene.system, tasks=tasks)))
        share = np.inf
        if found is not None and found.converged:
            if fits_as_well(case, scene):
                return None
            try:
                share = _share_of_limits(tasks, scene, found)
            except np.linalg.LinAlgError:  # it points to where no camera sees anything
                pass
            except CalibrationError:
                return None
    reason = result.reasons[0] if result.reasons else ""
    return JudgedTasks(case, share, _clean_share(case.system, case.seed), colour_of(result), reason)


@cache
def _clean_share(system: str, seed: int) -> float:
    scene = with_nothing_set(clean("good", system, seed))
    return _share_of_limits(limited(system, seed), scene, calibrate(scene.told, scene.system.options))


def _share_of_limits(tasks: Sequence[RobotTask], scene: Scene, found: Calibration) -> float:
    world = _at_the_end(scene)

    def share(error: TaskError) -> float:
        off = np.linalg.norm(errors_of_robot(error.placed, world, found.dataset), axis=1)
        return UNIT_PER_SI[error.task.unit] * float(np.nanmax(off)) / float(error.task.limit or np.inf)

    return max(map(share, task_errors(found, tasks)))


def _at_the_end(scene: Scene) -> Dataset:
    """The world as it is at the end of the recording, where the robot works; what the user knows to move, moves.

    The plane z = 0 of a bent board is where its border is, not its outer corners, as in the scene.
    """
    still = [edge for edge, T in scene.told.transforms.items() if np.ptp(T, axis=0).max() < STILL_TOLERANCE]
    world = scene.world.with_transforms({edge: scene.world.transforms[edge][-1] for edge in still})
    board = scene.pattern
    inside = np.ptp(board.corners[:, :2], axis=0) / np.ptp(board.outline, axis=0)
    height = float(np.array(scene.shape[:2]) @ (1 - inside**-2))
    return world.with_transforms({board.edge: world.transforms[board.edge] @ translation(np.array([0.0, 0.0, height]))})


def _verdicts(quick: bool) -> Iterator[Row]:
    names = [kind.name for kind in UNFORESEEN]
    names += [name for name in BY_NAME if name not in names]
    some = list(cases(names, ALL, ("good",), range(1 if quick else SEEDS_OF_VERDICTS), quick=True))
    found = [each for each in on_all_cores(judged_tasks, some) if each]
    harmless, harmful = [each for each in found if each.must_be_green], [each for each in found if each.is_harmful]
    red = [each for each in harmless if each.colour == "red"]
    said = "; ".join(f"{each.case.kind}: {each.reason[:80]}" for each in red[:3])
    undecided = [sum(each.colour == "undecided" for each in of) for of in (harmless, harmful)]
    note = f"{len(harmless)} cases, {undecided[0]} undecided; {said}"
    yield Row("tasks/harmless, red", 100 * len(red) / max(1, len(harmless)), "%", Bar(high=3), note)
    seen = [each for each in harmful if each.colour == "red"]
    green = [each.case.kind for each in harmful if each.colour == "green"]
    note = f"{len(harmful)} cases, {undecided[1]} undecided, green: {', '.join(green[:8])}"
    yield Row("tasks/harmful, red", 100 * len(seen) / max(1, len(harmful)), "%", Bar(low=99), note)
