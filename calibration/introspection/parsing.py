"""How rules are written.

A set of rules is a mapping (or just the list under ``rules``)::

    rules:
      - {column: RMS (pix), row: Averages, min: 0, max: 3}      # one row: a label, first, last, index:3
      - {column: RMS (pix), every-min: 0, every-max: 2}         # every row; the same as without row: min, max
      - {column: Trans (mm), aggregate: p95, max: 5, exclusive: true}   # max, min, mean, median, p95
      - {column: Status, matches: "ok|done"}                    # contains, does-not-contain, matches
      - {column: RMS (pix), row: Averages, max-increase: 10%}   # against the baseline; also max-decrease
    key-column: "Collection #"      # where the labels stand; else found
    required-rows: ["000", "001"]   # labels that must be there
    min-rows: 20                    # of "every row"; at least 1 without it
    summary-rows: [Averages]        # the rows that sum up others ...
    exclude-summary-rows: true      # ... and are no part of "every row", aggregates and min-rows
    file: results/*.csv             # what the command judges when it is not told

Limits are inclusive unless ``exclusive`` is true. ``matches`` is a regular expression for the whole
cell. A rule may have limits for one row and, as ``every-min`` and ``every-max``, for every row.
"""

import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeVar

from calibration.errors import InputError
from calibration.introspection.baseline import Allowance, parse_allowance
from calibration.introspection.numbers import parse_number
from calibration.introspection.rules import (
    ChangeRule,
    LimitRule,
    Limits,
    Rule,
    RuleSet,
    TextRule,
    refuse_contradictions,
)
from calibration.introspection.selection import EveryRow, Target, parse_aggregate, parse_row
from calibration.workflow.text import did_you_mean, shorten

_Value = TypeVar("_Value")

_LIMIT_KEYS = ("min", "max")
_EVERY_KEYS = ("every-min", "every-max")
_TEXT_KEYS = ("contains", "does-not-contain", "matches")
_CHANGE_KEYS = ("max-increase", "max-decrease")
_TARGET_KEYS = ("row", "aggregate", "every")
RULE_KEYS = ("column", *_TARGET_KEYS, *_LIMIT_KEYS, "exclusive", *_EVERY_KEYS, *_TEXT_KEYS, *_CHANGE_KEYS)
"""The keys of one rule."""
TABLE_KEYS = ("rules", "file", "key-column", "required-rows", "min-rows", "summary-rows", "exclude-summary-rows")
"""The keys of a set of rules."""


def parse_rules(document: object, where: str, *, required: bool = True) -> RuleSet:
    """Read a set of rules from what a YAML or JSON file holds; see the module for its form.

    ``where`` begins every message (``calibration.yml: systems.t2rgb.rules``). Raises
    :class:`InputError`: for a key that is not known, a value of the wrong kind, a rule without a
    limit, with limits that contradict each other, or for numbers and text at once, and when
    nothing at all would be judged although something is ``required``.
    """
    mapping = {"rules": document} if isinstance(document, list | tuple) else document
    if not isinstance(mapping, Mapping):
        raise InputError(f"{where}: a list of rules, or a mapping with the key rules, was expected")
    _refuse_unknown(mapping, TABLE_KEYS, where)
    listed = mapping.get("rules", [])
    if not isinstance(listed, list | tuple):
        raise InputError(f"{where}: rules: a list was expected, found {shorten(repr(listed))}")
    rules: list[Rule] = []
    for number, rule in enumerate(listed, start=1):
        rules += parse_rule(rule, f"{where}: rule {number}")
    refuse_contradictions(rules, where)
    rule_set = RuleSet(
        tuple(rules),
        key_column=_optional(mapping, "key-column", _name, where),
        required_rows=_optional(mapping, "required-rows", _names, where),
        min_rows=_optional(mapping, "min-rows", _count, where),
        summary_rows=_optional(mapping, "summary-rows", _names, where),
        exclude_summary_rows=_optional(mapping, "exclude-summary-rows", _boolean, where),
        file=_optional(mapping, "file", _name, where),
    )
    if required and not rule_set.judges:
        raise InputError(f"{where}: there is no rule, so nothing would be judged")
    return rule_set


def parse_rule(rule: object, where: str) -> list[Rule]:
    """Read the mapping of one rule, which may be a rule for one row and one for every row.

    Raises :class:`InputError` as :func:`parse_rules` does.
    """
    if not isinstance(rule, Mapping):
        raise InputError(
            f"{where}: a mapping such as {{column: RMS, max: 3}} was expected, found {shorten(repr(rule))}"
        )
    _refuse_unknown(rule, RULE_KEYS, where)
    column = _required(rule, "column", _name, where)
    where = f"{where} ({column})"
    _refuse_mixture(rule, where)
    target = _target(rule, where)
    exclusive = bool(_optional(rule, "exclusive", _boolean, where))
    rules: list[Rule] = []
    for keys, rows in ((_LIMIT_KEYS, target), (_EVERY_KEYS, EveryRow())):
        if _given(rule, keys):
            low, high = (_optional(rule, key, _number, where) for key in keys)
            rules.append(LimitRule(column, rows, Limits(low, high, exclusive)))
    if _given(rule, _TEXT_KEYS):
        contains, does_not_contain = (_optional(rule, key, _text, where) for key in _TEXT_KEYS[:2])
        rules.append(TextRule(column, target, contains, does_not_contain, _optional(rule, "matches", _pattern, where)))
    if _given(rule, _CHANGE_KEYS):
        increase, decrease = (_optional(rule, key, _allowance, where) for key in _CHANGE_KEYS)
        rules.append(ChangeRule(column, target, increase, decrease))
    refuse_contradictions(rules, where)
    return rules


