"""``check-messages``: judge requirements over the messages of a bag."""

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click

from calibration.addons.requirements.judging import judge_bag
from calibration.addons.requirements.results import TITLE, MessageResults, report
from calibration.addons.requirements.settings import RECORDED_PREFIX, RequirementSettings
from calibration.base.documents import read_yaml
from calibration.base.errors import ExitCode, InputError
from calibration.base.records import field, read, record
from calibration.ci.report import FILES, Report, publish, remove_results
from calibration.ci.workflow import Runner
from calibration.commands.parameters import chosen, record_options

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
