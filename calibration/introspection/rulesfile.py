"""Rule files: YAML, or a Rigelfile."""

from pathlib import Path

from calibration.introspection.rigelfile import find_columns, translate
from calibration.introspection.rule_set import RuleSet, parse_rules
from calibration.yaml_file import read_yaml


def read_rules(path: str | Path) -> RuleSet:
    """Read rules from a YAML file (see :mod:`calibration.introspection.rule_set`) or from a Rigelfile.

    Raises :class:`InputError` that names the file and the error.
    """
    document = read_yaml(path, "a file of rules")
    settings = find_columns(document, str(path))
    return parse_rules(document if settings is None else translate(settings, str(path)), str(path))
