"""Plan of a workflow for a pipeline: its jobs and the cells that each calibrates; as outputs of a job, and a file."""

import hashlib
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, TypeAlias

from calibration.base import InfrastructureError, InputError, did_you_mean, number_text, read_bytes
from calibration.base.addons import AddonStage, of_addons
from calibration.base.records import between, field, record
from calibration.ci.execution.backends import Sections
from calibration.engine.estimation.start.guesses import StartingNoise
from calibration.pipeline.configuration import PipelineConfiguration
from calibration.pipeline.matrix.cell_result import Cell
from calibration.pipeline.system import NoiseGrid, System

STAGE_OF_JOB: Mapping[str, AddonStage] = {
    stage.job: stage for stage in of_addons(lambda addon: addon.stages).values() if stage.job
}
"""Stages of add-ons by their jobs, whose names are the slugs of their artifacts too."""
CHOOSABLE_JOBS = ("calibrate", "collect-data", *STAGE_OF_JOB, "unit-tests", "static-analysis")
"""Jobs that a user can choose."""
MAX_SLUG_LENGTH = 80
"""Limit of a slug's length."""
_NOT_IN_SLUG = re.compile(r"[^A-Za-z0-9._-]+")
MAX_JOBS = 256
"""GitHub's limit of a matrix."""
MAX_BYTES_IN_ONE_JOB = 60_000_000
"""Limit, in bytes of dataset.json, of all labels in a job with all noises: our engine reads and calibrates a
megabyte in 0.1 to 0.3 s on one core, on GitHub's machines in less than a second.
"""
COLLECTED_DATA, UNIT_TESTS, STATIC_ANALYSIS, CHECK = "collected-data", "unit-tests", "static-analysis", "check"
"""Slugs of the artifacts of these jobs."""
MAX_MINUTE_RATE = 1000.0
"""Limit of the price of a minute, in any currency, to find typing errors."""
PLAN_SLUG = "plan"
"""Slug of the plan's own artifact."""
CALIBRATING_JOBS = ("calibrate", "calibrate-in-image", "calibrate-collected", "calibrate-collected-in-image")
"""Jobs of the workflow that calibrate. Those in an image have the permissions of the caller, for its registry."""
ImageSource: TypeAlias = Literal["", "own", "built", "given"]
"""Image of the team's software: none (our engine calibrates), the one that the system names, the one that
the job builds, the one that the workflow was given.
"""


@dataclass(frozen=True)
class JobCell:
    """Job of the matrix: a system with one noise, or with all of them."""

    name: str
    """Name of the job."""
    slug: str
    """Name of its artifact and its folder."""
    system: str
    translations: tuple[float, ...]
    """m."""
    rotations: tuple[float, ...]
    """rad."""
    dataset: str = ""
    """Path of the dataset; empty if it is in the configuration."""
    image: ImageSource = ""
    collected: bool = False
    """Whether the job collect-data collects the dataset."""

    @property
    def job(self) -> str:
        """The one of ``CALIBRATING_JOBS`` that calibrates it."""
        return "calibrate" + "-collected" * self.collected + "-in-image" * bool(self.image)

    def starts(self, seeds: Sequence[int]) -> list[Cell]:
        """Return all cells that the job calibrates."""
        return [
            Cell(self.system, StartingNoise(t, r, seed))
            for t in self.translations
            for r in self.rotations
            for seed in seeds
        ]


