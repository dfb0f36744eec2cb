"""Fixed parameters that may be wrong: intrinsics, the pattern's shape, a LiDAR's errors, an arm's links.

Each is a *cause*: a few parameters with a common error, the derivatives of the labels with respect to them
(columns), and their assumed standard deviations (`calibration.engine.estimation.options`).
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from typing import Literal

import numpy as np

from calibration.base.arrays import Array, IntArray
from calibration.engine.dataset.model import Dataset, Edge, Sensor
from calibration.engine.dataset.pattern import Pattern
from calibration.engine.estimation.covariance.lens_errors import LensErrors, LensSource
from calibration.engine.estimation.least_squares.label_columns import COLUMNS_OF_SHUTTER, ColumnNames, ring_column
from calibration.engine.estimation.options import Assumptions
from calibration.engine.estimation.residuals.corner_residuals import ERRORS_BEYOND_LENS_MODEL
from calibration.engine.estimation.residuals.ray_residuals import RING_GAP, RangeTerm, elevations
from calibration.engine.estimation.residuals.views import ViewGroup
from calibration.engine.geometry import rotations
from calibration.engine.geometry.cameras import Camera
from calibration.engine.geometry.frames import Step
from calibration.engine.geometry.lenses import Distortion
from calibration.engine.geometry.transforms import adjoint, inverse, local, translation

Unit = Literal["m", "rad", "px", "1", "s", "collections"]
SKEW_SIGMA = 0.0002
"""Standard deviation of the skew of a camera's axes, rad; a calibration of its intrinsics takes it for 0."""
STILL_TOLERANCE = 1e-6
"""Tolerance (m, and elements of rotations) of transforms that do not move between collections."""
CAMERA_INFO = "camera_info"
"""Kind of a camera's intrinsics in all, whose errors are correlated; its parts are causes too, which are tested."""
ARM_ACCURACY = 6.0
"""How far an arm's pose is off, in assumed errors of one link: 0.3 mm and 0.6 mrad along each axis, the absolute
accuracy of a good industrial arm (1 mm at most). It differs from pose to pose, as an error of one link would not."""
SCALE_KIND = "scale of poses"
"""Kind of the factor by which all measured translations are too long."""
SCALE_OF_POSES = 0.001
"""Standard deviation of that factor: of the focal length and the printed size by which a camera measured the poses."""
RADIAL_KIND, PROJECTION_KIND = "radial distortion", "projection"
"""Kinds of a lens's radial curve: by coefficients k that bend the rays of a pinhole, or by those of the projection."""
LAG_KIND = "lag"
"""Kind of a sensor's time offset."""
PLACE_KIND = "place"
"""Kind of causes that are only tested from some collection on: over all of them the pose is calibrated or gauge."""
LINK_KIND = "link"
"""Kind of the errors of an arm's moving transforms."""
ENCODER_KIND = "encoder offset"
"""Kind of the error of an encoder's zero."""
ECCENTRICITY_KIND = "eccentricity"
"""Kind of an error of a joint that comes again with each turn, and is not 0 where the encoder was zeroed."""
SAG_KIND = "sag"
"""Kind of the weight that bends an arm, the farther it reaches the more."""
SHUTTER_KIND = "motion while an image is read"
"""Kind of a rolling shutter's error: in each collection another, so that it is only tested as what varies."""
RING_KIND = "ring elevation"
"""Kind of the elevation offset of one of a LiDAR's rings."""
MAX_RINGS = 64
"""Rings that are tested: points of more are those of a camera, or were moved to another frame."""
MIN_VIEWS_OF_RING = 6
"""Views that a ring is on the pattern in, to be tested: their scatter is that of its estimate."""
MAX_MOTION_OFF_AXIS = 1e-4
"""Limit of the motion off the axis, relative to that about or along it, for a joint with one axis."""


@dataclass(frozen=True, eq=False)
class Chain:
    """Chain of transforms from a frame to a pose that its last frame carries, in V collections."""

    collections: IntArray
    """(V,): their indices."""
    T: Array
    """``T_frame_pose`` (V, 4, 4)."""
    path: tuple[Step, ...]
    """From the frame to the last one."""
    prefixes: Mapping[Edge, Array]
    """``T_frame_child`` (V, 4, 4) of each edge in the path."""
    elsewhere: Dataset | None = field(default=None, kw_only=True)
    """Of V poses that are not those of the collections, such as where the robot works; None if they are."""

    @cached_property
    def _from_frame(self) -> Array:
        """``T_pose_frame`` (V, 4, 4)."""
        return inverse(self.T)

    def twist(self, edge: Edge, columns: Array | None = None) -> Array | None:
        """Map twists (V, 6, k) or (6, k) in an edge's child frame to the pose's; None outside of the chain."""
        step = next((each for each in self.path if (each.parent, each.child) == edge), None)
        if step is None:
            return None
        moved = adjoint(self._from_frame @ self.prefixes[edge])
        moved = moved if columns is None else moved @ columns
        return -moved if step.inverted else moved


