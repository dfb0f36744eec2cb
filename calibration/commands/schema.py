"""``schema``: the JSON Schemas that ship, for editors and other programs."""

import sys
from importlib.resources import files

import click

from calibration.errors import ExitCode

SCHEMAS = {
    "calibration.yml": ("calibration.pipeline", "calibration.schema.json"),
    "results": ("calibration.pipeline", "results.schema.json"),
    "collection": ("calibration.pipeline.collection", "collection.schema.json"),
    "scenario-set": ("calibration.simulation.scenarios", "scenario_set.schema.json"),
    "introspection": ("calibration.introspection", "results.schema.json"),
}
"""What there is a schema of: package and file."""


@click.command("schema")
@click.argument("name", type=click.Choice(list(SCHEMAS)), default="calibration.yml")
def command(name: str) -> ExitCode:
    """Print a JSON Schema: of calibration.yml, of a scenario set, or of the results of a command."""
    package, file = SCHEMAS[name]
    sys.stdout.write(files(package).joinpath(file).read_text(encoding="utf-8"))
    return ExitCode.PASS