@dataclass(frozen=True)
class WorkflowPlan:
    """Jobs of a run."""

    cells: tuple[JobCell, ...] = ()
    """Cells of all jobs that calibrate."""
    seeds: tuple[int, ...] = (1,)
    simulations: tuple[str, ...] = ()
    """Simulations that are collected."""
    unit_tests: bool = False
    image: bool = False
    """Whether the image is built and pushed before the cells, so that they only pull it."""
    collects_in_containers: bool = False
    """Whether a simulation is one of the team's applications, in place of our own."""
    collects_in_image: bool = False
    """Whether a simulation runs in the image that the pipeline builds."""
    push: bool = False
    """Whether the cells may push the image that they build."""
    promote: tuple[str, ...] = ()
    """Tags of the image after a pass verdict."""
    minute_rate: float | None = None
    """Cost of a minute of a job."""
    static_analysis: bool = False
    stages: tuple[str, ...] = ()
    """Jobs that run a stage of an add-on."""
    tests_in_image: bool = False
    """Whether such a stage runs in the image that the pipeline builds."""

    @property
    def cells_of_job(self) -> Mapping[str, tuple[JobCell, ...]]:
        """The cells of each job that calibrates."""
        return {job: tuple(cell for cell in self.cells if cell.job == job) for job in CALIBRATING_JOBS}

    @property
    def jobs(self) -> Mapping[str, bool]:
        """Jobs of the workflow that the verdict waits for, and whether each runs."""
        cells = {job: bool(cells) for job, cells in self.cells_of_job.items()}
        return {
            "image": self.image,
            "calibrate": cells["calibrate"],
            "calibrate-in-image": cells["calibrate-in-image"],
            "collect-data": bool(self.simulations) and not self.collects_in_containers,
            "collect-data-in-containers": bool(self.simulations) and self.collects_in_containers,
            "calibrate-collected": cells["calibrate-collected"],
            "calibrate-collected-in-image": cells["calibrate-collected-in-image"],
            **{job: job in self.stages for job in STAGE_OF_JOB},
            "unit-tests": self.unit_tests,
            "static-analysis": self.static_analysis,
        }


@record(kw_only=True)
class JobInputs:
    """Inputs of the workflow that select the jobs."""

    noise_inside_cells: bool | None = field(
        "Calibrate a system from all its noises in one job (if that takes about a minute).", default=None
    )
    image: str | None = field("Image with the team's own calibration.", default=None)
    command: str | None = field("Command of this image.", default=None)
    tests: str | None = field("The command that runs the unit tests.", default=None)
    analyse: bool = field("Analyse the code of the repository (no).", default=False)
    jobs: tuple[str, ...] = field(f"Only these jobs: {', '.join(CHOOSABLE_JOBS)}.", default=())
    may_promote: bool = field("An image that passes may get its release tags (yes).", default=True, formerly="promote")
    minute_rate: Annotated[float, between(0, MAX_MINUTE_RATE)] | None = field(
        "Price of a minute of a job, in your currency: 0.006.", default=None
    )
    push: bool = True
    """False without credentials to push, as in a fork."""


def datasets_as_configuration(datasets: Sequence[Path]) -> PipelineConfiguration:
    """Return the configuration of systems that are only given as datasets.

    Raises:
        InputError: two of them have the same name.
    """
    named: dict[str, System] = {}
    for dataset in datasets:
        folder = dataset.parent if dataset.suffix == ".json" else dataset
        name = folder.resolve().name
        if name in named:
            raise InputError(
                f"datasets: {named[name].dataset} and {dataset} are both called '{name}'; rename one, "
                "or name the systems in a calibration.yml"
            )
        named[name] = System(name, dataset)
    return PipelineConfiguration(systems=tuple(named.values()))


