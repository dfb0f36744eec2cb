"""History of accepted calibrations in a repository: level changes and drift, with the commits that introduced them."""

import io
import json
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from calibration.base import InputError, one_line, parse_json, shorten
from calibration.base.arrays import Array
from calibration.base.optional import figures_of_matplotlib
from calibration.base.records import computed, field, result
from calibration.ci.git import Commit, Repository
from calibration.engine.baseline.calibration_document import CalibratedPose, CalibrationDocument
from calibration.engine.baseline.comparison import covariance_of_difference
from calibration.engine.baseline.document import BASELINE_VERSION, MAX_BASELINE_BYTES, parse_baseline
from calibration.engine.geometry.transforms import local
from calibration.engine.statistics import change_points, creeps, noise_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MIN_NOISE = np.array([1e-6] * 3 + [1e-6] * 3)
"""Lower limit of the noise: a micrometre, a microradian."""


@dataclass(frozen=True)
class Revision:
    """Accepted calibrations of one commit."""

    commit: Commit
    systems: Mapping[str, CalibrationDocument]


@result(kw_only=True)
class Point:
    """Pose in one commit, relative to the first one."""

    commit: str = field("Hash of the commit.")
    date: str = field("Of the commit.")
    subject: str = field("First line of its message.")
    translation_mm: tuple[float, ...] = field("Translation from the first pose, in its child frame.", unit="mm")
    rotation_deg: tuple[float, ...] = field("Rotation from the first pose, as a rotation vector.", unit="degrees")
    sigma_mm: float = field("Standard deviation of the translation, the norm of three axes.", unit="mm")
    rms_px: float | None = field("Of the system.", unit="px")


@result(kw_only=True)
class LevelStep:
    """Commit at which the level of a series changes."""

    commit: str = field("Hash of the commit.")
    date: str = field("Of the commit.")
    subject: str = field("First line of its message.")
    mm: float = field("Difference of the translation from the previous level.", unit="mm", default=0.0)
    deg: float = field("Difference of the rotation from the previous level.", unit="degrees", default=0.0)
    rms_px: float | None = field("Difference of an RMS from the previous level.", unit="px", default=None)


@result(kw_only=True)
class Trend:
    """Series of a pose, or of the RMS of a system, through the history."""

    system: str = field("The system.")
    name: str = field("The sensor or the transform; RMS.")
    points: tuple[Point, ...] = field("A point for each commit that changed the file, the earliest first.")
    steps: tuple[LevelStep, ...] = field("Changes of its level; none if it drifts.")
    crept_mm: float | None = field(
        "Distance that it has drifted in one direction; null if it has not.", unit="mm", default=None
    )


@result(kw_only=True)
class History:
    """Accepted calibrations of a repository, over its commits."""

    file: str = field("The file, relative to the repository.")
    commits: int = field("Commits that changed it.")
    unreadable: tuple[str, ...] = field("Commits in which the file is no baseline.", default=())
    trends: tuple[Trend, ...] = field("A trend for each pose and each system.")

    @property
    @computed()
    def changes(self) -> int:
        """Number of changes in all trends."""
        return sum(len(trend.steps) for trend in self.trends)


def read_history(repository: Repository, path: str, commits: Sequence[Commit]) -> tuple[list[Revision], list[str]]:
    """Return the accepted calibrations of each commit, oldest first, and the commits with an unreadable file.

    Args:
        repository: a checkout.
        path: of the file, in the checkout.
        commits: those that changed the file, newest first.
    """
    revisions: list[Revision] = []
    unreadable: list[str] = []
    known: dict[str, tuple[Any, CalibrationDocument]] = {}
    by_hash = {each.hash: each for each in commits}
    for commit, content in repository.contents([each.hash for each in commits], path, MAX_BASELINE_BYTES):
        if content is None:
            continue
        try:
            systems = _read_systems(content, f"{commit[:12]}:{path}", known)
        except InputError:
            unreadable.append(commit)
            continue
        revisions.append(Revision(by_hash[commit], systems))
    return revisions[::-1], unreadable


def _read_systems(
    content: bytes, where: str, known: dict[str, tuple[Any, CalibrationDocument]]
) -> dict[str, CalibrationDocument]:
    """Parse the systems of a file; unchanged ones are taken from the previous revision."""
    try:
        document = parse_json(content)
        entries = document["systems"] if document["version"] == BASELINE_VERSION else {}
        stayed = {name: known[name][1] for name, entry in entries.items() if name in known and known[name][0] == entry}
        new = {name: entry for name, entry in entries.items() if name not in stayed}
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return dict(parse_baseline(content, where).systems)  # raises with the full message
    read: Mapping[str, CalibrationDocument] = {}
    if new or not entries:
        read = parse_baseline(json.dumps({**document, "systems": new}).encode(), where).systems
    for name, snapshot in read.items():
        known[name] = (new[name], snapshot)
    return {name: {**stayed, **read}[name] for name in entries}