def _target(rule: Mapping[str, Any], where: str) -> Target:
    chosen: list[Target] = []
    if "row" in rule:
        chosen.append(_required(rule, "row", lambda value: parse_row(_name(value)), where))
    if "aggregate" in rule:
        chosen.append(_required(rule, "aggregate", lambda value: parse_aggregate(_name(value)), where))
    if _optional(rule, "every", _boolean, where):
        chosen.append(EveryRow())
    if len(chosen) > 1:
        raise InputError(f"{where}: give one of {', '.join(_TARGET_KEYS)}, found {' and '.join(map(str, chosen))}")
    return chosen[0] if chosen else EveryRow()


def _refuse_mixture(rule: Mapping[str, Any], where: str) -> None:
    """Refuse keys that are each well but make no sense together, and a rule that asks nothing."""
    numeric = _given(rule, (*_LIMIT_KEYS, *_EVERY_KEYS, *_CHANGE_KEYS))
    texts = _given(rule, _TEXT_KEYS)
    chosen = _given(rule, ("row", "aggregate"))
    if not numeric and not texts:
        raise InputError(f"{where}: the rule has no limit: give min, max, contains, matches, max-increase or another")
    if numeric and texts:
        raise InputError(f"{where}: {numeric[0]} is for numbers and {texts[0]} for text: make two rules of it")
    if texts and "aggregate" in rule:
        raise InputError(f"{where}: {texts[0]} is for text, of which there is no {rule['aggregate']}")
    if chosen and not _given(rule, (*_LIMIT_KEYS, *_TEXT_KEYS, *_CHANGE_KEYS)):
        raise InputError(f"{where}: a {chosen[0]} is chosen but has no limit: give min or max, or leave it out")
    if not chosen and _given(rule, _LIMIT_KEYS) and _given(rule, _EVERY_KEYS):
        raise InputError(f"{where}: min, max and every-min, every-max are all for every row: choose a row for min, max")
    if rule.get("exclusive") and not _given(rule, (*_LIMIT_KEYS, *_EVERY_KEYS)):
        raise InputError(f"{where}: exclusive is for min, max, every-min and every-max, and there is none")


def _refuse_unknown(mapping: Mapping[Any, Any], known: Sequence[str], where: str) -> None:
    for key in mapping:
        if key not in known:
            hint = did_you_mean(str(key), known) or f"; the keys are {', '.join(known)}"
            raise InputError(f"{where}: there is no key {key!r}{hint}")


def _given(rule: Mapping[str, Any], keys: Sequence[str]) -> list[str]:
    return [key for key in keys if key in rule]


def _optional(mapping: Mapping[str, Any], key: str, read: Callable[[Any], _Value], where: str) -> _Value | None:
    """Read the value of a key, None where the key is missing."""
    return _required(mapping, key, read, where) if key in mapping else None


def _required(mapping: Mapping[str, Any], key: str, read: Callable[[Any], _Value], where: str) -> _Value:
    """Read the value of a key; messages say where it stands."""
    if key not in mapping:
        raise InputError(f"{where}: the key {key} is missing")
    try:
        return read(mapping[key])
    except InputError as error:
        raise InputError(f"{where}: {key}: {error}") from None


def _text(value: Any) -> str:
    if not isinstance(value, str):
        raise InputError(f"a text was expected, found {shorten(repr(value))}: put it in quotes")
    if not value:
        raise InputError("the text is empty")
    return value


def _name(value: Any) -> str:
    name = _text(value).strip()
    if not name:
        raise InputError("the text is empty")
    return name


def _names(value: Any) -> tuple[str, ...]:
    if not isinstance(value, list | tuple):
        raise InputError(f"a list of texts was expected, found {shorten(repr(value))}")
    return tuple(map(_name, value))


def _boolean(value: Any) -> bool:
    if not isinstance(value, bool):
        raise InputError(f"true or false was expected, found {shorten(repr(value))}")
    return value


def _number(value: Any) -> float:
    """Read a number; as text too, because YAML takes ``1e-3`` for one."""
    number = parse_number(str(value).strip())
    if number is None:
        raise InputError(f"a finite number was expected, found {shorten(repr(value))}")
    return number


def _count(value: Any) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or value < 1:
        raise InputError(f"a whole number of at least 1 was expected, found {shorten(repr(value))}")
    return value


def _allowance(value: Any) -> Allowance:
    if isinstance(value, bool) or not isinstance(value, str | int | float):
        raise InputError(f"{value!r} is no allowance: give 0.1 (in the column's unit) or 10% (of the baseline)")
    return parse_allowance(str(value))


def _pattern(value: Any) -> re.Pattern[str]:
    try:
        return re.compile(_text(value))
    except (re.error, OverflowError, RecursionError) as error:
        raise InputError(f"{value!r} is no regular expression: {error}") from None