def plan_jobs(
    configuration: PipelineConfiguration | None,
    systems: Sequence[System],
    noise: NoiseGrid,
    inputs: JobInputs,
    *,
    by_path: bool,
) -> WorkflowPlan:
    """Plan the jobs, and the cells of each.

    Args:
        configuration: configuration of the pipeline; None if there are only unit tests to run.
        systems: the selected systems.
        noise: of all cells.
        inputs: the workflow's inputs.
        by_path: whether the cells name datasets, because there is no file with the systems.

    Raises:
        InputError: a selected job has nothing to do, the matrix is too large, or the configuration repeats its runs.
    """
    if configuration is not None and (repeat := configuration.repetitions.repeat) > 1:
        raise InputError(f"repeat: found {repeat}: a workflow of jobs runs once; use the root action, or remove it")
    simulations = configuration.simulations if configuration else ()
    sections = configuration.sections if configuration else Sections()
    stages = [job for job, stage in STAGE_OF_JOB.items() if sections.of(stage.section) is not None]
    wanted = _wanted_jobs(
        inputs, bool(systems), bool(simulations), stages, analysis=sections.of("analysis") is not None
    )
    calibrated = systems if "calibrate" in wanted else ()
    waiting = [system.name for system in calibrated if system.collected is not None]
    if waiting and "collect-data" not in wanted:
        raise InputError(
            f"jobs: the dataset of the system '{waiting[0]}' is made by the job collect-data: add that, "
            "or name other systems"
        )
    cells = _planned_cells(calibrated, noise, inputs, by_path)
    collected = simulations if "collect-data" in wanted else ()
    section = configuration.image if configuration else None
    built = next((cell for cell in cells if cell.image == "built"), None)
    if built is not None and section is None:
        raise InputError(f"command: the system '{built.system}' has no image to run it in: add the input image")
    push = section is not None and section.push and inputs.push
    in_image = any(not container.image for each in collected for container in each.applications.containers)
    stages = [job for job in stages if job in wanted]
    tests_in_image = section is not None and any(STAGE_OF_JOB[job].needs_image for job in stages)
    image = push and (built is not None or in_image or tests_in_image)
    return WorkflowPlan(
        cells,
        noise.seeds,
        tuple(simulation.name for simulation in collected),
        "unit-tests" in wanted,
        image=image,
        collects_in_containers=any(simulation.applications.containers for simulation in collected),
        collects_in_image=in_image,
        push=push,
        promote=section.promote if section is not None and image and inputs.may_promote else (),
        minute_rate=inputs.minute_rate,
        static_analysis="static-analysis" in wanted,
        stages=tuple(stages),
        tests_in_image=tests_in_image,
    )


def _wanted_jobs(
    inputs: JobInputs, systems: bool, simulations: bool, stages: Sequence[str], analysis: bool
) -> list[str]:
    possible = {
        "calibrate": systems,
        "collect-data": simulations,
        **{job: job in stages for job in STAGE_OF_JOB},
        "unit-tests": bool(inputs.tests),
        "static-analysis": inputs.analyse or analysis,
    }
    missing = {
        "calibrate": "the configuration has no systems",
        "collect-data": "the configuration has no simulation",
        **{job: f"the configuration has no section {stage.section}" for job, stage in STAGE_OF_JOB.items()},
        "unit-tests": "the input tests is empty: name the command that runs them",
        "static-analysis": "the configuration has no section analysis",
    }
    for job in inputs.jobs:
        if job not in CHOOSABLE_JOBS:
            raise InputError(
                f"jobs: there is no job '{job}'{did_you_mean(job, CHOOSABLE_JOBS)} (known: {', '.join(CHOOSABLE_JOBS)})"
            )
        if not possible[job]:
            raise InputError(f"jobs: there is nothing for {job} to do: {missing[job]}")
    wanted = [job for job in CHOOSABLE_JOBS if possible[job] and (not inputs.jobs or job in inputs.jobs)]
    if not wanted:
        raise InputError("jobs: there is nothing to do: no systems, no simulation, no tests, no analysis")
    return wanted


