"""System with its data in memory, shared by all of its cells: read and checked before any calibration."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from dataclasses import field as dataclass_field
from functools import cached_property
from pathlib import Path

import numpy as np

from calibration.base import InputError, did_you_mean
from calibration.base.tables.rules import RuleSet
from calibration.base.tables.table import EveryRow, parse_table
from calibration.base.tables.table_verdict import judge
from calibration.engine.baseline.calibration_document import CalibrationDocument, CalibrationDocuments
from calibration.engine.baseline.verdict import Accepted
from calibration.engine.comparison import method_of
from calibration.engine.dataset.model import Dataset
from calibration.engine.dataset.reading import read_dataset, refuse_changes
from calibration.engine.dataset.writing import DatasetWriter, bring_payload
from calibration.engine.diagnosis.against_optimum import OurOptimum, find_optimum
from calibration.engine.diagnosis.check_data import check_data
from calibration.engine.diagnosis.conventions.trying import conventions
from calibration.engine.diagnosis.copies import without_copies
from calibration.engine.diagnosis.diagnose import diagnose
from calibration.engine.diagnosis.finding import Finding
from calibration.engine.diagnosis.limits import Limits
from calibration.engine.estimation.calibrate import Prepared, prepare
from calibration.engine.estimation.options import Options
from calibration.engine.estimation.start.lens_choice import LensChoice, with_chosen_lenses
from calibration.engine.evaluation.label_errors import REPROJECTION_COLUMNS
from calibration.engine.evaluation.specification import Evaluation, parse_evaluation
from calibration.engine.evaluation.table import COLLECTION_HEADER, Table
from calibration.engine.evaluation.truth import Truth, choose_truth
from calibration.engine.tasks.placed_task import frames_of_task
from calibration.engine.tasks.robot_task import RobotTask, WorkPoses
from calibration.engine.tasks.task_errors import task_errors
from calibration.pipeline.system import Datasets, Exports, System
from calibration.robot.urdf import ROBOT_FILE, Robot, compose, read_robot


@dataclass(frozen=True, eq=False)
class LoadedSystem:
    """System with its data in memory."""

    name: str
    dataset: Dataset
    truth: Truth | None
    evaluation: Evaluation | None
    options: Options = dataclass_field(default_factory=Options)
    """Options of our engine."""
    limits: Limits = dataclass_field(default_factory=Limits)
    """Limits of its result's errors."""
    tasks: tuple[RobotTask, ...] = ()
    """What the robot does with its calibration."""
    datasets: Datasets = "full"
    """What is written of its cells' calibrated datasets."""
    accepted: Accepted | None = None
    """Accepted calibration to compare with; None if there is none."""
    left_out: tuple[Finding, ...] = ()
    """Warnings of what the dataset is without."""
    lenses: Mapping[str, LensChoice] = dataclass_field(default_factory=dict)
    """Lens models that were chosen by their fit, by camera."""
    exports: Exports | None = None
    """With the robot's description, if there is one."""

    @property
    def lens_notes(self) -> tuple[Finding, ...]:
        """Notes on the lens models that were chosen."""
        return tuple(Finding("lens", "note", f"'{name}': {each.reason}", (name,)) for name, each in self.lenses.items())

    def check(self) -> None:
        """Refuse data that would calibrate to nonsense; checked once, however many cells there are.

        Raises:
            InputError: there is a fault.
        """
        return self._check_once

    @cached_property
    def _check_once(self) -> None:
        check_data(self.dataset)

    @cached_property
    def conventions(self) -> tuple[Finding, ...]:
        """Findings on the conventions of a sound dataset that cannot be calibrated."""
        try:
            self.check()
        except InputError:
            return ()
        return conventions(None, self.dataset, self.options)

    @cached_property
    def writer(self) -> DatasetWriter:
        """Writer of its cells' calibrated datasets."""
        return DatasetWriter(self.dataset)

    def dataset_text(self, dataset: Dataset) -> str | None:
        """Return the text of a cell's calibrated dataset, or of its changes; None if none is written.

        Raises:
            InputError: a transform is not finite.
        """
        if self.datasets == "none":
            return None
        return self.writer.text(dataset) if self.datasets == "full" else self.writer.changes_text(dataset)

    def write_dataset(self, text: str, dataset: Dataset, folder: Path) -> None:
        """Write a text of `dataset_text`, and beside a full dataset its point clouds and depth images.

        Not its images, which are larger than everything else.

        Raises:
            InputError: the folder is that of the system's own dataset.
            InfrastructureError: a file cannot be written.
        """
        if self.datasets == "full":
            bring_payload(dataset, folder, images=False)
        self.writer.write_text(text, folder)

    @cached_property
    def prepared(self) -> Prepared:
        """All that its cells' calibrations share.

        Raises:
            InputError: it cannot be calibrated.
        """
        return prepare(self.dataset, self.options)

    @cached_property
    def snapshots(self) -> CalibrationDocuments:
        """Snapshots of its cells' calibrations."""
        return CalibrationDocuments(self.dataset, self.options)

    @cached_property
    def optimum(self) -> OurOptimum:
        """Optimum of our engine, which does not depend on an initial guess.

        Raises:
            InputError: there is none.
        """
        return find_optimum(self.dataset, self.options)

    @cached_property
    def optimum_snapshot(self) -> CalibrationDocument:
        """Snapshot of the optimum, without a table."""
        return self.snapshots.of(self.optimum.calibration, None)

    def findings_of(self, optimum: OurOptimum) -> tuple[Finding, ...]:
        """Return the findings on an optimum for some result of this system; most results have the system's own."""
        return self._findings_on_optimum if optimum is self.optimum else self._diagnose_optimum(optimum)

    @cached_property
    def _findings_on_optimum(self) -> tuple[Finding, ...]:
        return self._diagnose_optimum(self.optimum)

    def _diagnose_optimum(self, optimum: OurOptimum) -> tuple[Finding, ...]:
        tasks = task_errors(optimum.calibration, self.tasks)
        return diagnose(optimum.calibration, optimum.given, optimum.options, self.limits, self.truth is not None, tasks)


