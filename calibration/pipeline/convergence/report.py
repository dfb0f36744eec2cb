"""What a sweep leaves in files, and what a user sees of it."""

from dataclasses import replace
from pathlib import Path

from calibration.errors import InputError, WorldError
from calibration.files import write_atomically
from calibration.pipeline.convergence.results import (
    FILE,
    FILES,
    JUNIT_FILE,
    LARGEST_FILE,
    PNG_FILE,
    SUMMARY_FILE,
    SVG_FILE,
    TABLE_FILE,
    ConvergenceResults,
    json_text,
    junit,
    largest_table,
    table,
)
from calibration.pipeline.convergence.summary import first_lost, largest_grid, map_grid, markdown, sentence
from calibration.workflow import Annotation, Level, Runner, add_summary, annotate, set_outputs, stop_commands
from calibration.workflow.text import aligned, one_line


def clear_convergence(output: Path) -> None:
    """Remove the files of an earlier sweep, so that none of them passes for this one's.

    Raises:
        WorldError: a file cannot be removed.
    """
    for name in FILES:
        try:
            (output / name).unlink(missing_ok=True)
        except OSError as error:
            raise WorldError(f"{output / name}: an earlier result cannot be removed: {error.strerror}") from error


def write_convergence(results: ConvergenceResults, output: Path) -> ConvergenceResults:
    """Write the files; the results with a note where there can be no figures.

    Raises:
        WorldError: a file cannot be written.
    """
    from calibration.pipeline.convergence.figure import figures

    try:
        png, svg = figures(results)
        write_atomically(output / PNG_FILE, png)
        write_atomically(output / SVG_FILE, svg)
    except InputError as error:  # what draws them is not installed, or there is too much to draw
        results = replace(results, notes=(str(error),))
    write_atomically(output / FILE, json_text(results))
    write_atomically(output / TABLE_FILE, table(results))
    write_atomically(output / LARGEST_FILE, largest_table(results))
    write_atomically(output / JUNIT_FILE, junit(results))
    write_atomically(output / SUMMARY_FILE, markdown(results))
    return results


def report_convergence(results: ConvergenceResults, output: Path, runner: Runner, title: str) -> None:
    """Show the results that stand in the output folder.

    Raises:
        WorldError: a file of the runner cannot be written.
    """
    largest = largest_grid(results)
    with stop_commands(runner):  # names of systems, and what their software says, are the user's
        for each in results.maps:
            grid = map_grid(each)
            runner.log(f"\n{each.name}: starts that converge, % of {len(results.noise.seeds)}")
            runner.log(aligned(grid.header, grid.rows))
            if lost := first_lost(each):
                runner.log(one_line(lost))
        runner.log("")
        runner.log(aligned(largest.header, largest.rows))
        runner.log("")
    notes = [Annotation(note, Level.NOTICE, title=title) for note in results.notes]
    annotate(runner, [*(Annotation(reason, title=title) for reason in results.reasons), *notes])
    add_summary(runner, markdown(results))

    def known(value: float | None) -> float | str:
        return "" if value is None else value

    translation, rotation = results.largest_diagonal or (None, None)
    set_outputs(
        runner,
        {
            "verdict": results.verdict,
            "largest-translation-noise": known(results.largest_translation),
            "largest-rotation-noise": known(results.largest_rotation),
            "largest-diagonal-translation-noise": known(translation),
            "largest-diagonal-rotation-noise": known(rotation),
            "table": output / TABLE_FILE,
            "figure": "" if results.notes else output / PNG_FILE,
            "results": output / FILE,
            "summary": output / SUMMARY_FILE,
            "output": output,
        },
    )
    runner.log(f"{sentence(results)} ({output / FILE})")
