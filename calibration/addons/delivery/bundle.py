"""``bundle``: pack what systems that passed and are accepted leave for their robot, with a signed statement."""

import os
from pathlib import Path
from typing import Any

import click

from calibration.addons.delivery.bundling import BUNDLE_FOLDER, RunToBundle, make_bundle, with_collected, write_bundle
from calibration.addons.delivery.results import KEY_VARIABLE, BundleResults, Delivered, DeliverySettings
from calibration.base import ExitCode, InputError, one_line
from calibration.base.records import changed, field, record
from calibration.ci.execution.tasks import locked
from calibration.ci.report import remove_results
from calibration.ci.workflow import Level, Runner, add_mask, annotate, set_outputs, stop_commands
from calibration.ci.workflow.runner import Annotation
from calibration.commands.parameters import chosen, given, masked_secret, record_options
from calibration.engine.baseline.quality import BaselineSettings
from calibration.pipeline.configuration import DEFAULT_FILE, read_configuration
from calibration.pipeline.results import read_results
from calibration.pipeline.stages.running import COLLECTED_FOLDER, PipelineRun

TITLE = "bundle"


@record(kw_only=True)
class BundleSettings:
    """Inputs of ``bundle`` beside those of the section ``delivery``."""

    config: Path = field("The configuration (calibration.yml).", default=DEFAULT_FILE)
    output: Path = field(
        "Folder of the run's results; the bundle is written to its folder bundle.", default=Path("output")
    )
    although: str | None = field(
        "Reason to bundle red, undecided and not accepted systems too; they are marked, and verify refuses them.",
        default=None,
    )


signing_key_option = click.option(
    "--signing-key",
    envvar=KEY_VARIABLE,
    help=f"The private key itself, in PEM; on a command line by the variable {KEY_VARIABLE} instead.",
)
"""Option for the private key, to be passed to `masked_signing_key`."""


@click.command(TITLE)
@record_options(BundleSettings)
@record_options(DeliverySettings)
@signing_key_option
@click.pass_context
def command(context: click.Context, /, signing_key: str | None, **options: Any) -> ExitCode:
    """Pack what systems that passed and are accepted leave for their robot: the same input, the same digest.

    A system that is red, undecided or not accepted is left out, or refused if --systems names it; --although bundles
    and marks it.
    """
    runner = Runner.from_environment()
    key = masked_signing_key(context, signing_key, runner)
    settings = chosen(BundleSettings, options)
    if settings.although is not None and not settings.although.strip():
        raise InputError("--although: found nothing, expected the reason")
    found = bundle_results(settings, given(DeliverySettings, options), key)
    _show(found, settings.output, runner)
    return ExitCode.PASS


def bundle_results(settings: BundleSettings, document: dict[str, Any], signing_key: str) -> BundleResults:
    """Write the bundle of a run, and return what it is.

    Args:
        settings: of the command.
        document: keys of the section ``delivery`` that take precedence over it.
        signing_key: the private key in PEM; empty for none.

    Raises:
        InputError: an input is wrong, or no system can be bundled.
        InfrastructureError: a file cannot be written.
    """
    with locked(settings.output):  # no run may write the results meanwhile
        run, delivery = run_to_bundle(settings.config, settings.output, document)
        bundle = make_bundle(run, delivery, settings.although)
        environment = {**os.environ, KEY_VARIABLE: signing_key}
        return write_bundle(bundle, settings.output, delivery.signing_key_file, environment)


def run_to_bundle(config: Path, output: Path, document: dict[str, Any]) -> tuple[RunToBundle, DeliverySettings]:
    """Read the results of a run, and the section ``delivery``, over which keys of a document take precedence.

    Raises:
        InputError: an input is wrong.
    """
    configuration = read_configuration(config)
    section = configuration.sections.of("delivery") or DeliverySettings()
    systems = with_collected(configuration.systems, output / COLLECTED_FOLDER)
    run = RunToBundle(read_results(output), systems, output, config, configuration.baseline)
    return run, changed(section, document, "options")


def masked_signing_key(context: click.Context, signing_key: str | None, runner: Runner) -> str:
    """Mask the private key that an option or its variable has, and return it; raises as `masked_secret`."""
    place = f"the environment variable {KEY_VARIABLE}, or use signing-key-file"
    return masked_secret(context, "signing-key", signing_key, runner, place) or ""


def _show(found: BundleResults, output: Path, runner: Runner) -> None:
    annotate(runner, [Annotation(warning, Level.WARNING, title="Bundle") for warning in found.warnings])
    set_outputs(
        runner,
        {
            "bundle": output / found.file,
            "digest": found.digest,
            "version": found.version,
            "attestation": output / found.attestation if found.attestation else "",
            "predicate": output / found.predicate,
        },
    )
    with stop_commands(runner):
        runner.log(one_line(f"{found.sentence}: {found.digest} ({output / found.file})"))


def deliver_stage(run: PipelineRun) -> PipelineRun:
    """Bundle what passed and is accepted; that nothing is to be bundled is no reason of the verdict.

    Raises:
        InputError: the key is wrong.
        InfrastructureError: a file cannot be written.
    """
    settings: DeliverySettings = run.sections.of("delivery")
    folder = run.output / BUNDLE_FOLDER
    if folder.is_dir():  # of an earlier run
        remove_results(folder, [path.name for path in folder.iterdir() if path.is_file()])
    to_bundle = RunToBundle(
        run.results, run.matrix.systems, run.output, run.config or run.output, run.baseline or BaselineSettings()
    )
    try:
        bundle = make_bundle(to_bundle, settings, None)
    except InputError as error:
        return run.with_result("delivery", Delivered(why_not=str(error), folder=BUNDLE_FOLDER))
    if key := os.environ.get(KEY_VARIABLE):
        add_mask(run.runner, key)
    written = write_bundle(bundle, run.output, settings.signing_key_file)
    return run.with_result("delivery", Delivered(bundle=written, folder=BUNDLE_FOLDER))