def load(system: System) -> LoadedSystem:
    """Read a system's data, and check its options.

    Raises:
        InputError: the dataset, the truth, the evaluation, a rule for its table, a comparison method or the
            covariance of intrinsics is wrong; no lens model fits a camera.
    """
    dataset, copies = read_dataset(system.dataset), tuple[Finding, ...]()
    if system.copies == "leave-out" and system.software is None:  # which is given the folder with all collections
        dataset, copies = without_copies(dataset)
    lenses = with_chosen_lenses(dataset, system.options)
    dataset = lenses.dataset
    truth = choose_truth(dataset, system.truth)
    _check_methods(system)
    evaluation = parse_evaluation(system.evaluate) if system.evaluate else None
    for sensor in evaluation.sensors if evaluation else ():
        if missing := sensor not in dataset.sensors and dataset.missing_files_of(sensor):
            raise InputError(
                f"evaluation '{evaluation}': {dataset.path}: {missing}; put them beside it, or evaluate other sensors"
            )
        if sensor not in dataset.sensors:
            raise InputError(
                f"evaluation '{evaluation}': {dataset.path} has no sensor '{sensor}'"
                f"{did_you_mean(sensor, dataset.sensors)} (sensors: {', '.join(dataset.sensors)})"
            )
    tasks = _known_tasks(system, dataset)
    options = replace(system.options, intrinsics_covariance=system.options.known_intrinsics())
    loaded = LoadedSystem(
        system.name,
        dataset,
        truth,
        evaluation,
        options,
        system.judging_limits,
        tasks,
        system.datasets,
        system.accepted,
        copies,
        lenses.choices,
        system.exports,
    )
    if system.datasets == "changes":
        refuse_changes(system.dataset, dataset.path)
        loaded.writer.reference  # noqa: B018 (of the bytes that were read)
    if system.datasets == "none" and system.exports is not None:
        raise InputError(f"systems.{system.name}.datasets: found none, expected changes or full: it has exports")
    loaded.check()  # before the fork, so that all cells share the result
    if system.rules is not None and system.software is None:  # other software's table may have any columns
        check_rules(system.rules, loaded)
    return loaded


