"""Rules for the cells of a column, sets of them, and their syntax.

A set is a mapping, or just the list under ``rules``::

    rules:
      - {column: RMS (pix), row: Averages, min: 0, max: 3}      # one row: a label, first, last, index:3
      - {column: RMS (pix), every-min: 0, every-max: 2}         # every row; the same as without row: min, max
      - {column: Trans (mm), aggregate: p95, max: 5, exclusive: true}   # max, min, mean, median, p95
      - {column: Status, matches: "ok|done"}                    # contains, does-not-contain, matches
      - {column: RMS (pix), row: Averages, max-increase: 10%}   # against the baseline; also max-decrease
    key-column: "Collection #"      # column of the labels; else found automatically
    required-rows: ["000", "001"]   # labels that must exist
    min-rows: 20                    # of "every row"; default 1
    summary-rows: [Averages]        # rows that summarise others ...
    exclude-summary-rows: true      # ... are excluded from "every row", aggregates and min-rows
    file: results/*.csv             # default input of the command

Limits are inclusive unless ``exclusive`` is true. ``matches`` is a regular expression for the whole
cell. A rule may have limits for one row and, as ``every-min`` and ``every-max``, for every row.
"""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from decimal import Decimal
from typing import Annotated, Any, TypeAlias

from calibration.base.errors import InputError
from calibration.base.records import Constraint, Converted, Misfit, Place, at_least, field, length, read, record
from calibration.base.tables import table
from calibration.base.text import number_text, parse_number


@dataclass(frozen=True)
class Allowance:
    """Allowed deviation from the baseline, in one direction."""

    amount: float
    """Allowed change, in the column's unit or in percent of the baseline's absolute value; not negative."""
    relative: bool

    def __str__(self) -> str:
        return number_text(self.amount) + ("%" if self.relative else "")

    def above(self, baseline: float) -> float:
        """Return the largest allowed number, in exact decimal arithmetic."""
        return float(Decimal(repr(baseline)) + self._allowed_change(baseline))

    def below(self, baseline: float) -> float:
        """Return the smallest allowed number, in exact decimal arithmetic."""
        return float(Decimal(repr(baseline)) - self._allowed_change(baseline))

    def _allowed_change(self, baseline: float) -> Decimal:
        amount = Decimal(repr(self.amount))
        return amount * abs(Decimal(repr(baseline))) / 100 if self.relative else amount


def parse_allowance(text: str) -> Allowance:
    """Parse an allowance: ``0.1`` in the column's unit, ``10%`` of the baseline.

    Raises :class:`InputError` for anything else, and for negative values.
    """
    number = text.strip()
    amount = parse_number(number.removesuffix("%").rstrip())
    if amount is None or amount < 0:
        raise InputError(f"{text!r} is no allowance: give 0.1 (in the column's unit) or 10% (of the baseline)")
    return Allowance(amount, relative=number.endswith("%"))


@dataclass(frozen=True)
class Limits:
    """Interval of numbers; None means unbounded."""

    minimum: float | None = None
    maximum: float | None = None
    exclusive: bool = False
    """Whether the limits themselves are excluded."""

    def admit(self, value: float) -> bool:
        """Return whether a value is within the limits; False for NaN."""
        if self.exclusive:
            return (self.minimum is None or value > self.minimum) and (self.maximum is None or value < self.maximum)
        return (self.minimum is None or value >= self.minimum) and (self.maximum is None or value <= self.maximum)

    def contradict(self, other: "Limits") -> bool:
        """Return whether the intersection with another interval is empty."""
        lows = [limits.minimum for limits in (self, other) if limits.minimum is not None]
        highs = [limits.maximum for limits in (self, other) if limits.maximum is not None]
        if not lows or not highs or max(lows) < min(highs):
            return False
        return not (self.admit(max(lows)) and other.admit(max(lows)))

    def __str__(self) -> str:
        low, high = ("more than", "less than") if self.exclusive else ("at least", "at most")
        parts = [] if self.minimum is None else [f"{low} {number_text(self.minimum)}"]
        parts += [] if self.maximum is None else [f"{high} {number_text(self.maximum)}"]
        return " and ".join(parts)