def _planned_cells(
    systems: Sequence[System], noise: NoiseGrid, inputs: JobInputs, by_path: bool
) -> tuple[JobCell, ...]:
    with_all_noises = [_with_all_noises(system, noise, inputs) for system in systems]
    pairs = [
        (system, *grid)
        for system, every in zip(systems, with_all_noises, strict=True)
        for grid in _noises_of_jobs(noise, every)
    ]
    count = len(pairs)
    if count > MAX_JOBS:
        advice = (
            "name fewer systems"
            if all(with_all_noises)
            else "set noise-inside-cells: true, and one job calibrates a system from all its noises"
        )
        raise InputError(
            f"the matrix has {count} jobs ({len(systems)} systems x {len(noise.translations)} translation noises x "
            f"{len(noise.rotations)} rotation noises), GitHub takes {MAX_JOBS}: {advice}"
        )
    names = [_name_of_job(system.name, t, r) for system, t, r in pairs]
    taken = (PLAN_SLUG, COLLECTED_DATA, *STAGE_OF_JOB, UNIT_TESTS, STATIC_ANALYSIS, CHECK)
    found = slugs([name.replace(", ", "_").replace(" ", "") for name in names], taken)
    return tuple(
        JobCell(
            name,
            slug,
            system.name,
            t,
            r,
            dataset=str(system.dataset) if by_path else "",
            image=_image_source(system, inputs),
            collected=system.collected is not None,
        )
        for (system, t, r), name, slug in zip(pairs, names, found, strict=True)
    )


def _with_all_noises(system: System, noise: NoiseGrid, inputs: JobInputs) -> bool:
    """Whether one job calibrates a system from all its noises: as requested, else if that takes about a minute.

    A job takes longer to start than our engine to calibrate; software in containers gets a job for each start.
    """
    if inputs.noise_inside_cells is not None:
        return inputs.noise_inside_cells
    if system.software is not None or inputs.command:
        return False
    starts = len(noise.translations) * len(noise.rotations) * len(noise.seeds)
    return starts * _bytes_of_labels(system.dataset) <= MAX_BYTES_IN_ONE_JOB


def _bytes_of_labels(dataset: Path) -> int:
    """Return the size of a dataset's labels; 0 if it does not exist, which the job will report."""
    try:
        return (dataset if dataset.suffix == ".json" else dataset / "dataset.json").stat().st_size
    except OSError:
        return 0


def _noises_of_jobs(noise: NoiseGrid, every: bool) -> list[tuple[tuple[float, ...], tuple[float, ...]]]:
    """Return the noises of each job of a system: a job for every noise, or for each."""
    if every:
        return [(noise.translations, noise.rotations)]
    return [((t,), (r,)) for t in noise.translations for r in noise.rotations]


def _name_of_job(system: str, translations: tuple[float, ...], rotations: tuple[float, ...]) -> str:
    if len(translations) > 1 or len(rotations) > 1:
        return system
    return f"{system}, {number_text(translations[0])} m, {number_text(rotations[0])} rad"


def _image_source(system: System, inputs: JobInputs) -> ImageSource:
    if system.software is None and not inputs.command:
        return ""
    if inputs.image:
        return "given"
    return "own" if system.software is not None and system.software.container.image else "built"


def slugs(names: Sequence[str], taken: Sequence[str] = ()) -> list[str]:
    """Return a slug for each name, valid in file systems, artifacts and URLs.

    Letters, digits, dots, dashes and underscores, unique regardless of case.

    Args:
        names: the names; equal ones get different slugs too.
        taken: slugs that must not be used.
    """
    used = {slug.lower() for slug in taken}
    found = []
    for name in names:
        plain = _NOT_IN_SLUG.sub("_", name).strip("._-")[:MAX_SLUG_LENGTH] or "unnamed"
        slug, number = plain, 1
        while slug.lower() in used:
            number += 1
            slug = f"{plain}_{number}"
        used.add(slug.lower())
        found.append(slug)
    return found


MAX_OUTPUT_BYTES = 400 * 1024
"""Limit of all outputs: GitHub takes 1 MB from a job, and counts two bytes for a character."""


