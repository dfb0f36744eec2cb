"""The file ``calibration-baseline.json``: the accepted calibration of each system, reviewed like a lock file.

Also its changes: the base branch's against the current one's.
"""

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

from calibration.base import InputError, parse_json, read_bytes, write_atomically
from calibration.base.records import document_of, field, length, read, record, result
from calibration.engine.baseline.calibration_document import CalibrationDocument
from calibration.engine.baseline.comparison import BaselineChange, compare

BASELINE_VERSION: Literal[1] = 1
MAX_BASELINE_BYTES = 32_000_000
"""Limit of a baseline's size in bytes: a thousand systems of many sensors."""
CONFLICT_MARKER = b"<<<<<<<"
MAX_LINE_LENGTH = 100
"""Maximum line length for short lists and mappings."""


@record
class Baseline:
    """Accepted calibration of each system."""

    version: Literal[1] = field("Version of this format.")
    systems: Annotated[Mapping[str, CalibrationDocument], length(0, 10_000)] = field("The systems by name.")


def read_baseline(path: Path) -> Baseline | None:
    """Read a baseline from a file; None if it does not exist.

    Raises:
        InputError: it is not a valid baseline; names file and key.
    """
    if path.is_symlink():
        raise InputError(f"{path}: found a symbolic link, expected the baseline itself")
    if not path.exists():
        return None
    return parse_baseline(read_bytes(path, MAX_BASELINE_BYTES, "a baseline"), str(path))


def parse_baseline(content: bytes, where: str) -> Baseline:
    """Parse a baseline.

    Raises:
        InputError: it is not valid; the message begins with ``where``.
    """
    if len(content) > MAX_BASELINE_BYTES:
        raise InputError(f"{where}: found {len(content)} bytes, a baseline has at most {MAX_BASELINE_BYTES}")
    if CONFLICT_MARKER in content:
        raise InputError(
            f"{where}: git left a merge conflict in it: take either side whole (git checkout --ours or --theirs), run "
            f"the calibration, and accept its result (calibration accept)"
        )
    try:
        document = parse_json(content, finite=True)
    except (ValueError, RecursionError) as error:
        raise InputError(f"{where}: this is not a baseline: {error}") from None
    version = document.get("version") if isinstance(document, dict) else None
    if isinstance(version, int) and version > BASELINE_VERSION:
        raise InputError(
            f"{where}: version: found {version}, this program knows {BASELINE_VERSION}: a newer one has written it; "
            "update"
        )
    return read(Baseline, document, where)


def write_baseline(path: Path, baseline: Baseline) -> None:
    """Write a baseline; an interruption leaves the old file.

    Raises:
        InputError: the path is not a regular file.
        InfrastructureError: it cannot be written.
    """
    if path.is_symlink() or (path.exists() and not path.is_file()):
        raise InputError(f"{path}: found no regular file, expected the baseline or nothing")
    write_atomically(path, baseline_text(baseline))


def baseline_text(baseline: Baseline) -> str:
    """Format a baseline: systems sorted by name, short values on one line."""
    document = document_of(baseline)
    document["systems"] = {name: document["systems"][name] for name in sorted(document["systems"])}
    return _indented_text(document, "") + "\n"


def _indented_text(value: Any, indent: str) -> str:
    line = json.dumps(value, ensure_ascii=False, allow_nan=False)
    if not value or not isinstance(value, dict | list) or _fits_on_line(value, line):
        return line
    inner = indent + "  "
    if isinstance(value, dict):
        lines = [f"{json.dumps(key, ensure_ascii=False)}: {_indented_text(each, inner)}" for key, each in value.items()]
        return "{\n" + ",\n".join(inner + each for each in lines) + f"\n{indent}}}"
    return "[\n" + ",\n".join(inner + _indented_text(each, inner) for each in value) + f"\n{indent}]"


def _fits_on_line(value: Any, line: str) -> bool:
    """Whether a value is written on one line: flat lists of any length, nested lists and mappings if short."""
    children = list(value.values()) if isinstance(value, dict) else value
    if not any(isinstance(each, dict | list) for each in children):
        return isinstance(value, list) or len(line) <= MAX_LINE_LENGTH
    return (
        isinstance(value, list)
        and len(line) <= MAX_LINE_LENGTH
        and not any(isinstance(each, dict) for each in children)
    )


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
