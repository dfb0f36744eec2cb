"""Tasks of the robot against their limits: what a suspect does to them, and how sure they are."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calibration.base.arrays import Array
from calibration.engine.diagnosis.finding import Finding, Severity
from calibration.engine.diagnosis.precision import ADVICE_ON_CONTRADICTIONS, ADVICE_TO_ADD, ADVICE_TO_MEND
from calibration.engine.estimation.covariance.error_bars import ErrorSource, SourceKind
from calibration.engine.statistics import quantile_of_norm
from calibration.engine.tasks.task_errors import MOST, TaskError

IN_WORDS: dict[SourceKind, str] = {
    "labels": "noise of the labels",
    "collections": "disagreement of collections",
    "lens": "lens",
    "board": "board",
    "arm": "arm",
    "ranges": "ranges",
    "held": "other things that are held",
}
MIN_NAMED_PART = 0.3
"""Part of a task's standard deviation from which on a source of it is named."""
BY_RECORDING: tuple[SourceKind, ...] = ("labels", "collections")
"""Sources that more collections would narrow."""


@dataclass(frozen=True)
class AtTask:
    """What a change of parameters does to the task that it harms most."""

    error: TaskError | None = None
    size: float = 0.0
    broken: tuple[str, ...] = ()
    """All tasks whose limit it exceeds, also without what its own error makes it larger,"""
    undecided: tuple[str, ...] = ()
    """and by its estimate alone, or together with their own error."""

    def __bool__(self) -> bool:
        return self.error is not None

    def __str__(self) -> str:
        if self.error is None:
            return ""
        task = self.error.task
        limit = "" if task.limit is None else f" (limit {task.limit:.3g} {task.unit})"
        return f"it makes {self.size:.3g} {task.unit} at task '{task.name}'{limit}"


def worst_at_tasks(tasks: Sequence[TaskError], changes: Sequence[Array], errors: Sequence[Array] = ()) -> AtTask:
    """Return what changes (C,) of the parameters, each by itself, do to the task that they harm most.

    Args:
        tasks: the tasks.
        changes: the changes.
        errors: (C, r) of each, independent ones.
    """
    each = [AtTask(task, max(task.largest_change(change) for change in changes)) for task in tasks]
    sure = [
        AtTask(task, max(task.largest_change(change, error) for change, error in zip(changes, errors, strict=True)))
        for task in tasks
        if errors
    ]
    worst = max(each, key=_share_of_limit, default=AtTask())
    over = tuple(a.error.task.name for a in each if a.error and _reaches_over(a))
    broken = tuple(a.error.task.name for a in (sure if errors else each) if a.error and _share_of_limit(a) > 1)
    return replace(worst, broken=broken, undecided=tuple(name for name in over if name not in broken))


def _reaches_over(found: AtTask) -> bool:
    """Whether a change is beyond a task's limit, or is together with the task's own error, which alone is within it."""
    if found.error is None or (limit := found.error.task.limit) is None:
        return False
    own = float(found.error.most[found.error.worst])
    return found.size > limit or own <= limit < np.hypot(found.size, own)


def _share_of_limit(found: AtTask) -> float:
    limit = found.error.task.limit if found.error else None
    return 0.0 if limit is None else found.size / limit


def unsure_tasks(tasks: Sequence[TaskError], found: Sequence[Finding]) -> tuple[Finding, ...]:
    """Report tasks whose error at the worst point may be beyond their limit; nothing where a failure is reported.

    It is undecided; a failure where the labels of a sensor are noisier than any good ones, and their disagreement does
    it.

    Args:
        tasks: errors of the tasks.
        found: by the checks before.
    """
    if any(each.severity == "red" and each.kind in ("suspect", "contradiction") for each in found):
        return ()
    noisy, findings = any(each.kind == "noisy-sensor" for each in found), list[Finding]()
    for error in tasks:
        limit, size, unit = error.task.limit, float(error.most[error.worst]), error.task.unit
        if limit is None or size <= limit:
            continue
        is_broken = noisy and breaks_by_disagreement(error)
        severity: Severity = "red" if is_broken else "undecided"
        text = _describe_unsure(error, limit, found, is_broken)
        findings.append(Finding("task", severity, text, value=size, unit=unit, tasks=(error.task.name,)))
    return tuple(findings)


def breaks_by_disagreement(error: TaskError) -> bool:
    """Return whether a limit would hold at the worst point if the collections agreed, and does not as they are.

    What makes them disagree, where that is certain, may be off alike in all of them: a lag, a rolling shutter, a lens
    beyond its model. Their scatter tells the least of it.
    """
    limit = error.task.limit
    if limit is None or error.most[error.worst] <= limit:
        return False
    return size_of(error, [each for each in error.sources if each.kind != "collections"]) <= limit


def _describe_unsure(error: TaskError, limit: float, found: Sequence[Finding], is_broken: bool) -> str:
    parts, unit = error.parts(), error.task.unit
    whole = float(np.sqrt(sum(part**2 for part in parts.values())))
    named = [f"{IN_WORDS[kind]} {part:.2g} {unit}" for kind, part in parts.items() if part > MIN_NAMED_PART * whole]
    if any(each.kind == "suspect" for each in found):
        remedy = ADVICE_TO_MEND
    elif is_broken:
        remedy = ADVICE_ON_CONTRADICTIONS
    elif held_alone(error) > limit:
        what = next(IN_WORDS[kind] for kind in parts if kind not in BY_RECORDING)
        remedy = (
            f"no more collections like these can make it hold: with them what is held alone makes "
            f"{held_alone(error):.2g} {unit}, most of it the {what}: take other poses, calibrate it, or state under "
            "'assume' how well it is known"
        )
    else:
        remedy = ADVICE_TO_ADD
    return (
        f"task '{error.task.name}' is not sure enough: its error stays below {error.most[error.worst]:.2g} {unit} in "
        f"95 % of cases {place_in_words(error)}, limit {limit:.3g} {unit}; the largest of its standard deviation of "
        f"{whole:.2g} {unit}: {', '.join(named)}; {remedy}"
    )


def held_alone(error: TaskError) -> float:
    """Return the 95 % error at the worst point if nothing but what is held erred."""
    return size_of(error, [each for each in error.sources if each.kind not in BY_RECORDING])


def size_of(error: TaskError, sources: Sequence[ErrorSource]) -> float:
    """Return the 95 % error at the worst point if nothing but some sources erred."""
    if not sources:
        return 0.0
    moved = error.jacobian[error.worst] @ np.concatenate([each.columns for each in sources], 1)
    return float(quantile_of_norm((moved @ moved.T)[None], MOST)[0])


def place_in_words(error: TaskError) -> str:
    """Return where a task's worst point is: in the image, or in the frame in which it counts."""
    placed, (poses, number) = error.placed, error.placed.at
    pose = f" in pose {poses[error.worst] + 1} of its joints" if placed.task.joints else ""
    if placed.pixels is not None:
        u, v = placed.pixels[number[error.worst]].tolist()
        return f"at pixel ({u:.0f}, {v:.0f}) of {placed.spread_over}{pose}"
    x, y, z = placed.places[error.worst].tolist()
    return f"at ({x:.3g}, {y:.3g}, {z:.3g}) m in {placed.frame}{pose}"
