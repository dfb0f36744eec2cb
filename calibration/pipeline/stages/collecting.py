"""Stage collect: simulated datasets, by our own simulation or by the team's applications."""

import time
from dataclasses import replace

from calibration.base import CalibrationError
from calibration.base.addons import import_attribute, of_addons
from calibration.ci.execution.backends import EMBEDDED
from calibration.ci.execution.supervision import BeginWatch
from calibration.ci.workflow.streams import progress
from calibration.pipeline.collection.dispatch import collect_dataset
from calibration.pipeline.collection.report import pose_line
from calibration.pipeline.collection.request import CollectionRequest
from calibration.pipeline.results import Collected
from calibration.pipeline.stages.running import COLLECTED_FOLDER, PipelineRun
from calibration.robot.simulation.record import Record


def collect_stage(run: PipelineRun) -> PipelineRun:
    """Collect datasets, each in its folder below the output folder, and calibrate them.

    A failed collection is stored in the results, and does not stop the others.
    """
    collections = tuple(_collect_one(request, run) for request in run.simulations)
    return replace(run, results=replace(run.results, collections=collections))


def _collect_one(request: CollectionRequest, run: PipelineRun) -> Collected:
    name, folder, begin = request.name, f"{COLLECTED_FOLDER}/{request.name}", time.perf_counter()
    try:
        target = replace(run.target, backend=request.backend or EMBEDDED, watch=_watch_of(request, run))
        request = replace(request, target=target)
        with progress(run.runner, f"collect {name}", bar=request.backend == EMBEDDED) as advance:

            def done(count: int, total: int, record: Record) -> None:
                advance(count, total, f"{name}: {pose_line(record)}", important=not record.kept)

            found = collect_dataset(request, run.output / folder, True, run.jobs, done=done)
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


def _watch_of(request: CollectionRequest, run: PipelineRun) -> BeginWatch | None:
    """Return the watch of an add-on that follows what the containers say by rosbridge; None for none.

    Raises:
        CalibrationError: what it is to look for cannot be parsed, or a library is not installed.
    """
    recording = request.applications.record
    if recording is None or recording.rosbridge is None:
        return None
    for section, target in of_addons(lambda addon: addon.watches).items():
        settings = run.sections.of(section)
        watch: BeginWatch | None = settings and import_attribute(target)(settings, request.name, recording.rosbridge)
        if watch is not None:
            return watch
    run.runner.log(f"{request.name}: record.rosbridge: no section judges what this entry records: nothing is watched")
    return None
