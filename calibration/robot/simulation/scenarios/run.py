"""Run of scenarios: each is collected, calibrated, and compared with its ground truth."""

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from calibration.base import InputError, temporary_folder
from calibration.engine.dataset.reading import FILE_NAME
from calibration.engine.dataset.writing import write_document
from calibration.engine.estimation.options import ALL_EXACT, Assumptions
from calibration.engine.evaluation.truth import TRUTH_FILE
from calibration.robot.simulation.capture import Requirements
from calibration.robot.simulation.dataset_folder import dataset_document, truth_document
from calibration.robot.simulation.kinematics import Play, play
from calibration.robot.simulation.motion import Motion
from calibration.robot.simulation.proof import Proof, prove
from calibration.robot.simulation.record import Record, collect_pose, corner_rms, kept
from calibration.robot.simulation.scenarios.scenario import (
    Scenario,
    ScenarioResult,
    build_world,
    content_hash,
    parse_id,
    scenario_motion,
)
from calibration.robot.simulation.scenarios.scenario_set import ScenarioSet

MAX_LEFT_BY_DRIVER = 0.5
"""Largest share of the error's standard deviations that is left without what drives it."""


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
        return finished_result(
            result, records, prove(folder, assume=world_assumptions(scenarios)) if kept(records) else None
        )


_QUANTILES = tuple((number + 0.5) / 64 for number in range(64))


def world_assumptions(scenarios: ScenarioSet) -> Assumptions:
    """Return how well is known what a scenario has otherwise than its dataset says: how flat patterns are.

    All else that a dataset holds is exact, and what is moved (assembly, joints) is calibrated.
    """
    drawn = scenarios.parameters.distributions
    bows = [drawn[name].value(u) / 1000 for name in scenarios.parameters.named("pattern.bow_mm") for u in _QUANTILES]
    return replace(ALL_EXACT, flatness=math.sqrt(sum(bow**2 for bow in bows) / len(bows))) if bows else ALL_EXACT


def find_driver(
    scenarios: ScenarioSet,
    result: ScenarioResult,
    motion: Motion | None = None,
    requirements: Requirements | None = None,
) -> str:
    """Name what explains a scenario's error beyond its error bar: the part of the set without which it is least.

    The scenario is collected again with the same motion and the same noise, each time with one part of the set (light,
    cameras, motion, ...) as the system describes it. Labels are found anew, so what acts by them is seen too.

    Args:
        scenarios: the scenario's set.
        result: of the scenario; it has a calibration.
        motion: see `scenario_play`.
        requirements: see `run_scenario`.

    Raises:
        InfrastructureError: no temporary file can be written.
    """
    scenario = scenarios.scenario(*parse_id(result.id))
    same = scenario_play(scenarios, scenario, motion).motion
    parts: dict[str, dict[str, float]] = {}
    for group, names in scenarios.parameters.groups.items():
        parts.setdefault(group.partition(".")[0], {}).update({name: scenario.values[name] for name in names})
    sigmas, before = {}, result.error_sigmas or 0.0
    for part, values in parts.items():
        others = {name: value for name, value in scenario.values.items() if name not in values}
        again = run_scenario(scenarios, replace(scenario, values=others), same, requirements)
        sigmas[part] = math.inf if again.error_sigmas is None else again.error_sigmas
    best = min(sigmas, key=lambda part: sigmas[part], default="")
    if not best or sigmas[best] > before * MAX_LEFT_BY_DRIVER:
        return "none of the drawn quantities alone"
    drawn = ", ".join(f"{name} {value:.3g}" for name, value in parts[best].items())
    return f"{best} ({drawn}), as described it is off by {sigmas[best]:.2g}"


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
        write_document(truth_document(played, kept(records)), folder / TRUTH_FILE)
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
        error_sigmas=proof.error_sigmas,
        chance=proof.chance,
        reasons=() if proof.converged else (proof.reason or "the calibration did not converge",),
    )
