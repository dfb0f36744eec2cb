"""Software that a team has in the place of our engine: what it leaves, right and wrong, and the verdict on it."""

import tempfile
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks.rows import Bar, Row
from benchmarks.verdict.strata import Stratum, clean, entries
from calibration.ci.execution.outcome import ArtifactFile, JobOutcome
from calibration.engine.dataset.model import Dataset
from calibration.engine.estimation.calibrate import calibrate
from calibration.engine.estimation.least_squares.minimisation import Termination, minimise
from calibration.engine.estimation.least_squares.normal_equations import Weighting
from calibration.engine.estimation.start.build import build
from calibration.engine.estimation.start.guesses import StartingNoise, guess_with_patterns, with_starting_noise
from calibration.engine.evaluation.specification import Evaluation, parse_evaluation
from calibration.engine.geometry.transforms import translation
from calibration.pipeline.containers import Software
from calibration.pipeline.matrix.cell_result import Cell, CellResult
from calibration.pipeline.matrix.loaded_system import LoadedSystem
from calibration.pipeline.matrix.software_cell import judged, software_result

NOISE = StartingNoise(0.05, 0.05, 1)
OF_SOFTWARE = ("against-optimum", "moved-frame", "other-dataset", "table")
"""The kinds of findings about software."""
Left = tuple[Dataset | None, str]
"""The calibrated dataset, and the text of the table."""


def rows(quick: bool) -> Iterator[Row]:
    """The share of wrong software that is red, each kind for itself, and of right software that is."""
    found: dict[str, list[bool]] = {name: [] for name in KINDS}
    strata: tuple[Stratum, ...] = ("exact", "good")
    for stratum in strata:
        for system in entries():
            for seed in range(1 if quick else 3):
                loaded = _loaded(stratum, system, seed)
                for name, made in KINDS.items():
                    found[name].append(is_red(verdict(loaded, *made(loaded))))
    for name, red in found.items():
        bar = Bar(high=0.1) if name in RIGHT else Bar(low=99)
        yield Row(f"verdict/software, {name}, red", 100 * float(np.mean(red)), "%", bar, f"{len(red)} cases")


def is_red(result: CellResult) -> bool:
    """Whether something speaks against what the software has left; the catalogue measures what speaks against data."""
    of_data = {finding.text for finding in result.findings if finding.kind not in OF_SOFTWARE}
    return bool(set(result.reasons) - of_data)


def verdict(system: LoadedSystem, calibrated: Dataset | None, table: str) -> CellResult:
    """The verdict on what software has left."""
    cell = Cell(system.name, NOISE)
    with tempfile.TemporaryDirectory() as temporary:
        output, files = Path(temporary), Path(temporary, "cell", "artifacts")
        files.mkdir(parents=True)
        (files / "table.csv").write_text(table)
        outcome = JobOutcome("cell", output / "cell", artifacts=(ArtifactFile("table.csv", "calibration", 1, ""),))
        result = software_result(cell, system, Software(), outcome, output)
        if calibrated is None:
            return result
        left = replace(result, reasons=())  # a scene in memory has no document that could be written and read
        return judged(left, calibrated, cell, system, Path("cell"), output)


def _loaded(stratum: Stratum, name: str, seed: int) -> LoadedSystem:
    evaluation = parse_evaluation(text) if (text := entries()[name].evaluate) else None
    return LoadedSystem(name, clean(stratum, name, seed).told, None, evaluation, entries()[name].options)


def _table(system: LoadedSystem, dataset: Dataset) -> str:
    evaluation: Evaluation | None = system.evaluation
    assert evaluation is not None, f"{system.name} has no table"
    return evaluation.run(dataset).to_csv()


def _whole(made: Callable[[LoadedSystem], Dataset], system: LoadedSystem) -> Left:
    """A dataset with its own table."""
    dataset = made(system)
    return dataset, _table(system, dataset)


def _optimum(system: LoadedSystem) -> Dataset:
    return system.optimum.calibration.dataset


def _plain(system: LoadedSystem) -> Dataset:
    return calibrate(system.dataset, replace(system.options, loss="linear")).dataset


def _start(system: LoadedSystem) -> Dataset:
    return with_starting_noise(system.dataset, NOISE)


def _stopped(system: LoadedSystem) -> Dataset:
    """After one step from the start."""
    dataset, options = _start(system), system.options
    setup = build(dataset, options.hold)
    weighting = Weighting(system.optimum.calibration.noise_levels.given(), None)
    start = guess_with_patterns(setup)
    values = minimise(setup.problem, start, weighting, Termination(iterations=1)).values
    return dataset.with_transforms({s.edge: values[setup.block(s.edge)] for s in dataset.sensors.values()})


def _off(millimetres: float, system: LoadedSystem) -> Dataset:
    dataset = _optimum(system)
    sensor = [each for each in dataset.sensors.values() if each.name != dataset.anchored][-1]
    moved = dataset.transforms[sensor.edge] @ translation(np.array([millimetres / 1e3, 0.0, 0.0]))
    return dataset.with_transforms({sensor.edge: moved})


def _zeros(system: LoadedSystem) -> Left:
    header, *lines = _table(system, _optimum(system)).splitlines()
    cells = len(header.split(",")) - 1
    zeros = (",".join([line.split(",")[0], *["0.0000"] * cells]) for line in lines)
    return _optimum(system), "\n".join([header, *zeros]) + "\n"


RIGHT = ("our optimum", "plain least squares")
KINDS: Mapping[str, Callable[[LoadedSystem], Left]] = {
    "our optimum": partial(_whole, _optimum),
    "plain least squares": partial(_whole, _plain),
    "its start returned": partial(_whole, _start),
    "stopped after one step": partial(_whole, _stopped),
    "off by 2 mm": partial(_whole, partial(_off, 2.0)),
    "a table of zeros": _zeros,
    "a good table, a wrong dataset": lambda system: (_off(20.0, system), _table(system, _optimum(system))),
    "a good table alone": lambda system: (None, _table(system, _optimum(system))),
}
