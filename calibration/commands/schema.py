"""``schema``: print the JSON Schemas of files, for editors and other programs."""

import sys
from importlib import import_module
from importlib.resources import files
from typing import NamedTuple

import click

from calibration.base.errors import ExitCode
from calibration.base.records.schema import schema_text
from calibration.ci.report import Head


class Shipped(NamedTuple):
    """A JSON Schema in the package, and the record that generates it (`make actions`)."""

    package: str
    file: str
    record: str
    """``module:class``; the module is relative to the package."""
    command: str = ""
    """Command whose results.json it describes."""


_PIPELINE, _COLLECTION = "calibration.pipeline", "calibration.pipeline.collection"
_CONVERGENCE, _SCENARIOS = "calibration.pipeline.convergence", "calibration.robot.simulation.scenarios"
_RESULTS = "results.schema.json"
SCHEMAS = {
    "calibration.yml": Shipped(_PIPELINE, "calibration.schema.json", "configuration:Configuration"),
    "baseline": Shipped("calibration.engine.baseline", "baseline.schema.json", "document:Baseline"),
    "image": Shipped("calibration.ci.image", "image.schema.json", "specification:ImageDocument"),
    "aws-batch": Shipped("calibration.addons.aws_batch", "batch.schema.json", "settings:BatchFile"),
    "results": Shipped(_PIPELINE, _RESULTS, "distribution.gathering:RunResults", "calibrate-matrix and run"),
    "convergence": Shipped(_CONVERGENCE, "convergence.schema.json", "results:ConvergenceResults", "convergence"),
    "collection": Shipped(_COLLECTION, "collection.schema.json", "results:CollectionDocument", "collect-data-sim"),
    "simulation.yml": Shipped("calibration.robot.simulation", "simulation.schema.json", "system:Simulation"),
    "motion": Shipped("calibration.robot.simulation.motion", "motion.schema.json", "sequence:MotionFile"),
    "import.yml": Shipped("calibration.robot.importing", "import.schema.json", "description:ImportDescription"),
    "import-results": Shipped("calibration.robot.importing", _RESULTS, "results:ImportResults", "import-data"),
    "look-results": Shipped("calibration.robot.importing", "look.schema.json", "look.results:LookResults", "look"),
    "label-results": Shipped("calibration.robot.importing", "label.schema.json", "results:LabelResults", "label"),
    "scenario-set": Shipped(_SCENARIOS, "scenario_set.schema.json", "parameters:ScenarioSetFile"),
    "coverage": Shipped("calibration.addons.coverage", _RESULTS, "results:Results", "coverage-upload"),
    "image-results": Shipped("calibration.ci.image", _RESULTS, "report:BuildResult", "build-image"),
    "analysis": Shipped("calibration.addons.analysis", _RESULTS, "results:Results", "static-analysis"),
    "introspection": Shipped("calibration.base.tables", _RESULTS, "result:Results", "introspect-csv"),
}
"""JSON Schemas by name."""


@click.command("schema")
@click.argument("name", type=click.Choice(list(SCHEMAS)), default="calibration.yml")
def command(name: str) -> ExitCode:
    """Print a JSON Schema: of calibration.yml, of another input file, or of the results of a command."""
    shipped = SCHEMAS[name]
    sys.stdout.write(files(shipped.package).joinpath(shipped.file).read_text(encoding="utf-8"))
    return ExitCode.PASS


def generated(name: str) -> str:
    """Return the text of a schema, generated from its record."""
    shipped = SCHEMAS[name]
    module, _, kind = shipped.record.partition(":")
    record = getattr(import_module(f"{shipped.package}.{module}"), kind)
    if shipped.command:
        return schema_text(record, f"results.json of {shipped.command}", Head)
    return schema_text(record, name)
