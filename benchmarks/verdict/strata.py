"""Clean scenes in three strata: exact labels, labels of rendered images, good robots with small errors."""

import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Literal, get_args
from zlib import crc32

import numpy as np

from benchmarks.shared_data import ROOT
from benchmarks.verdict.scene import Scene
from calibration.base import InputError
from calibration.base.arrays import Array
from calibration.ci.execution.tasks import single_threaded_opencv
from calibration.engine.dataset.model import CornerLabels, Labels, PointLabels
from calibration.engine.dataset.reading import FILE_NAME, read_dataset
from calibration.engine.dataset.writing import write_document
from calibration.engine.evaluation.truth import TRUTH_FILE, read_truth
from calibration.engine.geometry.frames import JOINT_PARAMETERS
from calibration.engine.geometry.transforms import retract
from calibration.pipeline.configuration import read_configuration
from calibration.pipeline.system import System as Entry
from calibration.robot.simulation.capture import Requirements
from calibration.robot.simulation.dataset_folder import dataset_document, truth_document
from calibration.robot.simulation.kinematics import place, play
from calibration.robot.simulation.motion import Motion
from calibration.robot.simulation.motion_generation import find_candidates, generate_motion
from calibration.robot.simulation.motion_information import expected_dataset
from calibration.robot.simulation.record import collect_pose, kept
from calibration.robot.simulation.scenarios.scenario import Scenario, build_world, scenario_motion
from calibration.robot.simulation.scenarios.scenario_set import read_scenario_set
from calibration.robot.simulation.system import System, read_system

Stratum = Literal["exact", "rendered", "good"]
STRATA: tuple[Stratum, ...] = get_args(Stratum)
PIXEL_NOISE = (0.05, 0.15)
RANGE_NOISE = 0.008
ASSEMBLY = (3.0, 0.7)
"""Standard deviation, each axis, of where a sensor is mounted (mm, degrees)."""
RENDERED_WORLDS = 4
"""Scenes that are rendered of each system: the one that ships, one more in the laboratory, two of scenarios.yml."""
POSES, POSES_EXACT = 16, 20
"""Of a world that is rendered, and of one that is not."""
GOOD_FOCAL, GOOD_CENTRE = 0.0005, 0.3
"""Standard deviations of camera_info: a share, px."""
GOOD_BOW, GOOD_SWAY = 0.0002, 0.0001
"""Standard deviations of the pattern's bow, and of its place between what two sensors see, m."""
GOOD_ARM = (0.00005, 0.0001)
"""Standard deviations of where an arm is, each axis: m, rad."""
GOOD_OUTLIERS, GOOD_OUTLIER = 0.002, 8.0
"""Share of the corners, and how far they are off at most along each axis, px."""


def generator(*what: object) -> np.random.Generator:
    """Random numbers that follow from what they are for, alike in every process."""
    return np.random.default_rng(crc32(repr(what).encode()))


@cache
def entries() -> Mapping[str, Entry]:
    """The systems of the project's own calibration.yml, by name."""
    return {system.name: system for system in read_configuration(ROOT / "calibration.yml").systems}


@cache
def clean(stratum: Stratum, system: str, seed: int) -> Scene:
    """A scene without a defect."""
    if stratum == "rendered":
        return _rendered(system, seed % RENDERED_WORLDS)
    rng = generator(stratum, system, seed)
    scene = _exact(system, seed, rng)
    good = stratum == "good"
    return with_noise(_imperfect(scene, rng) if good else scene, rng, GOOD_OUTLIERS if good else 0.0)


@cache
def without_noise(system: str, seed: int) -> Scene:
    """A scene whose labels are exact to the last digit."""
    return _exact(system, seed, generator("exact", system, seed))


@cache
def _system(name: str) -> System:
    return read_system(entries()[name].dataset)


def at_zero(system: str) -> Mapping[tuple[str, str], Array]:
    """The transforms (4, 4) of a system's description with all joints at zero."""
    return _system(system).nominal.transforms({})


@dataclass(frozen=True)
class Conditions:
    """How a recording was made."""

    collections: int = POSES_EXACT
    distance: float = 1.0
    """Of the pattern from the camera, in times of the usual."""
    noise_px: float | None = None
    """Of the corners; None for a good detector's, which differs between recordings."""
    outliers: float = GOOD_OUTLIERS
    """Share of the corners."""
    at_random: bool = False
    """Whether the poses are as a person takes them, not the best ones."""


USUAL = Conditions()


