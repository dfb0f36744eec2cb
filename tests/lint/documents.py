"""check-jsonschema over every document of the project that has a schema, and over the YAML in its READMEs."""

import json
import re
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from importlib.resources import files
from pathlib import Path
from typing import Any

import yaml

from calibration.commands.schema import SHIPPED_SCHEMAS

from .yaml_lines import ACTIONS, PROJECT, WORKFLOWS

CHECK = Path(sys.executable).with_name("check-jsonschema")
WORKFLOW, ACTION, GITLAB = "vendor.github-workflows", "vendor.github-actions", "vendor.gitlab-ci"

DOCUMENTS = {
    WORKFLOW: WORKFLOWS,
    ACTION: ACTIONS,
    "vendor.github-issue-forms": [*PROJECT.glob(".github/ISSUE_TEMPLATE/*-*.yml")],
    "calibration.yml": [
        PROJECT / "calibration.yml",
        *PROJECT.glob("examples/*/calibration.yml"),
        *PROJECT.glob("tests/addons/rigel/rigelfiles/*.calibration.yml"),  # what import-rigelfile writes
    ],
    "import.yml": [PROJECT / "tests/robot/importing/import.yml"],
    "scenario-set": [*PROJECT.glob("datasets/**/scenarios.yml")],
    "collection": [*PROJECT.glob("datasets/*/results.json")],
}
"""The files by their schema: a built-in one of check-jsonschema, or one of ``calibration schema``."""

READMES = [PROJECT / "README.md", *PROJECT.glob("examples/*/README.md"), *PROJECT.glob("docs/*.md")]
PARTS = {
    "include": (GITLAB, lambda part: part),
    "calibration": (GITLAB, lambda part: part),
    "uses": (WORKFLOW, lambda part: {"on": "push", "jobs": {"job": {"runs-on": "ubuntu-latest", "steps": part}}}),
    "jobs": (WORKFLOW, lambda part: {"on": "push", **part}),
    **{
        key: ("calibration.yml", lambda part: {"systems": {"any": {"dataset": "any"}}, **part})
        for key in ("image", "aws-batch", "baseline", "exports", "analysis", "requirements")
    },
    "systems": ("calibration.yml", lambda part: part),
    "tasks": ("calibration.yml", lambda part: {"systems": {"any": {"dataset": "any", **part}}}),
    "simulation": ("calibration.yml", lambda part: part),
    "patterns": ("import.yml", lambda part: part),
    # config.yml and simulation.yml have no schema; read in tests/actions/test_contract.py and tests/robot/simulation
    "sensors": (None, None),
    "joints": (None, None),
    "calibration_patterns": (None, None),
}
"""What a block of YAML in a README is a part of, by a key in it: the schema, and how the block becomes a document."""


def findings() -> Iterator[str]:
    """What is wrong in the whole project, a line each."""
    with tempfile.TemporaryDirectory() as folder:
        documents = {schema: list(paths) for schema, paths in DOCUMENTS.items()}
        for readme in READMES:
            for line, text in yaml_blocks(readme.read_text()):
                try:
                    schema, document = made_whole(yaml.safe_load(text))
                except (yaml.YAMLError, LookupError, TypeError) as error:
                    yield f"{readme.relative_to(PROJECT)}:{line}: {error}"
                    continue
                if schema is not None:
                    path = Path(folder) / f"{str(readme.relative_to(PROJECT)).replace('/', ' ')}, line {line}.json"
                    path.write_text(json.dumps(document))
                    documents.setdefault(schema, []).append(path)
        for schema, paths in documents.items():
            for line in check(schema, paths):
                yield line.replace(f"{folder}/", "")


def yaml_blocks(markdown: str) -> Iterator[tuple[int, str]]:
    """The blocks of YAML in a text, each with its first line."""
    for found in re.finditer(r"^```yaml\n(.*?)^```$", markdown, re.MULTILINE | re.DOTALL):
        yield markdown[: found.start(1)].count("\n") + 1, found[1]


def made_whole(part: Any) -> tuple[str | None, Any]:
    """The schema of what a README shows, if there is one, and a document with it.

    Raises:
        LookupError: it is a part of nothing that is known.
    """
    keys = part[0] if isinstance(part, list) else part
    for key, (schema, whole) in PARTS.items():
        if key in keys:
            if True in keys:  # YAML 1.1 reads `on` as true
                part = {"on" if name is True else name: value for name, value in part.items()}
            return schema, whole(part) if whole else None
    raise LookupError("a block of YAML of no kind that can be checked")


def check(schema: str, paths: list[Path]) -> Iterator[str]:
    """What check-jsonschema says of files."""
    if schema in SHIPPED_SCHEMAS:
        shipped = SHIPPED_SCHEMAS[schema]
        arguments = ["--schemafile", str(files(shipped.package).joinpath(shipped.file))]
    else:
        arguments = ["--builtin-schema", schema]
    command = [str(CHECK), "--color", "never", *arguments, *map(str, paths)]
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode:
        yield (done.stdout + done.stderr).replace(f"{PROJECT}/", "").strip()


if __name__ == "__main__":
    found = list(findings())
    print(*found, sep="\n", end="\n" if found else "")
    sys.exit(bool(found))