def history_of(file: Path, systems: Sequence[str], since: str | None, most: int) -> History:
    """Return the history of a file of accepted calibrations.

    Args:
        file: the file, in a checkout.
        systems: restrict to these; empty for all.
        since: restrict to commits after this one.
        most: restrict to this number of newest commits.

    Raises:
        InputError: the file is not in a repository, or in no commit.
        InfrastructureError: git fails.
    """
    repository = Repository.around(file.resolve().parent)
    inside = repository.path(file)
    if inside is None:
        raise InputError(f"{file}: expected a file in the repository {repository.root}")
    commits = repository.changes_of(inside, since, most)
    accepted, unreadable = read_history(repository, inside, commits)
    if not accepted:
        after = f" after {since}" if since else ""
        raise InputError(f"{inside}: no commit{after} has accepted anything: calibration accept, then commit the file")
    return history(inside, accepted, unreadable, systems)


def history(file: str, accepted: Sequence[Revision], unreadable: Iterable[str], systems: Sequence[str]) -> History:
    """Return the trends of systems; of all if none is named.

    Raises:
        InputError: a named system has never been accepted.
    """
    known = dict.fromkeys(name for each in accepted for name in each.systems)
    for name in systems:
        if name not in known:
            raise InputError(f"{file}: no commit has accepted '{name}' (accepted: {', '.join(known) or 'nothing'})")
    trends = [trend for name in systems or known for trend in _trends_of_system(name, accepted)]
    return History(file=file, commits=len(accepted), unreadable=tuple(unreadable), trends=tuple(trends))


def _trends_of_system(system: str, accepted: Sequence[Revision]) -> Iterator[Trend]:
    having = [(each.commit, each.systems[system]) for each in accepted if system in each.systems]
    poses: dict[str, list[tuple[Commit, CalibrationDocument, CalibratedPose]]] = {}
    for commit, snapshot in having:
        for pose in snapshot.poses:
            poses.setdefault(pose.name, []).append((commit, snapshot, pose))
    for name, entries in poses.items():
        if any(pose.sigma_mm for _, _, pose in entries):  # poses that were always fixed carry no information
            yield _of_pose(system, name, entries)
    yield _of_rms(system, [(commit, snapshot) for commit, snapshot in having if snapshot.rms_px is not None])


def _of_pose(system: str, name: str, entries: Sequence[tuple[Commit, CalibrationDocument, CalibratedPose]]) -> Trend:
    first = entries[0][2].matrix
    moved = local(first, np.stack([pose.matrix for _, _, pose in entries]))
    noise = np.maximum(noise_of(moved, _stated_deviation([pose for _, _, pose in entries])), MIN_NOISE)
    at = change_points(moved, noise)
    crept = None
    if creeps(moved, noise, at):
        at, crept = [], round(1e3 * float(np.linalg.norm(moved[-1, :3] - moved[0, :3])), 4)
    levels = np.split(moved, at)
    steps = [_level_step(entries[i][0], levels, k) for k, i in enumerate(at)]
    points = [
        _trend_point(commit, snapshot, twist, pose.norm_mm)
        for (commit, snapshot, pose), twist in zip(entries, moved, strict=True)
    ]
    return Trend(system=system, name=name, points=tuple(points), steps=tuple(steps), crept_mm=crept)


def _stated_deviation(poses: Sequence[CalibratedPose]) -> Array:
    """Standard deviation (6,) of a pose by its reported covariances, among recordings of the same robot."""
    covariances = [covariance_of_difference(*pair) for pair in pairwise(poses)]
    sigmas = [np.sqrt(np.maximum(np.diagonal(C), 0.0) / 2) for C in covariances if C is not None]
    return np.maximum(np.median(sigmas, axis=0), MIN_NOISE) if sigmas else MIN_NOISE


def _level_step(commit: Commit, levels: Sequence[Array], k: int) -> LevelStep:
    """Return the step after a level of twists (N, 6), or of RMS (N, 1)."""
    step = levels[k + 1].mean(axis=0) - levels[k].mean(axis=0)
    return LevelStep(
        commit=commit.hash,
        date=commit.date,
        subject=commit.subject,
        mm=round(1e3 * float(np.linalg.norm(step[:3])), 6) if len(step) == 6 else 0.0,
        deg=round(float(np.degrees(np.linalg.norm(step[3:]))), 8),
        rms_px=round(float(step[0]), 6) if len(step) == 1 else None,
    )


