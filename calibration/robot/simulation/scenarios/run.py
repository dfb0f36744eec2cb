"""Run of scenarios: each is collected, calibrated, and compared with its ground truth."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from calibration.base.errors import InputError
from calibration.base.files import temporary_folder
from calibration.engine.dataset import truth
from calibration.engine.dataset.reading import FILE_NAME
from calibration.engine.dataset.writing import write_document
from calibration.robot.simulation.collection.capture import Requirements
from calibration.robot.simulation.collection.dataset_folder import dataset_document, truth_document
from calibration.robot.simulation.collection.proof import Proof, prove
from calibration.robot.simulation.collection.record import Record, collect_pose, corner_rms, kept
from calibration.robot.simulation.motion.sequence import Motion
from calibration.robot.simulation.placement import Play, play
from calibration.robot.simulation.scenarios.scenario import Scenario, ScenarioResult, content_hash
from calibration.robot.simulation.scenarios.scenario_set import ScenarioSet
from calibration.robot.simulation.scenarios.world import build_world, scenario_motion


def scenario_play(scenarios: ScenarioSet, scenario: Scenario, motion: Motion | None = None) -> Play:
    """Return the played motion of a scenario: its system, its motion and its seed.

    Args:
        scenarios: the scenario's set.
        scenario: from `ScenarioSet.scenario`.
        motion: the same for all scenarios; None to generate one for this scenario.

    Raises:
        InputError: no motion is found, or it does not fit the scenario's system.
    """
    world = build_world(scenarios.system, scenario)
    return play(world, motion or scenario_motion(world, scenario), scenario.collection_seed)


def run_scenario(
    scenarios: ScenarioSet,
    scenario: Scenario,
    motion: Motion | None = None,
    requirements: Requirements | None = None,
    scratch: Path | None = None,
) -> ScenarioResult:
    """Collect, calibrate and judge one scenario. A failed calibration is a result too, with its reasons.

    Args:
        scenarios: the scenario's set.
        scenario: from `ScenarioSet.scenario`.
        motion: see `scenario_play`.
        requirements: of its collections.
        scratch: folder for temporary files; its owner removes what a worker leaves that dies.

    Raises:
        InfrastructureError: no temporary file can be written.
    """
    result = pending_result(scenarios, scenario, motion)
    try:
        played = scenario_play(scenarios, scenario, motion)
    except InputError as error:
        return replace(result, reasons=(str(error),))
    with temporary_folder(parent=scratch) as folder:
        records = _collect_every_pose(played, requirements or Requirements(), folder)
        return finished_result(result, records, prove(folder) if kept(records) else None)


def pending_result(scenarios: ScenarioSet, scenario: Scenario, motion: Motion | None = None) -> ScenarioResult:
    """Return the result of a scenario that has not run: its id, its hash and its values."""
    return ScenarioResult(scenario.id, content_hash(scenarios.system, scenario, motion), dict(scenario.values))


def finished_result(result: ScenarioResult, records: Sequence[Record], proof: Proof | None) -> ScenarioResult:
    """Return the result of a scenario that has run: its collections, and the errors of its calibration.

    Args:
        result: see `pending_result`.
        records: records of all its poses.
        proof: None if no pose gave a collection.
    """
    result = _with_collections(result, records) if records else result
    return calibrated_result(result, proof) if proof else replace(result, reasons=("no pose gave a collection",))


def _collect_every_pose(played: Play, requirements: Requirements, folder: Path) -> list[Record]:
    """Collect every pose into a folder, without images: only the files that a calibration needs."""
    records = []
    for number in range(len(played)):
        record, files = collect_pose(played, number, requirements, images=False)
        records.append(record)
        for name, content in files.items():
            (folder / name).write_bytes(content)
    if kept(records):
        write_document(truth_document(played, kept(records)), folder / truth.FILE_NAME)
        write_document(dataset_document(played.system, kept(records)), folder / FILE_NAME)
    return records


def _with_collections(result: ScenarioResult, records: Sequence[Record]) -> ScenarioResult:
    """Return the result with the collections' numbers."""
    return replace(
        result,
        poses=len(records),
        lost={record.key: tuple(record.lost) for record in records if not record.kept},
        detection={
            name: round(sum(record.labels[name] > 0 for record in records) / len(records), 4)
            for name in records[0].labels
        },
        corner_rms_px=corner_rms(records),
    )


def calibrated_result(result: ScenarioResult, proof: Proof) -> ScenarioResult:
    """Return the result with the errors of a calibration."""
    sigmas = list((proof.sigmas or {}).values())
    return replace(
        result,
        converged=proof.converged,
        rms_px=proof.rms_px,
        translation_mm=proof.translation_mm,
        rotation_deg=proof.rotation_deg,
        joint_mm=proof.joint_mm,
        joint_deg=proof.joint_deg,
        sigma_mm=max((sigma.translation_mm for sigma in sigmas), default=None),
        sigma_deg=max((sigma.rotation_deg for sigma in sigmas), default=None),
        reasons=() if proof.converged else (proof.reason or "the calibration did not converge",),
    )