def recording(
    system: str,
    robot: int,
    seed: int,
    moved: Mapping[str, Array] | None = None,
    conditions: Conditions = USUAL,
    links: bool = False,
) -> Scene:
    """A good robot's recording: lenses, assembly, camera_info and board are the robot's, motion and noise its own.

    Args:
        system: of which it is one.
        robot: its seed.
        seed: of the recording.
        moved: twists (6,) of sensors in their frames, since the robot was built.
        conditions: how it was made.
        links: whether each link of an arm is off from its description, as much as is assumed of a good one.

    Raises:
        InputError: too few poses were found.
    """
    rng = generator("recording", system, robot, seed)
    scene = _exact(system, seed, generator("robot", system, robot), conditions)
    if links:
        scene = _with_wrong_links(scene, generator("links", system, robot))
    for sensor, twist in (moved or {}).items():
        edge = scene.world.sensors[sensor].edge
        world = scene.world.with_transforms({edge: retract(scene.world.transforms[edge], twist)})
        scene = scene.seen_as_in(replace(scene, world=world))
    imperfect = _imperfect(scene, rng, generator("held", system, robot))
    return with_noise(imperfect, rng, conditions.outliers, conditions.noise_px)


def _with_wrong_links(scene: Scene, rng: np.random.Generator) -> Scene:
    calibrated = {joint.edge for joint in scene.told.joints.values()}
    edges = [edge for edge in moving_edges(scene) if edge not in calibrated]
    off = {edge: retract(scene.world.transforms[edge], _twists(rng, 1, *GOOD_ARM)) for edge in edges}
    return scene.seen_as_in(replace(scene, world=scene.world.with_transforms(off)))


def _motion(system: System, seed: int, conditions: Conditions) -> Motion:
    if conditions.distance != 1:
        least, most = (conditions.distance * each for each in system.motion.distance or ())
        system = replace(system, motion=replace(system.motion, distance=(least, most)))
    if not conditions.at_random:
        return generate_motion(system, conditions.collections, seed)
    candidates = find_candidates(system, conditions.collections, seed)
    if len(candidates) < conditions.collections:
        raise InputError(f"{system.name}: found {len(candidates)} poses, expected {conditions.collections}")
    order = generator("poses", system.name, seed).permutation(len(candidates))
    return candidates.motion.take(sorted(order[: conditions.collections].tolist()))


def _exact(name: str, seed: int, rng: np.random.Generator, conditions: Conditions = USUAL) -> Scene:
    """Exact labels of a motion, with lenses and an assembly of its own."""
    system = _system(name)
    scenario = Scenario(1, seed, _values(system, rng))
    built = build_world(system, scenario)
    placement = place(built, _motion(built, 1 + seed, conditions))
    world = expected_dataset(built, placement)
    described = {sensor.edge: system.nominal.transforms({})[sensor.edge] for sensor in world.sensors.values()}
    told = world.with_transforms(described)
    told = told.with_joints({key: system.nominal.movable[key].values() for key in told.joints})
    pattern = next(iter(world.patterns.values()))
    if not pattern.fixed:
        world = world.with_transforms({(pattern.parent_link, pattern.link): placement.patterns[pattern.name]})
    return Scene(entries()[name], told, world)


def _values(system: System, rng: np.random.Generator) -> dict[str, float]:
    """A lens of each camera, and where each sensor that is not anchored is mounted."""
    values: dict[str, float] = {}
    for name in system.cameras:
        values |= {f"{name}.k1": rng.uniform(-0.1, 0.1), f"{name}.k2": rng.uniform(-0.03, 0.03)}
    for name in system.sensors:
        if name != system.configuration.anchored_sensor:
            for axis in "xyz":
                values[f"{name}.translation_{axis}_mm"] = rng.normal(0, ASSEMBLY[0])
                values[f"{name}.rotation_{axis}_deg"] = rng.normal(0, ASSEMBLY[1])
    return values


def _imperfect(scene: Scene, rng: np.random.Generator, held: np.random.Generator | None = None) -> Scene:
    """The scene with what every good robot has, the labels without noise; ``held`` draws what stays of a robot."""
    held = held or rng
    world, n = scene.world, len(scene.world.collections)
    arm = [edge for edge in moving_edges(scene) if edge not in world.moving_transforms][-1:]
    shaken = {edge: retract(world.transforms[edge], _twists(rng, n, *GOOD_ARM)) for edge in arm}
    other = replace(scene, world=world.with_transforms(shaken), shape=(*held.normal(0, GOOD_BOW, 2).tolist(), 0.0))
    if not scene.pattern.fixed:
        other = replace(other, seen={s: swayed(other.pose(s), GOOD_SWAY, rng) for s in world.sensors})
    imperfect = replace(scene.seen_as_in(other), world=world, seen={}, shape=other.shape)
    cameras = {}
    for name in scene.cameras:
        camera = imperfect.told.sensors[name].camera
        assert camera
        focal = 1 + held.normal(0, GOOD_FOCAL)
        cx, cy = held.normal(0, GOOD_CENTRE, 2).tolist()
        cameras[name] = replace(
            camera, fx=camera.fx * focal, fy=camera.fy * focal, cx=camera.cx + cx, cy=camera.cy + cy
        )
    return replace(imperfect, told=imperfect.told.with_cameras(cameras))


