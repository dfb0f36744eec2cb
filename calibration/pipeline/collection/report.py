"""What a user sees of a collection in simulation: lines in the log, the summary, annotations, outputs."""

from pathlib import Path
from typing import TYPE_CHECKING

from calibration.pipeline.collection.results import CONTACT_SHEET, FILE, SUMMARY_FILE, CollectionResults
from calibration.pipeline.collection.summary import lost_line, markdown, sensors_grid, sentence
from calibration.workflow import Annotation, Level, Runner, add_summary, annotate, set_outputs, stop_commands
from calibration.workflow.outputs import OutputValue

if TYPE_CHECKING:
    from calibration.simulation.collection.record import Record


def pose_line(record: "Record") -> str:
    """What came of one pose, for the progress."""
    if not record.kept:
        return lost_line(record)
    return f"pose {record.number + 1}: " + ", ".join(f"{name} {count}" for name, count in record.labels.items())


def report_collection(results: CollectionResults, output: Path, runner: Runner, title: str) -> None:
    """Show the results that stand in the output folder.

    Raises:
        WorldError: a file of the runner cannot be written.
    """
    table = sensors_grid(results)
    with stop_commands(runner):  # names are the user's
        runner.log("")
        runner.log(table.plain())
        runner.log("")
    lost = [Annotation(lost_line(record), Level.WARNING, title=title) for record in results.lost]
    annotate(runner, [*(Annotation(reason, title=title) for reason in results.reasons), *lost])
    add_summary(runner, markdown(results))
    set_outputs(runner, outputs(results, output))
    runner.log(f"{sentence(results)} ({output / FILE})")


def outputs(results: CollectionResults, output: Path) -> dict[str, OutputValue]:
    """The outputs of the action; empty text where there is no number, and for what only several worlds have."""
    proof = results.proof

    def known(value: float | None) -> float | str:
        return "" if value is None else value

    return {
        "verdict": results.verdict,
        "dataset": output if results.kept else "",
        "collections": len(results.kept),
        "lost": [{"pose": record.number + 1, "reasons": list(record.lost)} for record in results.lost],
        "detection-rate": {name: numbers.detection_rate for name, numbers in results.sensors.items()},
        "corner-error-px": known(results.corner_rms),
        "translation-mm": known(proof.translation_mm if proof else None),
        "rotation-deg": known(proof.rotation_deg if proof else None),
        "success-rate": "",
        "worst-worlds": "",
        "contact-sheet": output / CONTACT_SHEET if results.contact_sheet else "",
        "results": output / FILE,
        "summary": output / SUMMARY_FILE,
    }