def chain_along(dataset: Dataset, path: tuple[Step, ...], collections: IntArray) -> Chain:
    """Return the chain along a path; its pose is the last frame."""
    prefixes, at = {}, np.broadcast_to(np.eye(4), (len(collections), 4, 4))
    for step in path:
        edge = dataset.transforms[step.parent, step.child][collections]
        if step.inverted:
            prefixes[step.parent, step.child] = at
        at = at @ (inverse(edge) if step.inverted else edge)
        if not step.inverted:
            prefixes[step.parent, step.child] = at
    return Chain(collections, at, path, prefixes)


@dataclass(frozen=True, eq=False)
class SeenGroup(Chain):
    """Views of one sensor and one pattern at the optimum; the pose is the pattern's frame at its corners' centre."""

    group: ViewGroup
    sensor: Sensor
    pattern: Pattern
    names: ColumnNames

    @property
    def label_columns(self) -> list["LabelColumn"]:
        """The E columns of its labels after those of the pose."""
        return [
            *((self.sensor.name, name) for name in self.names.of_sensor),
            *((self.pattern.name, name) for name in self.names.of_pattern),
        ]


LabelColumn = tuple[str, str]
"""Column of labels, see `ColumnNames`: the name of the sensor or pattern, and the column's own."""
Combination = dict[LabelColumn, float]
"""Linear combination of columns of labels, by their weights, which are the same in all views."""
Twists = Callable[[Chain], Array | None]
"""Function of a chain that returns twists of its pose (V, 6, k); None for no effect."""


@dataclass(frozen=True, eq=False)
class Cause:
    """Fixed parameters with a possible common error."""

    kind: str
    """Such as focal length."""
    subject: str
    """Sensor, pattern or transform."""
    unit: Unit
    assumed: tuple[float, ...]
    """(k,): assumed standard deviation of each parameter."""
    effect: Twists | tuple[Combination, ...]
    """Derivatives by the k parameters: twists of the poses, or a combination of the labels' columns for each."""
    counts: bool = True
    """Whether it adds to the covariance of the result; False if another cause covers the same error."""
    tested: bool = True
    """Whether it may be a suspect; False if other causes are tested for its parts."""
    free: bool = False
    """Whether it is calibrated: found beforehand, and as well known as the labels tell beside all else."""
    known_by: LensSource | None = None
    """Of a camera's intrinsics in all, where its assumed standard deviations come from."""

    @property
    def size(self) -> int:
        """Number of parameters k."""
        return len(self.assumed)

    @cached_property
    def name(self) -> str:
        """Name in messages."""
        return f"{self.kind} of {self.subject}"


def causes(
    dataset: Dataset,
    groups: Sequence[SeenGroup],
    assume: Assumptions,
    free: Mapping[str, Sequence[str]],
    lenses: Mapping[str, LensErrors],
    free_scale: bool = False,
) -> list[Cause]:
    """Return all causes of a dataset's calibration.

    Args:
        dataset: at the optimum.
        groups: all views.
        assume: assumed standard deviations.
        free: by camera, the calibrated intrinsics, which are not fixed.
        lenses: by camera, the errors of its intrinsics.
        free_scale: whether the scale of measured poses is calibrated.
    """
    seen = {each.sensor.name: each for each in groups}
    found = [
        cause
        for name, each in seen.items()
        if not each.names.poses
        for cause in _of_sensor(each, assume, free.get(name, ()), lenses.get(name))
    ]
    found += [
        Cause(
            SCALE_KIND,
            name,
            "1",
            (SCALE_OF_POSES if assume.pattern_size > 0 else 0.0,),
            ({(name, "scale"): 1.0},),
            counts=False,
            tested=not free_scale,
            free=free_scale,
        )
        for name, each in seen.items()
        if each.names.poses
    ]
    cameras = {name: each.names.camera for name, each in seen.items() if each.names.camera is not None}
    if len(cameras) > 1 and not free:
        found += _of_all_cameras(cameras)
    for name in dict.fromkeys(each.pattern.name for each in groups if not each.names.poses):
        has_border = any(each.sensor.modality.points is not None and each.pattern.name == name for each in groups)
        found += _of_pattern(name, has_border, assume)
    moving = _moving_edges(dataset, groups)
    for edge in moving:
        found += _of_moving_edge(dataset, edge, assume)
        if joint_axis(dataset.transforms[edge]) is None and all(each.names.poses for each in groups):
            found.append(_of_whole_arm(edge, assume))
    return [*found, *_of_sagging_arms(dataset, moving)]