def plan_outputs(plan: WorkflowPlan) -> dict[str, str]:
    """Return the outputs of the job plan, one line each.

    The cells are an object by their names. A matrix has the names alone: GitHub shows all values of a matrix behind the
    name of a job.

    Raises:
        InputError: they are too large.
    """
    outputs = {
        **{job: "true" if runs else "false" for job, runs in plan.jobs.items()},
        **{f"{job}-names": _compact_json([cell.name for cell in cells]) for job, cells in plan.cells_of_job.items()},
        "cells": _compact_json({cell.name: _matrix_entry(cell) for cell in plan.cells}),
        "collects-in-image": "true" if plan.collects_in_image else "false",
        "tests-in-image": "true" if plan.tests_in_image else "false",
        "push": "true" if plan.push else "false",
        "promote": _compact_json(plan.promote),
        "plan-sha256": hashlib.sha256(plan_text(plan).encode()).hexdigest(),
    }
    size = len(_compact_json(outputs).encode())
    if size > MAX_OUTPUT_BYTES:
        raise InputError(
            f"the plan takes {size} bytes, {MAX_OUTPUT_BYTES} is the limit: set noise-inside-cells: true, or shorten "
            "the names of the systems and datasets"
        )
    return outputs


def plan_text(plan: WorkflowPlan) -> str:
    """Return the whole plan as JSON, for a file: an environment variable takes 128 KiB at most (MAX_ARG_STRLEN)."""
    return _compact_json(asdict(plan))


def plan_of_text(text: str, sha256: str) -> WorkflowPlan:
    """Parse the plan from the text of its file.

    Args:
        text: content of the file, which came by an artifact.
        sha256: hash of the file by an output of the job plan, which no other job can change.

    Raises:
        InputError: it is not the text with this hash.
    """
    if hashlib.sha256(text.encode()).hexdigest() != sha256:
        raise InputError("found another plan than the job plan has made: has another job replaced its artifact?")
    document = json.loads(text)
    cells = tuple(JobCell(**_with_tuples(cell)) for cell in document.pop("cells"))
    return WorkflowPlan(cells=cells, **_with_tuples(document))


def _with_tuples(document: dict[str, Any]) -> dict[str, Any]:
    return {key: tuple(value) if isinstance(value, list) else value for key, value in document.items()}


def _matrix_entry(cell: JobCell) -> dict[str, str]:
    return {
        "slug": cell.slug,
        "system": cell.system,
        "dataset": cell.dataset,
        "translation-noise": _comma_separated(cell.translations),
        "rotation-noise": _comma_separated(cell.rotations),
        "image": cell.image,
        "collected": "true" if cell.collected else "false",
    }


def _comma_separated(values: Sequence[float]) -> str:
    return ",".join(map(number_text, values))


def _compact_json(value: object) -> str:
    return json.dumps(value, separators=(",", ":"))


PLAN_FILE = "plan.json"
MAX_PLAN_BYTES = 4 * 1024**2
"""Limit of the plan's file: 256 jobs with long paths take half a megabyte."""


def read_plan(folder: Path, sha256: str) -> WorkflowPlan:
    """Read the plan from its artifact.

    Where it is the only artifact its file is in the folder itself: download-artifact makes a folder for each of
    several artifacts, but none for a single one.

    Raises:
        InputError: it is missing, or is not the file with this hash.
    """
    path = folder / PLAN_SLUG / PLAN_FILE
    path = path if path.exists() else folder / PLAN_FILE
    if not path.exists():
        raise InputError(f"{path}: the plan is missing: did the job plan keep its artifact?")
    return plan_of_text(read_bytes(path, MAX_PLAN_BYTES, "a plan").decode(errors="replace"), sha256)


def name_folders_by_slug(folder: Path, artifact_name: str) -> None:
    """Rename the folders of artifacts, NAME~SLUG, to the slugs alone; other files of the folder are not touched.

    Raises:
        InfrastructureError: one cannot be renamed.
    """
    prefix = f"{artifact_name}~"
    for path in sorted(folder.glob(f"{prefix}*")):
        try:
            path.rename(folder / path.name.removeprefix(prefix))
        except OSError as error:
            raise InfrastructureError(f"{path}: cannot be renamed: {error.strerror}") from error
