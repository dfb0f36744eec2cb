"""What a user sees of a matrix: the table in the log, the summary, annotations, outputs."""

from pathlib import Path

from calibration.files import write_atomically
from calibration.pipeline.results import FILE, Results, summarise
from calibration.pipeline.summary import (
    collections_grid,
    failures,
    grid,
    image_line,
    in_parts,
    markdown,
    sentence,
    truth_grid,
    without_result,
)
from calibration.workflow import Annotation, Level, Runner, add_summary, annotate, set_outputs, stop_commands
from calibration.workflow.text import aligned


def report(results: Results, output: Path, runner: Runner, title: str) -> None:
    """Show the results, and leave ``summary.md`` beside them.

    Raises:
        WorldError: a file cannot be written.
    """
    tables = in_parts(grid(results)) if results.cells or results.comparisons else []
    tables += [truth_grid(results)] if truth_grid(results).rows else []
    tables += [collections_grid(results)] if results.collections else []
    text = markdown(results)
    write_atomically(output / "summary.md", text)
    with stop_commands(runner):  # names of systems, columns and rows are the user's
        for table in tables:
            runner.log("")
            runner.log(aligned(table.header, table.rows))
        runner.log("")
    failed = [Annotation(line, title=title) for line in failures(results)]
    notes = [Annotation(line, Level.WARNING) for line in without_result(results)]
    annotate(runner, [*failed, *notes])
    add_summary(runner, text)
    numbers = summarise(results)
    set_outputs(
        runner,
        {
            "verdict": results.verdict,
            "results": output / FILE,
            "summary": output / "summary.md",
            "output": output,
            "success-rate": numbers["success_rate"],
            "worst-rms-px": "" if numbers["worst_rms_px"] is None else numbers["worst_rms_px"],
            "worst-translation-mm": "" if numbers["worst_translation_mm"] is None else numbers["worst_translation_mm"],
        },
    )
    if results.image is not None:
        runner.log(image_line(results.image))
    runner.log(f"{sentence(results)} ({output / FILE})")