def swayed(T_sensor_pattern: Array, sigma: float, rng: np.random.Generator) -> Array:
    """The poses (N, 4, 4) with the pattern a little elsewhere in each."""
    shift = np.zeros((len(T_sensor_pattern), 6))
    shift[:, :3] = rng.normal(0, sigma, (len(shift), 3))
    return retract(T_sensor_pattern, shift)


def _twists(rng: np.random.Generator, n: int, length: float, angle: float) -> Array:
    return np.concatenate([rng.normal(0, length, (n, 3)), rng.normal(0, angle, (n, 3))], axis=1)


def moving_edges(scene: Scene) -> list[tuple[str, str]]:
    """The transforms on the way from a sensor to the pattern that differ between collections: a robot's joints."""
    world, pattern = scene.world, scene.pattern
    found = []
    for sensor in world.sensors.values():
        for step in world.tree.path(sensor.frame, pattern.link):
            edge = (step.parent, step.child)
            T = world.transforms[edge]
            if edge != (pattern.parent_link, pattern.link) and np.abs(T - T[0]).max() > 1e-9:
                found.append(edge)
    return [e for e in dict.fromkeys(found) if not world.moving_transforms]


def with_noise(scene: Scene, rng: np.random.Generator, outliers: float, noise_px: float | None = None) -> Scene:
    """The scene with noise of its labels: of a good detector, or so many pixels; and a share of outliers."""
    sigma = rng.uniform(*PIXEL_NOISE) if noise_px is None else noise_px

    def noisy(_: int, __: str, labels: Labels) -> Labels:
        if isinstance(labels, PointLabels):
            ranges = np.linalg.norm(labels.points, axis=-1)
            error = RANGE_NOISE * rng.normal(size=len(ranges))
            return replace(labels, points=labels.points * (1 + error / ranges)[:, None])
        pixels = labels.pixels + sigma * rng.normal(size=labels.pixels.shape)
        if outliers:
            wrong = rng.random(len(pixels)) < outliers
            pixels = pixels + wrong[:, None] * rng.uniform(-GOOD_OUTLIER, GOOD_OUTLIER, pixels.shape)
        return CornerLabels(labels.ids, pixels)

    return scene.labelled(noisy)


def _rendered(name: str, number: int) -> Scene:
    folder = entries()[name].dataset if number == 0 else _collected(name, number)
    told = read_dataset(folder)
    true = read_truth(folder / TRUTH_FILE)
    keys = [true.patterns[key] for key in told.keys]
    moving = {edge: np.stack([poses[edge] for poses in keys]) for edge in keys[0]}
    pattern = next(iter(told.patterns.values()))
    n = len(told.collections)
    fixed = {edge: np.broadcast_to(T, (n, 4, 4)) for edge, T in true.transforms.items()}
    values = {}
    for joint_name, joint in told.joints.items():
        names = true.joints[joint_name]
        values[joint_name] = np.array([names.get(p, v) for p, v in zip(JOINT_PARAMETERS, joint.values, strict=True)])
    world = told.with_joints(values)
    if pattern.parent_link != told.world and pattern.fixed:
        moving = {edge: T for edge, T in moving.items() if edge[1] != pattern.link}
    world = world.with_transforms({**fixed, **moving})
    return Scene(entries()[name], told, world)


def _collected(name: str, number: int) -> Path:
    """The folder of a world of our own, collected once: one of the laboratory, then of scenarios.yml."""
    folder = ROOT / "build" / "verdict" / f"{name}-{number}"
    if (folder / FILE_NAME).exists():
        return folder
    system = _system(name)
    for attempt in range(20):
        try:
            if number == 1:
                played = play(system, generate_motion(system, POSES, 100 + attempt), 100 + attempt)
            else:
                worlds = read_scenario_set(ROOT / "datasets" / "scenarios.yml", system)
                scenario = worlds.scenario(1, 20 * number + attempt)
                world = build_world(system, scenario)
                played = play(world, scenario_motion(world, scenario), scenario.collection_seed)
        except InputError:
            continue
        with tempfile.TemporaryDirectory(dir=_made(folder.parent)) as temporary, single_threaded_opencv():
            own = Path(temporary) / name
            own.mkdir()
            records = []
            for pose in range(len(played)):
                record, files = collect_pose(played, pose, Requirements(), images=False)
                records.append(record)
                for file, content in files.items():
                    (own / file).write_bytes(content)
            if len(kept(records)) < 8:
                continue
            write_document(truth_document(played, kept(records)), own / TRUTH_FILE)
            write_document(dataset_document(played.system, kept(records)), own / FILE_NAME)
            own.rename(folder)
        return folder
    raise InputError(f"{name}: no world with 8 collections in 20 attempts")


def _made(folder: Path) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    return folder
