"""``schema``: the JSON Schemas that ship, for editors and other programs."""

import sys
from importlib import import_module
from importlib.resources import files

import click

from calibration.errors import ExitCode
from calibration.records import schema_text
from calibration.report import Head

SCHEMAS = {
    "calibration.yml": ("calibration.pipeline", "calibration.schema.json"),
    "image": ("calibration.image", "image.schema.json"),
    "aws-batch": ("calibration.execution.batch", "batch.schema.json"),
    "results": ("calibration.pipeline", "results.schema.json"),
    "convergence": ("calibration.pipeline.convergence", "convergence.schema.json"),
    "collection": ("calibration.pipeline.collection", "collection.schema.json"),
    "simulation.yml": ("calibration.simulation", "simulation.schema.json"),
    "motion": ("calibration.simulation.motion", "motion.schema.json"),
    "scenario-set": ("calibration.simulation.scenarios", "scenario_set.schema.json"),
    "coverage": ("calibration.coverage", "results.schema.json"),
    "image-results": ("calibration.image", "results.schema.json"),
    "introspection": ("calibration.introspection", "results.schema.json"),
}
"""What there is a schema of: package and file."""
RECORDS = {
    "calibration.yml": "calibration.pipeline.configuration:Configuration",
    "simulation.yml": "calibration.simulation.system:Simulation",
    "motion": "calibration.simulation.motion.sequence:MotionFile",
    "scenario-set": "calibration.simulation.scenarios.parameters:ScenarioSetFile",
    "image": "calibration.image.specification:ImageDocument",
    "aws-batch": "calibration.execution.batch.settings:BatchFile",
    "results": "calibration.pipeline.distribution.gathering:RunResults",
    "collection": "calibration.pipeline.collection.results:CollectionDocument",
    "convergence": "calibration.pipeline.convergence.results:ConvergenceResults",
    "coverage": "calibration.coverage.results:Results",
    "image-results": "calibration.image.report:BuildResult",
    "introspection": "calibration.introspection.result:Results",
}
"""The records from which those schemas are written (`make actions`) that are not written by hand."""
RESULTS_OF = {
    "results": "calibrate-matrix and run",
    "convergence": "convergence",
    "collection": "collect-data-sim",
    "coverage": "coverage-upload",
    "image-results": "build-image",
    "introspection": "introspect-csv",
}
"""The commands whose results.json a schema describes."""


@click.command("schema")
@click.argument("name", type=click.Choice(list(SCHEMAS)), default="calibration.yml")
def command(name: str) -> ExitCode:
    """Print a JSON Schema: of calibration.yml, of another file that is read, or of the results of a command."""
    package, file = SCHEMAS[name]
    sys.stdout.write(files(package).joinpath(file).read_text(encoding="utf-8"))
    return ExitCode.PASS


def generated(name: str) -> str:
    """The text of a schema that is written from its record."""
    module, _, kind = RECORDS[name].partition(":")
    record = getattr(import_module(module), kind)
    if name in RESULTS_OF:
        return schema_text(record, f"results.json of {RESULTS_OF[name]}", Head)
    return schema_text(record, name)