def _moving_edges(dataset: Dataset, groups: Sequence[SeenGroup]) -> list[Edge]:
    """Return the transforms between sensors and patterns that differ between collections, but for calibrated ones."""
    edges = dict.fromkeys((step.parent, step.child) for each in groups for step in each.path)
    kept = [edge for edge in edges if edge not in dataset.additional_transforms]
    return [
        edge for edge in kept if np.abs(dataset.transforms[edge] - dataset.transforms[edge][0]).max() > STILL_TOLERANCE
    ]


def _of_sensor(seen: SeenGroup, assume: Assumptions, free: Sequence[str], lens: LensErrors | None) -> Iterator[Cause]:
    sensor, camera = seen.sensor.name, seen.names.camera

    def cause(kind: str, unit: Unit, sigma: float, *weights: dict[str, float], counts: bool = True) -> Iterator[Cause]:
        if not all(parameter in free for each in weights for parameter in each):
            yield Cause(kind, sensor, unit, (sigma,) * len(weights), _combinations_of_subject(sensor, weights), counts)

    if camera is None or lens is None:
        yield from cause("range bias", "m", assume.range_bias, {"bias": 1.0})
        yield from cause("range scale", "1", assume.range_scale, {"scale": 1.0})
        yield from cause("beam elevation", "rad", assume.beam_elevation, {"elevation": 1.0})
        for ring in map(ring_column, seen.names.rings):
            yield Cause(RING_KIND, f"{sensor}'s {ring}", "rad", (0.0,), ({(sensor, ring): 1.0},), counts=False)
        yield from cause("motion during a sweep", "m", 0.0, *({f"sweep_{axis}": 1.0} for axis in "xyz"))
        return
    fixed = [i for i, name in enumerate(lens.parameters) if name not in free]
    if fixed:
        errors = tuple({(sensor, lens.parameters[i]): float(column[i]) for i in fixed} for column in lens.root.T)
        sigmas = (float(not lens.is_exact),) * len(errors)
        yield Cause(CAMERA_INFO, sensor, "1", sigmas, errors, tested=False, known_by=lens.source)

    def part(kind: str, unit: Unit, *weights: dict[str, float], sigma: float = 0.0) -> Iterator[Cause]:
        yield from cause(kind, unit, sigma, *weights, counts=False)

    yield from part("focal length", "1", {"fx": camera.fx, "fy": camera.fy})
    yield from part("aspect", "1", {"fx": camera.fx / 2, "fy": -camera.fy / 2})
    yield from part("principal point", "px", {"cx": 1.0}, {"cy": 1.0})
    yield from part("pixel convention", "px", {"cx": 1.0, "cy": 1.0})
    scaled = {"fx": camera.fx, "fy": camera.fy, "cx": camera.cx + 0.5, "cy": camera.cy + 0.5}
    yield from part("image scale", "1", scaled)
    yield from part("skew", "rad", {"skew": 1.0}, sigma=0.0 if lens.is_exact else SKEW_SIGMA)
    model = camera.distortion
    higher = [name for name in model.higher if name in model.names() and name not in free]
    yield from part("lens model", "1", *({name: 1.0} for name in (*higher, *ERRORS_BEYOND_LENS_MODEL[1:])))
    yield from part(_kind_of_curve(model), "1", *({name: 1.0} for name in model.radial))
    shutter = _combinations_of_subject(sensor, [{name: 1.0} for name in COLUMNS_OF_SHUTTER])
    yield Cause(SHUTTER_KIND, sensor, "m", (0.0,) * len(shutter), shutter, counts=False, tested=False)
    if model.tangential:
        yield from part("tangential distortion", "1", *({name: 1.0} for name in model.tangential))


