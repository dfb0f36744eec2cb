"""``convergence``: map how large errors of the starting guess may be, by a sweep over the start noise."""

import math
import shlex
from dataclasses import replace
from pathlib import Path
from typing import Any

import click

from calibration.base import ExitCode, InputError, did_you_mean
from calibration.ci.report import count_of, publish, remove_results
from calibration.ci.workflow import Runner
from calibration.ci.workflow.streams import LogDisplay, progress
from calibration.commands import parameters
from calibration.commands.calibrate_matrix import (
    OF_SOFTWARE,
    MatrixSettings,
    configuration_of,
    matrix_of,
    pull,
    target_of,
)
from calibration.commands.calibrate_matrix import command as calibrate_matrix
from calibration.engine.estimation.options import Start
from calibration.pipeline.configuration import DEFAULT_FILE
from calibration.pipeline.convergence.convergence_map import ConvergenceResults, Minimums, maps_of
from calibration.pipeline.convergence.report import ALL_FILES, COMMAND_NAME, report
from calibration.pipeline.convergence.sweep import run_sweep, sweep_matrices
from calibration.pipeline.matrix.cell_result import CellResult
from calibration.pipeline.system import System

KINDS_OF_START = ("given", "linear")
DEFAULT_SEEDS = 10
MAX_LEVELS = 50
"""Limit of levels of an axis, to keep tables and figures readable."""
MAX_STARTS = 1_000_000
"""Limit of starts of one map."""
SHARED_OPTIONS = frozenset(
    {
        *(
            key.replace("-", "_")
            for key in (*parameters.option_keys(System), *OF_SOFTWARE)
            if key not in ("start", "compare", "datasets", "undecided")
        ),
        *("dataset", "config", "systems", "rules", "parallel"),
        *("registry_username", "registry_password", "backend", "aws_batch", "run_name", "resume"),
    }
)
"""Options of ``calibrate-matrix`` with the same meaning here."""


def levels(value: str) -> tuple[float, ...]:
    """Parse noise levels: numbers, and ranges FIRST:LAST:COUNT, separated by commas; returned sorted, including 0."""
    found = {0.0, *(level for part in parameters.TEXT_LIST(value) for level in _levels_of_part(part))}
    if len(found) > MAX_LEVELS:
        raise click.BadParameter(f"{len(found)} levels with 0, at most {MAX_LEVELS} were expected")
    return tuple(sorted(found))


levels.__name__ = "levels"


def _levels_of_part(part: str) -> tuple[float, ...]:
    if ":" not in part:
        return (parameters.non_negative(part),)
    try:
        first, last, steps = part.split(":")
    except ValueError:
        raise click.BadParameter(f"{part!r} is no range: FIRST:LAST:COUNT was expected, such as 0:2:9") from None
    low, high, number = parameters.non_negative(first), parameters.non_negative(last), parameters.integer(steps)
    if not 2 <= number <= MAX_LEVELS or low >= high:
        raise click.BadParameter(
            f"{part!r} is no range: FIRST below LAST, and a COUNT of 2 to {MAX_LEVELS} were expected, such as 0:2:9"
        )
    decimals = 3 - math.floor(math.log10(high - low))  # as many as one reads: 0.3333 m, not 0.333333333333 m
    inner = (round(low + (high - low) * step / (number - 1), decimals) for step in range(1, number - 1))
    return (low, *inner, high)


def starts(value: str) -> tuple[str, ...]:
    """Parse kinds of start, without duplicates."""
    found = tuple(dict.fromkeys(parameters.TEXT_LIST(value)))
    for start in found:
        if start not in KINDS_OF_START:
            raise click.BadParameter(f"{start!r} is neither given nor linear{did_you_mean(start, KINDS_OF_START)}")
    return found


