"""System with its data in memory, shared by all of its cells."""

from collections.abc import Mapping
from dataclasses import dataclass
from dataclasses import field as dataclass_field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

from calibration.base import InputError
from calibration.engine.baseline.calibration_document import CalibrationDocument, CalibrationDocuments
from calibration.engine.baseline.verdict import Accepted
from calibration.engine.dataset.model import Dataset
from calibration.engine.dataset.writing import DatasetWriter, bring_payload
from calibration.engine.diagnosis.against_optimum import OurOptimum, find_optimum
from calibration.engine.diagnosis.check_data import check_data
from calibration.engine.diagnosis.conventions.trying import conventions
from calibration.engine.diagnosis.diagnose import diagnose
from calibration.engine.diagnosis.finding import Finding
from calibration.engine.diagnosis.limits import Limits
from calibration.engine.estimation.calibrate import Prepared, prepare
from calibration.engine.estimation.options import Options
from calibration.engine.estimation.start.lens_choice import LensChoice
from calibration.engine.evaluation.truth import Truth
from calibration.engine.tasks.robot_task import RobotTask
from calibration.engine.tasks.task_errors import task_errors

if TYPE_CHECKING:
    from calibration.engine.evaluation.specification import Evaluation
    from calibration.pipeline.system import Datasets, Exports


@dataclass(frozen=True, eq=False)
class LoadedSystem:
    """System with its data in memory."""

    name: str
    dataset: Dataset
    truth: Truth | None
    evaluation: "Evaluation | None"
    options: Options = dataclass_field(default_factory=Options)
    """Options of our engine."""
    limits: Limits = dataclass_field(default_factory=Limits)
    """Limits of its result's errors."""
    tasks: tuple[RobotTask, ...] = ()
    """What the robot does with its calibration."""
    datasets: "Datasets" = "full"
    """What is written of its cells' calibrated datasets."""
    accepted: Accepted | None = None
    """Accepted calibration to compare with; None if there is none."""
    left_out: tuple[Finding, ...] = ()
    """Warnings of what the dataset is without."""
    lenses: Mapping[str, LensChoice] = dataclass_field(default_factory=dict)
    """Lens models that were chosen by their fit, by camera."""
    exports: "Exports | None" = None
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