def _of_all_cameras(cameras: Mapping[str, Camera]) -> Iterator[Cause]:
    """Common errors of all cameras, of one type and calibrated in one way; they explain less of each one alone."""
    subject = " and ".join(cameras) if len(cameras) < 4 else "all cameras"

    def cause(kind: str, unit: Unit, of: Callable[[Camera], dict[str, float]]) -> Cause:
        weights = {(name, own): w for name, camera in cameras.items() for own, w in of(camera).items()}
        return Cause(kind, subject, unit, (0.0,), (weights,), counts=False)

    yield cause("focal length", "1", lambda camera: {"fx": camera.fx, "fy": camera.fy})
    yield cause("pixel convention", "px", lambda _: {"cx": 1.0, "cy": 1.0})
    models = {type(camera.distortion): camera.distortion for camera in cameras.values()}
    if len(models) == 1:  # coefficients of different models are no common error
        [model] = models.values()
        yield cause(_kind_of_curve(model), "1", lambda _: {model.radial[0]: 1.0})


def _kind_of_curve(model: Distortion) -> str:
    return RADIAL_KIND if all(name.startswith("k") for name in model.radial) else PROJECTION_KIND


def _of_pattern(name: str, has_border: bool, assume: Assumptions) -> Iterator[Cause]:
    def cause(kind: str, unit: Unit, assumed: float, *weights: dict[str, float], counts: bool = True) -> Cause:
        return Cause(kind, name, unit, (assumed,) * len(weights), _combinations_of_subject(name, weights), counts)

    yield cause("size", "1", assume.pattern_size, {"size_x": 1.0, "size_y": 1.0})
    yield cause("stretch", "1", assume.pattern_stretch, {"size_x": 0.5, "size_y": -0.5})
    for axis in "xy":  # a printer stretches one side: the data may not determine the size of the other
        yield cause(f"stretch along {axis}", "1", assume.pattern_stretch, {f"size_{axis}": 1.0}, counts=False)
    yield cause("bow", "m", assume.flatness, {"bow_x": 1.0}, {"bow_y": 1.0})
    yield cause("twist", "m", assume.flatness, {"twist": 1.0})
    if has_border:
        yield cause("border", "m", assume.border, {"border": 1.0})


def _combinations_of_subject(subject: str, weights: Sequence[dict[str, float]]) -> tuple[Combination, ...]:
    """Return combinations of the columns of one sensor or pattern."""
    return tuple({(subject, name): weight for name, weight in each.items()} for each in weights)


def _of_moving_edge(dataset: Dataset, edge: Edge, assume: Assumptions) -> Iterator[Cause]:
    name, T = "-".join(edge), dataset.transforms[edge]
    sigma = (assume.arm_translation,) * 3 + (assume.arm_rotation,) * 3
    yield Cause(LINK_KIND, name, "m", sigma, lambda chain: chain.twist(edge))
    axis = joint_axis(T)
    if axis is None:

        def lengths(at: Dataset) -> Array:
            return _lengthening_twists(at.transforms[edge])

        yield Cause("lengths", name, "1", (0.0,), _on_views(dataset, edge, lengths))
        return
    direction, position, prismatic = axis
    unit: Unit = "m" if prismatic else "rad"
    one = assume.arm_translation if prismatic else assume.arm_rotation
    middle = float((local(T[0], T) @ direction).mean())

    def along(effects: Callable[[Array], Array]) -> Twists:
        """Turns or shifts along the axis by effects (N, k) of the positions (N,)."""

        def twists(at: Dataset) -> Array:
            here = position if at is dataset else local(T[0], at.transforms[edge]) @ direction - middle
            return direction[:, None] * effects(here)[:, None]

        return _on_views(dataset, edge, twists)

    yield Cause(ENCODER_KIND, name, unit, (one,), along(lambda at: np.ones((len(at), 1))), counts=False)
    yield Cause("encoder gain", name, "1", (0.0,), along(lambda at: at[:, None]))
    if not prismatic:
        once_a_turn = along(lambda at: np.stack([np.sin(at), np.cos(at), np.ones_like(at)], -1))
        yield Cause(ECCENTRICITY_KIND, name, unit, (0.0,) * 3, once_a_turn)
    backlash = along(lambda at: (np.sign(np.diff(at, prepend=at[:1])) / 2)[:, None])
    yield Cause("backlash", name, unit, (one,), backlash, counts=False)


def _of_whole_arm(edge: Edge, assume: Assumptions) -> Cause:
    """Return the error that all poses of an arm share, where one transform stands for all of its links.

    It leaves no residual: the calibrated transforms take it up. With that of the link it makes `ARM_ACCURACY`.
    """
    beyond = float(np.sqrt(ARM_ACCURACY**2 - 1))
    sigma = (beyond * assume.arm_translation,) * 3 + (beyond * assume.arm_rotation,) * 3
    return Cause("accuracy", "-".join(edge), "m", sigma, lambda chain: chain.twist(edge), tested=False)