@dataclass(frozen=True)
class LimitRule:
    """Numbers of a column must be within limits."""

    column: str
    target: table.Target
    limits: Limits

    def __str__(self) -> str:
        return str(self.limits)


@dataclass(frozen=True)
class TextRule:
    """Texts of a column must contain, not contain, or fully match a text; None means no condition."""

    column: str
    target: table.Target
    contains: str | None = None
    does_not_contain: str | None = None
    matches: re.Pattern[str] | None = None

    def admit(self, text: str) -> bool:
        """Return whether a text meets the conditions."""
        return (
            (self.contains is None or self.contains in text)
            and (self.does_not_contain is None or self.does_not_contain not in text)
            and (self.matches is None or self.matches.fullmatch(text) is not None)
        )

    def contradicts_itself(self) -> bool:
        """Return whether a required text is also forbidden."""
        return (
            self.contains is not None and self.does_not_contain is not None and self.does_not_contain in self.contains
        )

    def __str__(self) -> str:
        parts = [] if self.contains is None else [f"text that contains {self.contains!r}"]
        parts += [] if self.does_not_contain is None else [f"text that does not contain {self.does_not_contain!r}"]
        parts += [] if self.matches is None else [f"text that matches {self.matches.pattern!r}"]
        return " and ".join(parts)


@dataclass(frozen=True)
class ChangeRule:
    """Numbers of a column must not deviate from the baseline by more than allowed; None means any deviation."""

    column: str
    target: table.Target
    increase: Allowance | None = None
    decrease: Allowance | None = None

    def limits(self, baseline: float) -> Limits:
        """Return the limits for a number, given its baseline."""
        return Limits(
            None if self.decrease is None else self.decrease.below(baseline),
            None if self.increase is None else self.increase.above(baseline),
        )

    def __str__(self) -> str:
        parts = [] if self.decrease is None else [f"at least the baseline - {self.decrease}"]
        parts += [] if self.increase is None else [f"at most the baseline + {self.increase}"]
        return " and ".join(parts)


Rule: TypeAlias = LimitRule | TextRule | ChangeRule


SUMMARY_ROWS = ("Averages",)
"""Default labels of rows that summarise others."""

_LIMIT_KEYS = ("min", "max")
_EVERY_KEYS = ("every-min", "every-max")
_TEXT_KEYS = ("contains", "does-not-contain", "matches")
_CHANGE_KEYS = ("max-increase", "max-decrease")


def _with_place(parse: Callable[[Any], Any]) -> Callable[[Any, Place], Any]:
    """Turn a function that raises messages without a position into one for `Converted`."""

    def make(value: Any, place: Place) -> Any:
        try:
            return parse(value)
        except InputError as error:
            raise place.fault(str(error)) from None

    return make


def _strip_text(value: str) -> str:
    if not value.strip():
        raise InputError("the text is empty")
    return value.strip()


def _parse_pattern(value: str) -> re.Pattern[str]:
    try:
        return re.compile(value)
    except (re.error, OverflowError, RecursionError) as error:
        raise InputError(f"{value!r} is no regular expression: {error}") from None


def _parse_finite(value: object) -> float | None:
    return parse_number(str(value).strip())


Text = Annotated[str, length(1)]
Name = Annotated[str, Converted(str, _with_place(_strip_text))]
"""Return text without surrounding white space."""
Number = Annotated[
    float,
    Converted(
        Annotated[
            str | float, Constraint(lambda value: _parse_finite(value) is not None, "a finite number", whole=True)
        ],
        lambda value, _: _parse_finite(value),
    ),
]
"""Return a number; text is accepted too, because YAML 1.1 reads ``1e-3`` as text."""
Change = Annotated[Allowance, Converted(str | float, _with_place(lambda value: parse_allowance(str(value))))]


