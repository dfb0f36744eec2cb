"""Report of a simulated collection, and its page."""

from base64 import b64encode
from collections.abc import Iterable
from pathlib import Path

import cv2
import numpy as np

from calibration import __version__
from calibration.base.records import value_of
from calibration.ci.pages.html import Html, bullets, element, figure, join, page, table, verdict_line
from calibration.ci.report import Lines, Outcome, Report, Table, Text, outcome_of_check
from calibration.pipeline.collection.results import CollectionDocument, CollectionResults, LostPose, SensorNumbers
from calibration.robot.simulation.proof import Proof
from calibration.robot.simulation.record import Record

SCHEMA_FILE = Path(__file__).with_name("collection.schema.json")
COMMAND_NAME = "collect-data-sim"
POSES_FILE = "poses.csv"
CONTACT_SHEET = "contact_sheet.png"
LOST_SHOWN = 50


def report(results: CollectionResults, output: Path) -> Report:
    """Return the report. It contains no times: the same input gives the same bytes.

    Args:
        results: the results.
        output: the folder of the dataset.
    """
    proof, kept = results.proof, len(results.kept)
    lost = tuple(LostPose(record.number + 1, tuple(record.lost)) for record in results.lost)
    lines = tuple(map(lost_line, results.lost))
    sheet = results.contact_sheet
    return Report(
        title="Collection in simulation",
        verdict=results.verdict,
        error=results.exit_code,
        sentence=f"{results.system}: {kept} of {len(results.records)} collections kept, {_calibration_text(results)}",
        reasons=tuple(results.reasons),
        warnings=lines,
        blocks=(
            sensors_table(results),
            Lines(lines, LOST_SHOWN, POSES_FILE, title="Lost", only="summary"),
            Text(f"Motion: {results.motion}, seed {results.seed}.", only="summary"),
        ),
        suites={f"{COMMAND_NAME} {results.system}": list(_junit_outcomes(results))},
        results=CollectionDocument(
            system=results.system,
            seed=results.seed,
            motion=results.motion,
            poses=len(results.records),
            kept=kept,
            lost=lost,
            sensors=results.sensors,
            corner_rms_px=results.corner_rms,
            calibration=proof,
            checks=tuple(results.checks),
            reasons=tuple(results.reasons),
            dataset="dataset.json" if kept else None,
            contact_sheet=CONTACT_SHEET if sheet else None,
            made_with={"calibration": __version__, "numpy": np.__version__, "opencv": cv2.__version__},
        ),
        outputs={
            "dataset": output if kept else None,
            "collections": kept,
            "lost": value_of(lost),
            "detection-rate": {name: each.detection_rate for name, each in results.sensors.items()},
            "corner-error-px": results.corner_rms,
            "translation-mm": proof.translation_mm if proof else None,
            "rotation-deg": proof.rotation_deg if proof else None,
            **dict.fromkeys(("success-rate", "worst-scenarios")),  # only of several scenarios
            "contact-sheet": output / CONTACT_SHEET if sheet else None,
            "report": None,  # if there is a page
        },
        files={POSES_FILE: poses_table(results).csv()},
    )


def pose_line(record: Record) -> str:
    """Return a line on one pose, for the progress."""
    if not record.kept:
        return lost_line(record)
    return f"pose {record.number + 1}: " + ", ".join(f"{name} {count}" for name, count in record.labels.items())


def lost_line(record: Record) -> str:
    """Return the reasons why a pose is not part of the dataset."""
    return f"pose {record.number + 1} lost: {'; '.join(record.lost)}"


def sensors_table(results: CollectionResults) -> Table:
    """Return a row for each sensor: detections, corner errors, coverage, and standard deviation of its transform."""
    sigmas = (results.proof.sigmas if results.proof else None) or {}
    header = ("Sensor", "Detected", "Of them partial", "Corner error (px)", "Image covered", "Sigma of its transform")

    def row(name: str, numbers: SensorNumbers) -> tuple[str, ...]:
        error, sigma = numbers.corner_error, sigmas.get(name)
        return (
            name,
            f"{numbers.detected}/{len(results.records)}",
            str(numbers.partial) if numbers.coverage is not None else "-",
            f"RMS {error.rms_px:.3f}, max {error.max_px:.2f}" if error else "-",
            f"{100 * numbers.coverage:.0f} %" if numbers.coverage is not None else "-",
            f"{sigma.translation_mm:.3f} mm, {sigma.rotation_deg:.4f} deg" if sigma else "-",
        )

    return Table(header, tuple(row(name, numbers) for name, numbers in results.sensors.items()))


def poses_table(results: CollectionResults) -> Table:
    """Return a row for each pose, for ``poses.csv``: whether it was kept, and what each sensor labelled."""
    cameras = [name for name, numbers in results.sensors.items() if numbers.coverage is not None]
    labels = [f"{name} labels" for name in results.modalities]
    errors = [f"{name} RMS error (pix)" for name in cameras]
    rows = (
        (
            *(record.key, str(record.number + 1), "yes" if record.kept else "no"),
            *(str(record.labels[name]) for name in results.modalities),
            *(f"{record.errors[name].rms:.4f}" if name in record.errors else "" for name in cameras),
            "; ".join(record.lost),
        )
        for record in results.records
    )
    return Table(("Collection #", "Pose", "Kept", *labels, *errors, "Reasons"), tuple(rows))


def _calibration_text(results: CollectionResults) -> str:
    """Describe the calibration of the dataset in a few words."""
    proof = results.proof
    if proof is None or not proof.converged:
        return "does not calibrate"
    error = (
        ""
        if proof.translation_mm is None
        else f", {proof.translation_mm:.3g} mm and {proof.rotation_deg:.2g} deg{_joints_text(proof)} from the truth"
    )
    return f"calibrates with {proof.rms_px:.4f} px{error}" if proof.rms_px is not None else f"calibrates{error}"


def _joints_text(proof: Proof) -> str:
    """Return the largest errors of joints, if some were calibrated."""
    shown = [
        f"{error:{form}} {unit}"
        for error, form, unit in ((proof.joint_mm, ".3g", "mm"), (proof.joint_deg, ".2g", "deg"))
        if error is not None
    ]
    return f", joints {' and '.join(shown)}" if shown else ""


def _junit_outcomes(results: CollectionResults) -> Iterable[Outcome]:
    """Return the cases of JUnit: whether the dataset calibrates, and each check."""
    calibrates = results.proof is not None and results.proof.converged
    reasons = () if calibrates else tuple(results.reasons)
    yield Outcome(name="the dataset calibrates", group=results.system, reasons=reasons)
    for check in results.checks:
        yield outcome_of_check(check, results.system)


_SHEET_CAPTION = "Every pose that was collected: what each sensor saw, with its labels; red where a pose was lost."


def collection_page(report: Report, contact_sheet: Path | None) -> str:
    """Return the page, a single file.

    Args:
        report: of the collection.
        contact_sheet: the PNG, if there is one.
    """
    tables = [table(block.columns, block.rows) for block in report.blocks if isinstance(block, Table)]
    head = join(
        [
            element("h1", "Collected in simulation"),
            verdict_line(report.verdict, report.sentence),
            bullets((*report.reasons, *report.warnings)),
            *tables,
        ]
    )
    if contact_sheet is None:
        return page(f"Collected: {report.verdict}", [head])
    address = f"data:image/png;base64,{b64encode(contact_sheet.read_bytes()).decode('ascii')}"
    sheet = figure(Html(element("img", src=address, alt="Contact sheet of all poses")), _SHEET_CAPTION)
    return page(f"Collected: {report.verdict}", [head, sheet])