def _of_sagging_arms(dataset: Dataset, moving: Sequence[Edge]) -> Iterator[Cause]:
    """Yield for each arm how far its end hangs lower at a reach of 1 m, and how much it is tilted there.

    What bends under a weight at the horizontal reach r hangs lower by r^2 and is tilted by r; joints, links and
    parallel linkages differ in how much of each. Gravity is along -z of the world frame (ROS REP 103).
    """
    chains = [[(step.parent, step.child) for step in dataset.tree.path(dataset.world, edge[1])] for edge in moving]
    for edge, chain in zip(moving, chains, strict=True):
        if any(edge in other[:-1] for other in chains):
            continue  # it carries another joint
        if any(np.isnan(dataset.transforms[each]).any() for each in chain):
            continue  # where it is in the world is not known in each collection
        base = next(each for each in chain if each in moving)[0]
        hanging = partial(_hanging_twists, base=base, edge=edge)
        yield Cause(SAG_KIND, f"{base}-{edge[1]}", "m", (0.0, 0.0), _on_views(dataset, edge, hanging))


def _hanging_twists(dataset: Dataset, base: str, edge: Edge) -> Array:
    """Return the twists (N, 6, 2) of an arm's end that hangs lower, and is tilted, see `_of_sagging_arms`."""
    T_world_end = dataset.transform(dataset.world, edge[1])
    reach = T_world_end[:, :3, 3] - dataset.transform(dataset.world, base)[:, :3, 3]
    reach[:, 2] = 0.0
    twists = np.zeros((len(reach), 6, 2))  # along the world's axes
    twists[:, 2, 0] = -(reach**2).sum(-1)
    twists[:, 3:, 1] = np.cross(reach, (0.0, 0.0, -1.0))
    to_end = np.swapaxes(T_world_end[:, :3, :3], 1, 2)
    return np.concatenate([to_end @ twists[:, :3], to_end @ twists[:, 3:]], 1)


def _on_views(dataset: Dataset, edge: Edge, twists: Callable[[Dataset], Array]) -> Twists:
    """Return the effect of twists (N, 6, k) in an edge's child frame, one for each collection of a dataset.

    Args:
        dataset: the recording.
        edge: the edge.
        twists: those of the collections of a dataset, the recording or poses elsewhere.
    """
    recorded = twists(dataset)

    def effect(chain: Chain) -> Array | None:
        here = recorded[chain.collections] if chain.elsewhere is None else twists(chain.elsewhere)
        return chain.twist(edge, here)

    return effect


def _lengthening_twists(T: Array) -> Array:
    """Return the twists (N, 6, 1) in the child frame that lengthen translations (N, 4, 4) by their own length."""
    out = np.zeros((len(T), 6, 1))
    out[:, :3] = np.swapaxes(T[:, :3, :3], 1, 2) @ T[:, :3, 3:]
    return out


def joint_axis(T: Array) -> tuple[Array, Array, bool] | None:
    """Return the single axis about or along which a transform moves, as a twist (6,) of its child frame.

    Returns:
        The unit twist, the positions (N,) relative to their mean, whether it is a translation; None if the
        motion has no such axis.
    """
    moved = local(T[0], T)
    turns, shifts = moved[:, 3:], moved[:, :3]
    for part, rest, prismatic in ((turns, shifts, False), (shifts, turns, True)):
        size = np.linalg.norm(part, axis=1).max()
        if size <= STILL_TOLERANCE:
            continue
        _, _, axes = np.linalg.svd(part, full_matrices=False)
        position = part @ axes[0]
        crooked = np.abs(part - position[:, None] * axes[0]).max() + np.abs(rest).max()
        if crooked <= max(MAX_MOTION_OFF_AXIS * size, STILL_TOLERANCE):
            twist = np.zeros(6)
            twist[slice(0, 3) if prismatic else slice(3, 6)] = axes[0]
            return twist, position - position.mean(), prismatic
        return None
    return None


def moved_sensor(sensor: Sensor, assumed: tuple[float, ...] = (0.0,) * 6) -> Cause:
    """Cause of a displaced sensor, apart from others that may share its transform."""

    def twists(chain: Chain) -> Array | None:
        seen = isinstance(chain, SeenGroup) and chain.sensor.name == sensor.name
        return chain.twist(sensor.edge) if seen else None

    return Cause(PLACE_KIND, sensor.name, "m", assumed, twists, counts=False)


