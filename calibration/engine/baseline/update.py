"""Changes of the baseline file: the base branch's against the current one's."""

from collections.abc import Iterator

from calibration.base.records import field, result
from calibration.engine.baseline.calibration_document import CalibrationDocument
from calibration.engine.baseline.comparison import BaselineChange, compare
from calibration.engine.baseline.document import Baseline


@result(kw_only=True)
class Update:
    """Replaced value of an accepted calibration."""

    system: str = field("The system.")
    before: str = field("Previously accepted value; empty if there was none.", default="")
    now: str = field("Now accepted value; empty if there is none.", default="")
    change: BaselineChange | None = field("The difference, if both exist.", default=None)
    although: str | None = field("Reason for accepting it although it had failed.", default=None)


@result(kw_only=True)
class BaselineUpdate:
    """Baseline file, and its changes in the tested commit."""

    file: str = field("Its path.")
    since: str = field("Its name with its last commit.", default="")
    compared: tuple[str, ...] = field("Systems whose accepted calibration is in it.", default=())
    not_accepted: tuple[str, ...] = field("Systems without an accepted calibration.", default=())
    base: str | None = field("The commit that it is compared with; null where there is none.", default=None)
    updates: tuple[Update, ...] = field("Values that the change accepts.", default=())
    unused: tuple[str, ...] = field("Systems in it that the configuration does not have.", default=())
    problem: str | None = field("Reason why the base's baseline cannot be compared with.", default=None)
    reasons: tuple[str, ...] = field("Reasons of a fail verdict.", default=())


def updates(before: Baseline | None, now: Baseline | None) -> tuple[Update, ...]:
    """Return the replaced values, system by system; unchanged ones are left out."""
    old, new = (each.systems if each else {} for each in (before, now))
    found: list[Update] = []
    for name in sorted(old.keys() | new.keys()):
        if name not in old:
            found.append(Update(system=name, now=_count_of_transforms(new[name]), although=new[name].although))
        elif name not in new:
            found.append(Update(system=name, before=_count_of_transforms(old[name])))
        elif old[name] != new[name]:
            found += _updates_of_system(name, old[name], new[name])
    return tuple(found)


def _updates_of_system(name: str, before: CalibrationDocument, now: CalibrationDocument) -> Iterator[Update]:
    old, new = _texts_by_name(before), _texts_by_name(now)
    for change in compare(before, now).changes:
        if change.mm or change.deg or change.value or change.kind in ("added", "removed"):
            was, is_now = old.get(change.name, ""), new.get(change.name, "")
            yield Update(system=name, before=was, now=is_now, change=change, although=now.although)
    if before.rms_px != now.rms_px:
        was, is_now = (f"RMS {each.rms_px:.4g} px" if each.rms_px is not None else "" for each in (before, now))
        yield Update(system=name, before=was, now=is_now, although=now.although)


def _count_of_transforms(snapshot: CalibrationDocument) -> str:
    return f"{len(snapshot.poses)} transforms of {snapshot.collections} collections"


def _texts_by_name(snapshot: CalibrationDocument) -> dict[str, str]:
    """Return the calibrated values as text, by name."""
    poses = {
        each.name: f"{_joined_numbers(each.xyz_mm, 2)} mm, {_joined_numbers(each.rpy_deg, 3)} deg"
        for each in snapshot.poses
    }
    values = {
        each.name: f"{each.value:.6g}{'' if each.unit == '1' else f' {each.unit}'}" for each in snapshot.parameters
    }
    return poses | values


def _joined_numbers(values: tuple[float, ...], digits: int) -> str:
    return ", ".join(f"{round(value, digits) + 0.0:.{digits}f}" for value in values)
