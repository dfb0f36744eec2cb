"""The stage collect: datasets in simulation, by our own or by the team's applications."""

import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from calibration.errors import CalibrationError
from calibration.execution.backends import EMBEDDED, Place
from calibration.pipeline.collection.collected import COLLECTED, Collected
from calibration.pipeline.collection.collecting import collect_dataset
from calibration.pipeline.collection.report import pose_line
from calibration.pipeline.configuration import Simulation
from calibration.pipeline.report import write_results
from calibration.pipeline.results import Results
from calibration.simulation.collection.record import Record
from calibration.workflow import Runner
from calibration.workflow.progress import progress


def collect_stage(
    simulations: Sequence[Simulation],
    results: Results,
    output: Path,
    runner: Runner,
    jobs: int | None = None,
    place: Place | None = None,
) -> Results:
    """Collect datasets, each in its folder below ``output``, and calibrate them.

    One that cannot be collected is among the results, and does not stop the others.

    Args:
        simulations: what to collect.
        results: of the stages before, to which these are added.
        output: the folder between the stages.
        runner: where to show the progress.
        jobs: processes; None for one a core.
        place: what is known of the places where containers run; each says itself which it is.

    Raises:
        WorldError: a result cannot be written.
    """
    collections = tuple(_collected(simulation, output, runner, jobs, place or Place()) for simulation in simulations)
    results = replace(results, collections=collections)
    write_results(results, output)
    return results


def _collected(simulation: Simulation, output: Path, runner: Runner, jobs: int | None, place: Place) -> Collected:
    name, folder, begin = simulation.name, f"{COLLECTED}/{simulation.name}", time.perf_counter()
    place = replace(place, backend=simulation.backend)
    try:
        with progress(runner, f"collect {name}", bar=simulation.backend == EMBEDDED) as advance:

            def done(count: int, total: int, record: Record) -> None:
                advance(count, total, f"{name}: {pose_line(record)}", important=not record.kept)

            found = collect_dataset(simulation.request, output / folder, True, jobs, place, done=done)
    except CalibrationError as error:
        return Collected(name, reasons=(str(error),), error=error.exit_code)
    proof = found.proof
    return Collected(
        name=name,
        poses=len(found.records),
        kept=len(found.kept),
        corner_rms_px=found.corner_rms,
        rms_px=proof.rms_px if proof else None,
        translation_mm=proof.translation_mm if proof else None,
        rotation_deg=proof.rotation_deg if proof else None,
        dataset=folder if found.kept else None,
        reasons=tuple(found.reasons),
        error=found.error,
        seconds=round(time.perf_counter() - begin, 4),
    )
