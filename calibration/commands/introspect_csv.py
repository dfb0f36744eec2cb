"""``introspect-csv``: check tables against rules."""

from dataclasses import replace
from typing import Any

import click

from calibration.base import ExitCode, InputError
from calibration.base.files import matching
from calibration.base.records import flat_fields, read
from calibration.base.tables.rules import RuleEntry, RuleSet, checked
from calibration.base.tables.table import parse_delimiter, read_table
from calibration.base.tables.table_verdict import judge
from calibration.ci.introspection import introspection_report, read_rules
from calibration.ci.report import FILES, publish, remove_results
from calibration.ci.workflow import Runner
from calibration.commands.parameters import TEXT_LIST, ActionInput, path, record_options, text


@click.command("introspect-csv")
@click.option("--file", type=TEXT_LIST, help="CSV files; patterns such as results/**/*.csv too.")
@click.option("--rules", type=path, help="YAML file of rules, or a Rigelfile.")
@record_options(
    RuleEntry,
    *("column", "row", "aggregate", "min", "max", "every-min", "every-max", "exclusive"),
    helps={"column": "Column of the rule that the next options make."},
)
@click.option("--contains", help="Text that the cell contains.")
@click.option("--does-not-contain", help="Text that the cell does not contain.")
@click.option("--matches", help="Regular expression that the whole cell matches.")
@record_options(RuleEntry, "max-increase", "max-decrease")
@click.option(
    *("--base-csv", "--baseline"),
    cls=ActionInput,
    formerly="baseline",
    type=path,
    help="CSV file that max-increase and max-decrease compare with.",
)
@record_options(RuleSet, "required-rows", "min-rows", "key-column", "exclude-summary-rows", "summary-rows")
@click.option("--delimiter", help="comma, semicolon, tab, pipe or a character (detected).")
@click.option("--encoding", type=text, help="Text encoding (detected).")
@click.option("--output", type=path, help="Folder for results.json, junit.xml and summary.md.")
def command(**options: Any) -> ExitCode:
    """Check tables against rules; the verdict is fail if a value breaks one.

    Rules are read from a file, from the options (one column), or both.
    """
    given = {name.replace("_", "-"): value for name, value in options.items() if value not in (None, ())}
    rules = _rules_of_options(given)
    files = given.get("file") or ((rules.file,) if rules.file else ())
    if not files:
        raise InputError("file is not given: name the CSV files to judge")
    if rules.compares and "base-csv" not in given:
        raise InputError("base-csv is not given: max-increase and max-decrease need one to compare with")
    if not rules.compares and "base-csv" in given:
        raise InputError("base-csv is given but no max-increase or max-decrease, so nothing would be compared with it")
    output = given.get("output")
    remove_results(output, FILES)  # so that they are not mistaken for current ones
    delimiter = parse_delimiter(given["delimiter"]) if "delimiter" in given else None
    encoding = given.get("encoding")
    tables = [read_table(file, delimiter, encoding) for file in matching(files)]
    baseline = read_table(given["base-csv"], delimiter, encoding) if "base-csv" in given else None
    found = introspection_report([judge(table, rules, baseline) for table in tables])
    return publish(found, Runner.from_environment(), output)


def _rules_of_options(given: dict[str, Any]) -> RuleSet:
    """Return the rules of the file, followed by those of the options (one column)."""
    document = {key: list(value) if isinstance(value, tuple) else value for key, value in given.items()}
    rule = {key: document[key] for key in flat_fields(RuleEntry) if document.get(key, False) is not False}
    table = {key: document[key] for key in flat_fields(RuleSet) if key in document and key not in ("rules", "file")}
    if rule and "column" not in rule:
        raise InputError(f"{next(iter(rule))} is given without the column that it is for")
    options = read(RuleSet, table, "options")
    if rule:
        options = replace(options, rules=read(RuleEntry, rule, "options").rules)
    if "rules" not in given:
        return checked(options, "options")
    return checked(read_rules(given["rules"]).overridden_by(options), f"{given['rules']} and options")
