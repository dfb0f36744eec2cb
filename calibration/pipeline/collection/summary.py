"""A collection as a user reads it: a sentence, a table of sensors, the poses that were lost."""

from typing import TYPE_CHECKING

from calibration.report import Table
from calibration.workflow.summary import escape_markdown

if TYPE_CHECKING:
    from calibration.pipeline.collection.results import CollectionResults, SensorNumbers
    from calibration.simulation.collection.proof import Proof
    from calibration.simulation.collection.record import Record

LOST_SHOWN = 50


def sentence(results: "CollectionResults") -> str:
    """The verdict in one line."""
    kept = f"{len(results.kept)} of {len(results.records)} collections kept"
    return f"{results.verdict}: {results.system}: {kept}, {calibration_text(results)}"


def calibration_text(results: "CollectionResults") -> str:
    """What the calibration of the dataset found, in a few words."""
    proof = results.proof
    if proof is None or not proof.converged:
        return "does not calibrate"
    error = (
        ""
        if proof.translation_mm is None
        else f", {proof.translation_mm:.3g} mm and {proof.rotation_deg:.2g} deg{_joints(proof)} from the truth"
    )
    return f"calibrates with {proof.rms_px:.4f} px{error}" if proof.rms_px is not None else f"calibrates{error}"


def _joints(proof: "Proof") -> str:
    """The worst errors of joints, where some were calibrated."""
    shown = [
        f"{error:{form}} {unit}"
        for error, form, unit in ((proof.joint_mm, ".3g", "mm"), (proof.joint_deg, ".2g", "deg"))
        if error is not None
    ]
    return f", joints {' and '.join(shown)}" if shown else ""


def sensors_grid(results: "CollectionResults") -> Table:
    """For each sensor: detections, corner errors, coverage, and how sure its transform is."""
    sigmas = (results.proof.sigmas if results.proof else None) or {}
    header = ("Sensor", "Detected", "Of them partial", "Corner error (px)", "Image covered", "Sigma of its transform")

    def row(name: str, numbers: "SensorNumbers") -> tuple[str, ...]:
        error, sigma = numbers.corner_error, sigmas.get(name)
        return (
            name,
            f"{numbers.detected}/{len(results.records)}",
            str(numbers.partial) if numbers.coverage is not None else "-",
            f"RMS {error['rms_px']:.3f}, max {error['max_px']:.2f}" if error else "-",
            f"{100 * numbers.coverage:.0f} %" if numbers.coverage is not None else "-",
            f"{sigma.translation_mm:.3f} mm, {sigma.rotation_deg:.4f} deg" if sigma else "-",
        )

    return Table(header, tuple(row(name, numbers) for name, numbers in results.sensors.items()))


def lost_line(record: "Record") -> str:
    """Why a pose is not part of the dataset."""
    return f"pose {record.number + 1} lost: {'; '.join(record.lost)}"


def markdown(results: "CollectionResults") -> str:
    """The verdict, the table of sensors, what was lost and what failed."""
    table = sensors_grid(results)
    lines = [f"## Collection in simulation: {escape_markdown(sentence(results))}", ""]
    if results.reasons:
        lines += [*(f"- {escape_markdown(reason)}" for reason in results.reasons), ""]
    lines += [table.markdown()]
    if lost := results.lost:
        lines += ["### Lost", "", *(f"- {escape_markdown(lost_line(record))}" for record in lost[:LOST_SHOWN])]
        if len(lost) > LOST_SHOWN:
            lines.append(f"- and {len(lost) - LOST_SHOWN} more, see poses.csv")
        lines.append("")
    lines.append(f"Motion: {escape_markdown(results.motion)}, seed {results.seed}.")
    return "\n".join(lines) + "\n"