@record
class RuleEntry:
    """A rule in a document: for one row or aggregate, for every row, or for both."""

    column: Name = field("Column of the rule.")
    row: Annotated[table.LabelledRow | table.IndexedRow, Converted(Name, _with_place(table.parse_row))] | None = field(
        "The row that is judged: its label, first, last or index:3.", default=None
    )
    aggregate: Annotated[table.Aggregate, Converted(Name, _with_place(table.parse_aggregate))] | None = field(
        "Judge one number made from every row: max, min, mean, median or p95.", default=None
    )
    every: bool = field("Whether every row is judged; so it is without row and aggregate.", default=False)
    min: Number | None = field(
        "Smallest number that passes, for the row or aggregate, else for every row.", default=None
    )
    max: Number | None = field(
        "Largest number that passes, for the row or aggregate, else for every row.", default=None
    )
    exclusive: bool = field("A number equal to a limit does not pass.", default=False)
    every_min: Number | None = field("Smallest number that passes in every row.", default=None)
    every_max: Number | None = field("Largest number that passes in every row.", default=None)
    contains: Text | None = field("Text that the cell contains.", default=None)
    does_not_contain: Text | None = field("Text that the cell does not contain.", default=None)
    matches: Annotated[re.Pattern[str], Converted(Text, _with_place(_parse_pattern))] | None = field(
        "Regular expression that the whole cell matches.", default=None
    )
    max_increase: Change | None = field("Largest increase against the baseline: 0.1, or 10%.", default=None)
    max_decrease: Change | None = field("Largest decrease against the baseline: 0.1, or 10%.", default=None)

    def __post_init__(self) -> None:
        """Reject keys that contradict each other, and a rule without a limit."""
        numeric, texts = self._given_keys(*_LIMIT_KEYS, *_EVERY_KEYS, *_CHANGE_KEYS), self._given_keys(*_TEXT_KEYS)
        targets = [target for target in (self.row, self.aggregate, table.EveryRow() if self.every else None) if target]
        chosen = self._given_keys("row", "aggregate")
        fault = ""
        if len(targets) > 1:
            fault = f"give one of row, aggregate, every, found {' and '.join(map(str, targets))}"
        elif not numeric and not texts:
            fault = "the rule has no limit: give min, max, contains, matches, max-increase or another"
        elif numeric and texts:
            fault = f"{numeric[0]} is for numbers and {texts[0]} for text: make two rules of it"
        elif texts and self.aggregate:
            fault = f"{texts[0]} is for text, of which there is no {self.aggregate.name}"
        elif chosen and not self._given_keys(*_LIMIT_KEYS, *_TEXT_KEYS, *_CHANGE_KEYS):
            fault = f"a {chosen[0]} is chosen but has no limit: give min or max, or leave it out"
        elif not chosen and self._given_keys(*_LIMIT_KEYS) and self._given_keys(*_EVERY_KEYS):
            fault = "min, max and every-min, every-max are all for every row: choose a row for min, max"
        elif self.exclusive and not self._given_keys(*_LIMIT_KEYS, *_EVERY_KEYS):
            fault = "exclusive is for min, max, every-min and every-max, and there is none"
        if fault:
            raise Misfit(f"{self.column}: {fault}")

    def _given_keys(self, *keys: str) -> list[str]:
        return [key for key in keys if getattr(self, key.replace("-", "_")) is not None]

    @property
    def rules(self) -> tuple[Rule, ...]:
        """Return the rules that the entry defines."""
        target: table.Target = self.row or self.aggregate or table.EveryRow()
        rules: list[Rule] = []
        if self._given_keys(*_LIMIT_KEYS):
            rules.append(LimitRule(self.column, target, Limits(self.min, self.max, self.exclusive)))
        if self._given_keys(*_EVERY_KEYS):
            rules.append(
                LimitRule(self.column, table.EveryRow(), Limits(self.every_min, self.every_max, self.exclusive))
            )
        if self._given_keys(*_TEXT_KEYS):
            rules.append(TextRule(self.column, target, self.contains, self.does_not_contain, self.matches))
        if self._given_keys(*_CHANGE_KEYS):
            rules.append(ChangeRule(self.column, target, self.max_increase, self.max_decrease))
        return tuple(rules)