def _trend_point(
    commit: Commit, snapshot: CalibrationDocument, twist: Sequence[float] | Array, sigma_mm: float
) -> Point:
    return Point(
        commit=commit.hash,
        date=commit.date,
        subject=commit.subject,
        translation_mm=tuple(round(1e3 * float(v), 6) for v in twist[:3]),
        rotation_deg=tuple(round(float(np.degrees(v)), 8) for v in twist[3:]),
        sigma_mm=sigma_mm,
        rms_px=snapshot.rms_px,
    )


def _of_rms(system: str, entries: Sequence[tuple[Commit, CalibrationDocument]]) -> Trend:
    values = np.array([[snapshot.rms_px or 0.0] for _, snapshot in entries]).reshape(-1, 1)
    typical = max(float(np.median(values)), 1e-6) if len(values) else 1.0
    # A standard deviation estimated from n views has a relative one of 1 / sqrt(4 n): two coordinates each.
    views = [max(1, sum(snapshot.views.values())) for _, snapshot in entries] or [1]
    noise = noise_of(values, np.array([typical / np.sqrt(4 * float(np.median(views)))]))
    at = change_points(values, noise)
    levels = np.split(values, at)
    points = [_trend_point(commit, snapshot, (), 0.0) for commit, snapshot in entries]
    steps = [_level_step(entries[i][0], levels, k) for k, i in enumerate(at)]
    return Trend(system=system, name="RMS", points=tuple(points), steps=tuple(steps))


MAX_PANELS = 24
PANEL_COLUMNS = 2
MAX_TICKS = 6
MAX_MARKED_POINTS = 60
"""Above this number of points, a line has no markers."""
_PANEL_WIDTH, _PANEL_HEIGHT = 5.0, 2.2
"""Size of a panel in inches."""
_LINE_COLOUR, _BAND_COLOUR, _CHANGE_COLOUR = "#1f5fa8", "#b9cfe8", "#c8102e"


def figure(found: History) -> bytes:
    """Draw the trends as SVG; the same history gives the same bytes with the same matplotlib.

    Raises:
        InputError: there are too many trends.
        InfrastructureError: matplotlib is not installed.
    """
    if len(found.trends) > MAX_PANELS:
        raise InputError(f"no figure: found {len(found.trends)} trends, at most {MAX_PANELS} can be drawn: --systems")
    with figures_of_matplotlib(8) as figures:
        columns = min(PANEL_COLUMNS, len(found.trends))
        rows = math.ceil(len(found.trends) / columns)
        drawing = figures.Figure(figsize=(columns * _PANEL_WIDTH, rows * _PANEL_HEIGHT + 0.4), layout="constrained")
        drawing.suptitle("Since the first accepted calibration", fontsize=10)
        for number, trend in enumerate(found.trends):
            _draw_panel(drawing.add_subplot(rows, columns, number + 1), trend)
        svg = io.BytesIO()
        drawing.savefig(svg, format="svg", metadata={"Date": None, "Creator": None})
    return svg.getvalue()


def _draw_panel(axes: "Axes", trend: Trend) -> None:
    at = np.arange(len(trend.points))
    marker = "." if len(at) <= MAX_MARKED_POINTS else ""
    if trend.name == "RMS":
        axes.plot(at, [point.rms_px or 0.0 for point in trend.points], "-", marker=marker, color=_LINE_COLOUR)
        axes.set_ylabel("px")
    else:
        moved = np.array([point.translation_mm for point in trend.points])
        sigma = max(point.sigma_mm for point in trend.points) / math.sqrt(3)
        for axis, style in zip("xyz", ("-", "--", ":"), strict=True):
            values = moved[:, "xyz".index(axis)]
            axes.fill_between(at, values - sigma, values + sigma, color=_BAND_COLOUR, alpha=0.4, linewidth=0)
            axes.plot(at, values, style, marker=marker, color=_LINE_COLOUR, label=axis)
        axes.set_ylabel("mm")
        axes.legend(loc="upper left", ncols=3, frameon=False)
    for step in trend.steps:
        place = next(i for i, point in enumerate(trend.points) if point.commit == step.commit)
        axes.axvline(place - 0.5, color=_CHANGE_COLOUR, linewidth=1)
        axes.annotate(
            step.commit[:7], (place - 0.5, 1.0), xycoords=("data", "axes fraction"), color=_CHANGE_COLOUR, fontsize=6
        )
    crept = f", creeping: {trend.crept_mm:.2g} mm" if trend.crept_mm is not None else ""
    axes.set_title(f"{shorten(one_line(f'{trend.system}: {trend.name}'), 50)}{crept}", loc="left", pad=10)
    shown = at[:: max(1, math.ceil(len(at) / MAX_TICKS))]
    axes.set_xticks(shown, [trend.points[i].date for i in shown])