@click.command(COMMAND_NAME, params=[option for option in calibrate_matrix.params if option.name in SHARED_OPTIONS])
@click.option(
    "--translation-noise",
    type=levels,
    default="0:2:9",
    help="Levels of the errors of the starting translations, m: numbers or FIRST:LAST:COUNT; 0 is always one (0:2:9).",
)
@click.option(
    "--rotation-noise",
    type=levels,
    default="0:3:7",
    help="Levels of the errors of the starting Euler angles, rad: numbers or FIRST:LAST:COUNT, and always 0 (0:3:7).",
)
@click.option("--seeds", type=parameters.count, help="How many seeds for each pair of noises (10).")
@click.option("--seed-list", type=parameters.INTEGER_LIST, help="The seeds themselves, instead of their number: 3,7.")
@click.option(
    "--start", type=starts, default=",".join(KINDS_OF_START), help="given (the noisy guess), linear, or both (both)."
)
@click.option(
    "--minimum-translation-noise",
    type=parameters.non_negative,
    help="Every start must converge up to this, m, without rotation.",
)
@click.option(
    "--minimum-rotation-noise",
    type=parameters.non_negative,
    help="Every start must converge up to this, rad, without translation.",
)
@click.option(
    "--output", type=parameters.path, default=Path("output"), help="Folder for results, tables and figures (output)."
)
@click.pass_context
def command(
    click_context: click.Context,
    /,
    start: tuple[Start, ...],
    minimum_translation_noise: float | None,
    minimum_rotation_noise: float | None,
    **options: Any,
) -> ExitCode:
    """Sweep the noise of the start, and map the share of starts that converge.

    The verdict is fail if the start without noise does not converge, or a minimum is not reached.
    """
    runner = Runner.from_environment()
    options["password_variable"] = parameters.password_variable(click_context, options.pop("registry_password"), runner)
    minimums = Minimums(minimum_translation_noise, minimum_rotation_noise)
    asked = _with_seeds(MatrixSettings.of_options(options), start, minimums)
    configuration = configuration_of(asked)
    matrix = matrix_of(asked, configuration)
    matrices = sweep_matrices(matrix, start)
    target = target_of(asked, configuration, matrix, runner)
    pull(asked, runner)
    remove_results(asked.output, ALL_FILES)
    software = bool(matrix.software)
    total = sum(len(each.cells) for each in matrices)
    runner.log(f"{count_of(total, 'start')}; a stopped sweep is continued by the same command")
    with progress(runner, COMMAND_NAME, bar=not software, kept="starts") as advance:

        def done(number: int, total: int, cell: CellResult) -> None:
            failed = "" if cell.verdict != "fail" else f": {'; '.join(cell.reasons) or 'does not converge'}"
            advance(
                number,
                total,
                f"{cell.name}, {cell.method}, {cell.start}{failed}",
                important=cell.error == ExitCode.INFRASTRUCTURE,
            )

        cells = run_sweep(matrices, asked.output, asked.parallel, done, replace(target, show=LogDisplay(runner)))
    source = (
        f"--dataset {shlex.quote(str(asked.dataset))}" if asked.dataset else f"--config {asked.config or DEFAULT_FILE}"
    )
    found = report(ConvergenceResults(matrix.noise, maps_of(cells, matrix.noise), minimums), asked.output, source)
    return publish(found, runner, asked.output)


def _with_seeds(asked: MatrixSettings, start: tuple[Start, ...], minimums: Minimums) -> MatrixSettings:
    """Return the inputs of the matrix with its noise; the noise of a configuration is not used for sweeps.

    Raises:
        InputError: the sweep is too large, or ends below a minimum.
    """
    for axis in ("translation", "rotation"):
        last = max(getattr(asked.noise, axis))
        minimum = getattr(minimums, axis)
        if minimum is not None and minimum > last:
            raise InputError(f"minimum-{axis}-noise: found {minimum:g}, but the sweep ends at {last:g}")
    if not start:
        raise InputError(f"start is empty: expected {' or '.join(KINDS_OF_START)}, or both")
    if asked.noise.seeds is None and asked.noise.seed_list is None:
        asked = replace(asked, noise=replace(asked.noise, seeds=DEFAULT_SEEDS))
    grid = asked.noise.grid()
    total = len(grid.translations) * len(grid.rotations) * len(grid.seeds)
    if total > MAX_STARTS:
        raise InputError(f"found {total} starts for each system, at most {MAX_STARTS} were expected: take fewer seeds")
    return asked