def _known_tasks(system: System, dataset: Dataset) -> tuple[RobotTask, ...]:
    """Return the tasks of a system, with the poses of their joints.

    Raises:
        InputError: the dataset does not have a task's sensors or frames, or the robot not its joints.
    """
    tasks = []
    for task in system.tasks:
        try:
            if task.joints is not None:
                robot = described_robot(dataset.path.parent, system.exports)
                task = replace(task, work_poses=work_poses(task, dataset, robot))
            frames_of_task(dataset, task)
        except InputError as error:
            raise InputError(f"systems.{system.name}.{error}") from None
        tasks.append(task)
    return tuple(tasks)


def _check_methods(system: System) -> None:
    """Refuse comparison methods that there are not.

    Raises:
        InputError: there is one.
    """
    for method in system.compare:
        try:
            method_of(method)
        except InputError as error:
            raise InputError(f"systems.{system.name}.compare: {error}") from None


def check_rules(rules: RuleSet, system: LoadedSystem) -> None:
    """Refuse rules that do not match a system's table, before any calibration.

    They are applied to the table of the uncalibrated dataset, which has the columns and rows of every cell; the values
    are ignored.

    Raises:
        InputError: a column or a row is missing, or a rule needs a table to compare with.
    """
    name = f"{system.name}, rules for {system.evaluation or 'the reprojection errors'}"
    table, complete = _table_to_come(system)
    if table is None:
        return
    if not complete:  # a bad initial guess may lack rows that a calibration has
        rules = RuleSet(tuple(replace(rule, target=EveryRow()) for rule in rules.rules), key_column=rules.key_column)
    if rules.judges:
        judge(parse_table(table.to_csv(), name, ","), rules)


def _table_to_come(system: LoadedSystem) -> tuple[Table | None, bool]:
    """Return a table with the cells' columns, or None if it is unknown; and whether it has every row."""
    if system.evaluation is None:
        labels = tuple(collection.key for collection in system.dataset.collections)
        return Table(
            COLLECTION_HEADER, REPROJECTION_COLUMNS, labels, np.zeros((len(labels), len(REPROJECTION_COLUMNS)))
        ), True
    try:
        table = system.evaluation.run(system.dataset, system.truth)
    except InputError:  # not comparable before the calibration: the cells will report the fault
        return None, False
    return table, not table.left_out


def described_robot(folder: Path, exports: Exports | None) -> Robot | None:
    """Return the robot by the description of its exports, else by that beside its dataset; None if there is none.

    Args:
        folder: of the dataset.
        exports: of the system.

    Raises:
        InputError: the description is wrong.
        InfrastructureError: it is a xacro, and what expands it is not installed.
    """
    if exports is not None and exports.robot_description is not None:
        return read_robot(exports.robot_description, exports.xacro)
    return read_robot(folder / ROBOT_FILE) if (folder / ROBOT_FILE).is_file() else None


def work_poses(task: RobotTask, dataset: Dataset, robot: Robot | None) -> WorkPoses:
    """Return the poses of a task's joints: the dataset's transforms between links of the robot that these move.

    Raises:
        InputError: there is no description, it has not such a joint, or a position is beyond its limits.
    """
    given, where = task.joints or {}, f"tasks.{task.name}.joints"
    if robot is None:
        raise InputError(
            f"{where}: found no description of the robot, expected {ROBOT_FILE} beside {dataset.path.name}, or "
            "exports: {robot-description: ...}"
        )
    try:
        all_of = robot.transforms({name: np.array(at) for name, at in given.items()})
    except InputError as error:
        raise InputError(f"{where}: {error}") from None
    transforms, positions, others = {}, {}, {}
    for edge in dataset.transforms:
        if not set(edge) <= set(robot.tree.frames):
            continue
        steps = [robot.by_edge[step.parent, step.child] for step in robot.tree.path(*edge)]
        moving = [joint for joint in steps if joint.is_movable]
        if unknown := tuple(joint.driver for joint in moving if joint.driver not in given):
            others[edge] = unknown
        elif moving:
            transforms[edge] = compose(robot.tree, all_of, *edge)
            if len(steps) == 1:
                driven = np.array(given[moving[0].driver])
                positions[edge] = driven if (mimic := moving[0].mimic) is None else mimic.positions(driven)
    return WorkPoses(len(next(iter(given.values()))), transforms, positions, others)