def moved_pattern(pattern: Pattern, assumed: tuple[float, ...] = (0.0,) * 6) -> Cause:
    """Cause of a displaced fixed pattern."""

    def twists(chain: Chain) -> Array | None:
        seen = isinstance(chain, SeenGroup) and chain.pattern.name == pattern.name
        return np.tile(np.eye(6), (len(chain.T), 1, 1)) if seen else None

    return Cause(PLACE_KIND, pattern.name, "m", assumed, twists, counts=False)


def lag(dataset: Dataset, sensor: Sensor, free: bool) -> Cause:
    """Cause of a sensor whose labels have a time offset: in s by the velocities of frames, else in collections.

    Where the dataset has no velocities, the motion from one collection to the next says the direction.
    """
    timed = bool(dataset.velocities)

    def twists(chain: Chain) -> Array | None:
        if not isinstance(chain, SeenGroup) or chain.sensor.name != sensor.name:
            return None
        return (frame_velocities(dataset, chain) if timed else velocities(chain))[..., None]

    unit: Unit = "s" if timed else "collections"
    return Cause(LAG_KIND, sensor.name, unit, (0.0,), twists, counts=False, tested=not free, free=free)


def frame_velocities(dataset: Dataset, seen: SeenGroup) -> Array:
    """Return the velocity (V, 6) of the pose by those of all frames in its chain, as a twist in the pattern's frame."""
    at = seen.group.collections
    total, velocities = np.zeros((len(at), 6)), dataset.velocities_seen_by(seen.sensor.name)
    for edge, velocity in velocities.items():
        twists = seen.twist(edge, velocity[at][..., None])
        if twists is not None:
            total += twists[..., 0]
    own = velocities.get(seen.pattern.edge)
    if own is not None:
        total += own[at] @ adjoint(translation(-seen.pattern.centre)).T
    return total


def velocities(seen: SeenGroup) -> Array:
    """Return the motion (V, 6) of the pose from one collection to the next, as a twist in the pattern's frame.

    By central differences; at the ends by one-sided ones.
    """
    R, t = seen.T[:, :3, :3], seen.T[:, :3, 3]
    steps = np.zeros((len(t) + 1, 6))  # before each view, and after the last: none at the ends
    steps[1:-1, :3] = np.diff(t, axis=0)
    steps[1:-1, 3:] = rotations.log(np.swapaxes(R[:-1], 1, 2) @ R[1:])  # a turn's vector is the same in both frames
    twists = steps[:-1] + steps[1:]
    twists[:, :3] = (twists[:, None, :3] @ R)[:, 0]
    twists[1:-1] /= 2
    return twists


def seen_groups(dataset: Dataset, groups: Sequence[ViewGroup], poses: Sequence[Array]) -> list[SeenGroup]:
    """Return the views at the optimum.

    Args:
        dataset: its transforms are those of the optimum.
        groups: all views.
        poses: ``T_sensor_pattern`` (V, 4, 4) of each group.
    """
    found = []
    for group, T in zip(groups, poses, strict=True):
        sensor, pattern = dataset.sensors[group.sensor], dataset.patterns[group.pattern]
        path = dataset.tree.path(sensor.frame, pattern.parent_link)
        chain = chain_along(dataset.seen_by(sensor.name), path, group.collections)
        camera = sensor.camera if sensor.modality.has_corners else None
        names = ColumnNames(camera, sensor.modality.has_poses, _rings(group))
        found.append(SeenGroup(chain.collections, T, path, chain.prefixes, group, sensor, pattern, names))
    return found


def _rings(group: ViewGroup) -> tuple[float, ...]:
    """Return the elevations of a LiDAR's rings on a pattern that many views tell of, rad, ascending; none of others."""
    term = group.terms[0]
    if not isinstance(term, RangeTerm) or term.kind != "range":
        return ()
    angles, views = elevations(term.rays)[term.present], np.nonzero(term.present)[0]
    order = np.argsort(angles)
    starts = np.flatnonzero(np.diff(angles[order], prepend=-np.inf) > RING_GAP)
    if not 1 < len(starts) <= MAX_RINGS:
        return ()
    rings = np.split(order, starts[1:])
    return tuple(float(angles[of].mean()) for of in rings if len(set(views[of].tolist())) >= MIN_VIEWS_OF_RING)