def unfolded(entries: Sequence[RuleEntry]) -> tuple[Rule, ...]:
    """Return the rules that entries define."""
    return tuple(rule for entry in entries for rule in entry.rules)


@record
class RuleSet:
    """Rules for a table; None means unset."""

    rules: Annotated[tuple[Rule, ...], Converted(tuple[RuleEntry, ...], lambda entries, _: unfolded(entries))] = field(
        "What the cells of columns must be.", default=()
    )
    key_column: Name | None = field("Column of the rows' labels (found unless given).", default=None)
    required_rows: tuple[Name, ...] | None = field("Labels of rows that must be there.", default=None)
    min_rows: Annotated[int, at_least(1)] | None = field("Smallest number of rows (1 unless given).", default=None)
    summary_rows: tuple[Name, ...] | None = field("Labels of the summary rows (Averages unless given).", default=None)
    exclude_summary_rows: bool | None = field("Summary rows are no part of every row.", default=None)
    file: Name | None = field("CSV files; patterns such as results/**/*.csv too.", default=None)

    @property
    def judges(self) -> bool:
        """Whether there is anything to judge."""
        return bool(self.rules or self.required_rows or self.min_rows is not None)

    @property
    def compares(self) -> bool:
        """Whether a baseline is required."""
        return any(isinstance(rule, ChangeRule) for rule in self.rules)

    @property
    def excluded_rows(self) -> tuple[str, ...]:
        """The labels that are excluded from "every row"."""
        return (SUMMARY_ROWS if self.summary_rows is None else self.summary_rows) if self.exclude_summary_rows else ()

    def overridden_by(self, other: "RuleSet") -> "RuleSet":
        """Return these rules followed by the other's; the other's set values take precedence."""
        names = [field.name for field in fields(other) if field.name != "rules"]
        given = {name: value for name in names if (value := getattr(other, name)) is not None}
        return replace(self, rules=self.rules + other.rules, **given)


def parse_rules(document: object, where: str) -> RuleSet:
    """Parse a rule set from the content of a YAML or JSON file.

    ``where`` is the prefix of messages (``calibration.yml: systems.t2rgb.rules``). Raises
    :class:`InputError`: for an unknown key, a value of the wrong type, a rule without a
    limit, with limits that contradict each other, or for numbers and text at once, and when
    nothing at all would be judged.
    """
    return checked(read(RuleSet, {"rules": document} if isinstance(document, list) else document, where), where)


def checked(rule_set: RuleSet, where: str) -> RuleSet:
    """Return the rules after checking that they judge something and are consistent; else raise :class:`InputError`."""
    _refuse_contradictions(rule_set.rules, where)
    if not rule_set.judges:
        raise InputError(f"{where}: there is no rule, so nothing would be judged")
    return rule_set


def _refuse_contradictions(rules: Sequence[Rule], where: str) -> None:
    """Raise :class:`InputError` if limits for the same cells exclude every value."""
    limits: dict[tuple[str, table.Target], list[Limits]] = {}
    for rule in rules:
        if isinstance(rule, TextRule) and rule.contradicts_itself():
            raise InputError(f"{where}: contains and does-not-contain contradict each other: {rule}")
        if isinstance(rule, LimitRule):
            same = limits.setdefault((rule.column, rule.target), [])
            same.append(rule.limits)
            for other in same:
                if rule.limits.contradict(other):
                    both = f"{other}" if other == rule.limits else f"{other}, but {rule.limits}"
                    raise InputError(f"{where}: no number can be as asked in {rule.column!r}, {rule.target}: {both}")
