"""Analyser zizmor: workflows and actions of GitHub."""

import json
import re
from collections.abc import Sequence
from typing import Any

import yaml

from calibration.addons.analysis.analysers.analyser import Analyser, arguments, in_repository
from calibration.addons.analysis.copies import Copy
from calibration.addons.analysis.finding import CodeFinding, Severity
from calibration.addons.analysis.programs import program, run_program

_WORKFLOWS_AND_ACTIONS = re.compile(r"\.github/workflows/[^/]+\.ya?ml|(.*/)?action\.ya?ml")
_SEVERITY_OF_LEVEL: dict[str, Severity] = {"High": "error", "Medium": "warning"}


class Zizmor(Analyser):
    """Security of workflows and composite actions, offline."""

    name = "zizmor"
    settings = ("zizmor.yml", "zizmor.yaml")

    def wants(self, path: str, copy: Copy) -> bool:
        """Select workflows and actions; invalid YAML is reported by yamllint."""
        return bool(_WORKFLOWS_AND_ACTIONS.fullmatch(path)) and _is_mapping(copy.text(path))

    def findings(self, copy: Copy, files: Sequence[str], seconds: float) -> list[CodeFinding]:
        """Run zizmor and parse its output."""
        command = [program("zizmor"), "--offline", "--no-exit-codes", "--no-progress", "--quiet", "--format", "json-v1"]
        result = run_program(self.name, [*command, "--", *arguments(files)], copy.root, seconds, (0,))
        return [
            _finding_of_entry(entry, copy) for entry in json.loads(result.output or "[]") if not entry.get("ignored")
        ]


def _is_mapping(text: str) -> bool:
    try:
        events = yaml.parse(text, Loader=getattr(yaml, "CSafeLoader", yaml.SafeLoader))  # the other one takes minutes
        return any(isinstance(event, yaml.MappingStartEvent) for event in list(events)[:3])
    except (yaml.YAMLError, RecursionError):
        return False


def _finding_of_entry(entry: dict[str, Any], copy: Copy) -> CodeFinding:
    places = entry["locations"]
    primary = next((each for each in places if each["symbolic"].get("kind") == "Primary"), places[0])
    path = in_repository(primary["symbolic"]["key"]["Local"]["verbatim_path"], copy)
    line = primary["concrete"]["location"]["start_point"]["row"] + 1
    severity = _SEVERITY_OF_LEVEL.get(entry["determinations"]["severity"], "note")
    message = f"{entry['desc']}: {primary['symbolic'].get('annotation', '')}"
    return CodeFinding(path, line, f"zizmor/{entry['ident']}", "security", severity, message)
