"""The noise of the matrices of a Rigelfile's stages."""

from collections.abc import Mapping, Sequence
from typing import Any

from calibration.introspection.numbers import parse_number
from calibration.rigel.document import Stage
from calibration.rigel.notes import Notes
from calibration.workflow.text import shorten

MAX_NOISE = 1000.0


def placeholder(name: str) -> str | None:
    """Our placeholder for a name of the matrix: ``trans_noise`` gives ``translation_noise``; None for another's."""
    lower = name.lower()
    for part, ours in (("trans", "translation_noise"), ("rot", "rotation_noise"), ("seed", "seed")):
        if part in lower:
            return ours
    return None


def noise_section(stages: Sequence[Stage], notes: Notes) -> tuple[dict[str, list[float]], list[str]]:
    """What ``noise`` says, and where it comes from.

    There is one noise for all systems: where stages differ, all of their values together.
    """
    found: dict[str, dict[str, dict[float, None]]] = {}
    for stage in stages:
        own = _of_stage(stage.matrix, f"{stage.where}.matrix", notes)
        if own:
            found[stage.where] = own
    together: dict[str, dict[float, None]] = {}
    for own in found.values():
        for key, values in own.items():
            together.setdefault(key, {}).update(values)
    different = [where for where, own in found.items() if any(own.get(key, {}) != together[key] for key in together)]
    if different:
        notes.changed(f"{different[0]}.matrix", "there is one noise for all systems: the values of all stages together")
    return {
        key: [int(v) if v.is_integer() else v for v in values] for key, values in sorted(together.items(), reverse=True)
    }, list(found)


def _of_stage(matrix: Mapping[str, Any], where: str, notes: Notes) -> dict[str, dict[float, None]]:
    own: dict[str, dict[float, None]] = {}
    for name, values in matrix.items():
        ours = placeholder(name)
        key = {"translation_noise": "translation", "rotation_noise": "rotation"}.get(ours or "")
        if key is None:
            notes.lost(
                f"{where}.{name}", "a matrix is of translation and rotation noise here (and of seeds: noise.seeds)"
            )
            continue
        for value in values if isinstance(values, list) else [values]:
            number = None if isinstance(value, bool) else parse_number(str(value).strip())
            if number is None or not 0 <= number <= MAX_NOISE:
                notes.lost(f"{where}.{name}", f"{shorten(str(value))!r} is no noise (a number from 0 to {MAX_NOISE:g})")
            else:
                own.setdefault(key, {})[number] = None
    return own
