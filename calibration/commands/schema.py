"""``schema``: print the JSON Schemas of files, for editors and other programs."""

import sys
from importlib.resources import files

import click

from calibration.base import ExitCode
from calibration.base.addons import SchemaFile, import_attribute, of_addons
from calibration.base.records.schema import schema_text
from calibration.ci.report import Head

_PIPELINE_PACKAGE, _COLLECTION_PACKAGE = "calibration.pipeline", "calibration.pipeline.collection"
_CONVERGENCE_PACKAGE, _SCENARIOS_PACKAGE = "calibration.pipeline.convergence", "calibration.robot.simulation.scenarios"
_RESULTS_FILE = "results.schema.json"
SHIPPED_SCHEMAS = {
    "calibration.yml": SchemaFile(_PIPELINE_PACKAGE, "calibration.schema.json", "configuration:PipelineConfiguration"),
    "baseline": SchemaFile("calibration.engine.baseline", "baseline.schema.json", "document:Baseline"),
    "image": SchemaFile("calibration.ci.image", "image.schema.json", "specification:ImageDocument"),
    "results": SchemaFile(_PIPELINE_PACKAGE, _RESULTS_FILE, "gathering:RunResults", "calibrate-matrix and run"),
    "repeated-results": SchemaFile(
        f"{_PIPELINE_PACKAGE}.repetition", _RESULTS_FILE, "results:RepeatedResults", "repeated runs"
    ),
    "next-poses": SchemaFile(
        _PIPELINE_PACKAGE,
        "next_poses.schema.json",
        "next_poses:NextPosesOfSystems",
        "next-pose and plan-recording",
    ),
    "convergence": SchemaFile(
        _CONVERGENCE_PACKAGE, "convergence.schema.json", "convergence_map:ConvergenceResults", "convergence"
    ),
    "collection": SchemaFile(
        _COLLECTION_PACKAGE, "collection.schema.json", "results:CollectionDocument", "collect-data-sim"
    ),
    "simulation.yml": SchemaFile("calibration.robot.simulation", "simulation.schema.json", "system:Simulation"),
    "motion": SchemaFile("calibration.robot.simulation", "motion.schema.json", "motion:MotionFile"),
    "import.yml": SchemaFile("calibration.robot.importing", "import.schema.json", "description:ImportDescription"),
    "import-results": SchemaFile("calibration.robot.importing", _RESULTS_FILE, "results:ImportResults", "import-data"),
    "look-results": SchemaFile("calibration.robot.importing", "look.schema.json", "results:LookResults", "look"),
    "label-results": SchemaFile("calibration.robot.importing", "label.schema.json", "results:LabelResults", "label"),
    "scenario-set": SchemaFile(_SCENARIOS_PACKAGE, "scenario_set.schema.json", "scenario_set:ScenarioSetFile"),
    "image-results": SchemaFile("calibration.ci.image", _RESULTS_FILE, "building:BuildResult", "build-image"),
    "introspection": SchemaFile("calibration.base.tables", _RESULTS_FILE, "table_verdict:Results", "introspect-csv"),
    **of_addons(lambda addon: addon.schemas),
}
"""JSON Schemas by name."""


@click.command("schema")
@click.argument("name", type=click.Choice(list(SHIPPED_SCHEMAS)), default="calibration.yml")
def command(name: str) -> ExitCode:
    """Print a JSON Schema: of calibration.yml, of another input file, or of the results of a command."""
    shipped = SHIPPED_SCHEMAS[name]
    sys.stdout.write(files(shipped.package).joinpath(shipped.file).read_text(encoding="utf-8"))
    return ExitCode.PASS


def generated(name: str) -> str:
    """Return the text of a schema, generated from its record."""
    shipped = SHIPPED_SCHEMAS[name]
    record = import_attribute(f"{shipped.package}.{shipped.record}")
    if shipped.command:
        return schema_text(record, f"results.json of {shipped.command}", Head)
    return schema_text(record, name)
