"""``check-messages``: judge requirements over the messages of a bag; and the stage judge, which does it in a run."""

import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from calibration.addons.requirements.judging import judge_bag
from calibration.addons.requirements.results import TITLE, JudgedMessages, MessageResults, annotations_of, report
from calibration.addons.requirements.settings import RECORDED_PREFIX, RequirementSettings
from calibration.base import ExitCode, InputError, read_yaml
from calibration.base.records import field, read, record
from calibration.ci.execution.ros import MESSAGES_FOLDER
from calibration.ci.report import FILES, Report, publish, remove_results
from calibration.ci.workflow import Runner, annotate
from calibration.commands.parameters import chosen, record_options

if TYPE_CHECKING:  # the engine, which the command does without
    from calibration.pipeline.running import PipelineRun

SECTION = "requirements"


@record
class CheckMessagesSettings:
    """Inputs of ``check-messages``."""

    config: Path = field(
        "File with the section requirements (calibration.yml); of the others nothing is read.",
        default=Path("calibration.yml"),
    )
    bag: tuple[str, ...] = field(
        "The bag, in place of that in the file: a file .bag, .db3 or .mcap, or the folder of a ROS 2 bag; several "
        "files of one recording.",
        default=(),
    )
    output: Path | None = field("Folder for results.json, junit.xml and summary.md.", default=None)


def check_messages(settings: CheckMessagesSettings, runner: Runner) -> ExitCode:
    """Judge requirements over a bag, and report.

    Raises:
        InputError: the file, a requirement or the bag is wrong.
        InfrastructureError: a library is not installed, or a result cannot be written.
    """
    document = read_yaml(settings.config, "requirements over messages")
    if not isinstance(document, dict) or SECTION not in document:
        raise InputError(f"{settings.config}: found no section '{SECTION}', expected one")
    where = f"{settings.config}: {SECTION}"
    requirements = read(RequirementSettings, document[SECTION], where, folder=settings.config.parent)
    remove_results(settings.output, FILES)
    found = judged(requirements, [Path(each) for each in settings.bag] or requirements.bags, settings.config)
    return publish(found, runner, settings.output)


def judged(requirements: RequirementSettings, bag: Sequence[Path], config: Path) -> Report:
    """Judge requirements over a bag, and return the report, whose results are `MessageResults`.

    Raises:
        InputError: a requirement or the bag is wrong, or there is no bag.
        InfrastructureError: a library is not installed.
    """
    if bag and str(bag[0]).startswith(RECORDED_PREFIX):
        raise InputError(f"{config}: {SECTION}.bag: {bag[0]} is recorded by calibration run; name its bag by --bag")
    if not bag:
        raise InputError(f"{config}: {SECTION}: found no bag, expected the key 'bag', or the option --bag")
    pairs, seconds = judge_bag(requirements, bag, f"{config}: {SECTION}")
    results = MessageResults(
        bag=tuple(map(str, bag)), seconds=seconds, requirements=tuple(judgement for _, judgement in pairs)
    )
    return report(results, [requirement for requirement, _ in pairs], config)


@click.command(TITLE)
@record_options(CheckMessagesSettings)
def command(**options: Any) -> ExitCode:
    """Judge what must hold of a robot's messages over a bag; the verdict is fail if a requirement is not met.

    ROS is not needed. Requirements are written in calibration.yml: rates, gaps, latency, values, frames, nodes, and
    properties in HPL.
    """
    return check_messages(chosen(CheckMessagesSettings, options), Runner.from_environment(os.environ))


STAGE_FOLDER = "requirements"


def judge_stage(run: "PipelineRun") -> "PipelineRun":
    """Judge the requirements; one that is not met is a reason of the verdict.

    Raises:
        InputError: a requirement or the bag is wrong.
        InfrastructureError: a library is not installed, or a file cannot be written.
    """
    settings: RequirementSettings = run.sections.of("requirements")
    folder = run.output / STAGE_FOLDER
    remove_results(folder, FILES)
    bags = settings.bags if settings.recorded_by is None else _recorded_bag(run, settings.recorded_by)
    report = judged(settings, bags, run.config or Path("calibration.yml"))
    report.write(folder)
    annotate(run.runner, annotations_of(report))
    results: MessageResults = report.results
    result = JudgedMessages(
        requirements=len(results.requirements),
        not_met=results.not_met,
        vacuous=results.warnings,
        folder=STAGE_FOLDER,
        reasons=tuple(f"requirements: {reason}" for reason in results.reasons),
    )
    return run.with_result("requirements", result)


def _recorded_bag(run: "PipelineRun", name: str) -> list[Path]:
    """Return the files of the bag that an entry of ``simulation`` has recorded, in this run or an earlier one.

    Raises:
        InputError: there is none.
    """
    from calibration.pipeline.running import COLLECTED_FOLDER  # the command does without the engine

    folder = run.output / COLLECTED_FOLDER / name / MESSAGES_FOLDER
    found = sorted([*folder.glob("*.bag"), *(file.parent for file in folder.glob("*/metadata.yaml"))])
    if not found and (open_bags := [file.name for file in folder.glob("*.active")]):
        raise InputError(f"{folder}: found {open_bags[0]}: the recorder was killed before it had closed the bag")
    if not found:
        raise InputError(
            f"{run.config}: requirements.bag: found no bag in {folder}, expected one that simulation.{name} records: "
            "add 'record: {}' to it, and run the stage collect"
        )
    return found
