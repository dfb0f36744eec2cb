"""Rule files: YAML, or a Rigelfile."""

from pathlib import Path

from calibration.base.tables.rule_set import RuleSet, parse_rules
from calibration.base.yaml_file import read_yaml
from calibration.ci.introspection.rigelfile_rules import find_columns, translate


def read_rules(path: str | Path) -> RuleSet:
    """Read rules from a YAML file (see :mod:`calibration.base.tables.rule_set`) or from a Rigelfile.

    Raises :class:`InputError` that names the file and the error.
    """
    document = read_yaml(path, "a file of rules")
    settings = find_columns(document, str(path))
    return parse_rules(document if settings is None else translate(settings, str(path)), str(path))
