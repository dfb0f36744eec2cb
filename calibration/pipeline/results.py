"""Results of a pipeline: cells, comparisons, collections, the image; and the file that keeps them between stages."""

import math
from collections.abc import Collection, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from calibration.errors import ExitCode, InputError, exit_code_of
from calibration.estimation.intrinsics_file import FILE_NAME as INTRINSICS
from calibration.files import read_bytes
from calibration.json_file import parse_json
from calibration.pipeline.collection.collected import Collected
from calibration.pipeline.matrix.cell import OUR_METHOD, CellResult
from calibration.records import document_of, field, read, record
from calibration.report import FILES, MOST_BYTES, RESULTS_FILE, SCHEMA_NUMBER, Verdict, remove_results, verdict_of

SCHEMA = Path(__file__).with_name("results.schema.json")
CELLS_FILE = "cells.csv"


@record(case="snake", nulls=True, unknown="ignore")
class ImageResult:
    """What the stages build and promote did."""

    reference: str = field("What the containers were made from.")
    key: str = field("The content key, a hash of everything that goes into the image.")
    built: bool = field("False if it was found, and nothing was built.")
    digest: str | None = field("In the registry; None if it was not pushed.", default=None)
    seconds: float = field(default=0.0)
    promoted: tuple[str, ...] = field("The tags that it got because the verdict was pass.", default=())


@record(case="snake", nulls=True, unknown="ignore")
class Results:
    """The cells of a matrix, the other methods on the same data, and what was collected in simulation."""

    cells: tuple[CellResult, ...] = field(default=())
    comparisons: tuple[CellResult, ...] = field("They have no part in the verdict.", default=())
    collections: tuple[Collected, ...] = field(default=())
    image: ImageResult | None = field("The image that was built for cells and collections.", default=None)

    @property
    def judged(self) -> tuple[CellResult | Collected, ...]:
        """What has a part in the verdict."""
        return (*self.cells, *self.collections)

    @property
    def verdict(self) -> Verdict:
        """Pass if every cell and every collection passed, and there is one; or if only an image was built."""
        return verdict_of(
            bool(self.judged or self.image is not None) and all(each.verdict == "pass" for each in self.judged)
        )

    @property
    def exit_code(self) -> ExitCode:
        """2 or 3 if something could not be done because of bad input or a failing world, else the verdict's."""
        return exit_code_of(self.verdict == "pass", (each.error for each in self.judged))

    @property
    def systems(self) -> tuple[str, ...]:
        """The systems, in order."""
        return tuple(dict.fromkeys(cell.system for cell in (*self.cells, *self.comparisons)))


def entry(result: CellResult | Collected) -> dict[str, Any]:
    """Return the entry of a cell or a collection in ``results.json``."""
    return {**document_of(result), "verdict": result.verdict}


def document(results: Results) -> dict[str, Any]:
    """Return the content of ``results.json``."""
    return {
        "cells": [entry(cell) for cell in results.cells],
        "comparisons": [entry(cell) for cell in results.comparisons],
        "collections": [entry(collected) for collected in results.collections],
        "image": document_of(results.image) if results.image else None,
        "summary": summarise(results),
    }


def read_results(folder: Path) -> Results:
    """Read ``results.json`` in a folder, of this version or an older one.

    Raises:
        InputError: there is none, a value is of another type, or a verdict is not that of its own numbers and reasons.
    """
    path = folder / RESULTS_FILE
    found = _document(path)
    results = read(Results, found, str(path))
    known: list[CellResult | Collected] = [*results.cells, *results.comparisons, *results.collections]
    entries = [*found["cells"], *found.get("comparisons", ()), *found.get("collections", ())]
    for each, written in zip(known, entries, strict=True):
        if each.verdict != (said := written.get("verdict")):
            raise InputError(f"{path}: {each.name}: says {said}, which its own numbers and reasons deny")
    return results


def _document(path: Path) -> dict[str, Any]:
    try:
        document = parse_json(read_bytes(path, MOST_BYTES, "results of calibrate-matrix or run"))
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: this is not a results file: {error}") from None
    if not isinstance(document, dict) or not isinstance(document.get("cells"), list):
        raise InputError(f"{path}: this is not a results file of calibrate-matrix or run: it has no list of cells")
    if (found := document.get("schema", SCHEMA_NUMBER)) != SCHEMA_NUMBER:
        raise InputError(
            f"{path}: schema: found {found!r:.80}, expected {SCHEMA_NUMBER}: another version has written it"
        )
    return document


def without_verdicts(results: Results, output: Path) -> Results:
    """Return results that were read, for their cells to be judged anew, with what the cells' own files say.

    Args:
        results: of `read_results`.
        output: the folder with the files of the cells.

    Raises:
        InputError: a file cannot be read.
    """

    def reset(cell: CellResult) -> CellResult:
        red = tuple(finding.text for finding in cell.findings if finding.severity == "red")
        reasons = red if cell.converged else cell.reasons
        return replace(cell, reasons=reasons, details=_details(cell, output))

    return replace(
        results,
        cells=tuple(map(reset, results.cells)),
        comparisons=tuple(map(reset, results.comparisons)),
    )


def own_file(cell: CellResult) -> str | None:
    """Return the path of a cell's own results, relative to the output folder; None if there are none."""
    if cell.method != OUR_METHOD or cell.translation_noise is None or cell.dataset is None:
        return None
    return str(Path(cell.dataset).with_name(RESULTS_FILE))


def _details(cell: CellResult, output: Path) -> dict[str, Any]:
    """What a cell's own results say beyond the common fields."""
    file = own_file(cell)
    if file is None:
        return {}
    [own] = _document(output / file)["cells"]
    return {key: value for key, value in own.items() if key not in entry(cell)}


def clear_results(output: Path, inputs: Collection[Path] = ()) -> None:
    """Remove what an earlier matrix left in the output folder, so that none of it is mistaken for this one's.

    Images and point clouds stay.

    Args:
        output: the folder.
        inputs: files that are still needed.

    Raises:
        InputError: one of the inputs is among the earlier results.
        WorldError: a file cannot be removed.
    """
    try:
        earlier = read_results(output)
    except InputError:
        earlier = Results()
    names = [*FILES, CELLS_FILE]
    for cell in (*earlier.cells, *earlier.comparisons):
        own = own_file(cell)
        names += [name for name in (cell.table, cell.dataset, own) if name]
        names += [str(Path(own).with_name(INTRINSICS))] if own else []
    inside = [name for name in names if (output / name).resolve().is_relative_to(output.resolve())]
    needed = {path.resolve() for path in inputs}
    for name in inside:
        if (output / name).resolve() in needed:
            raise InputError(
                f"{output / name}: this input is an earlier result in the output folder; choose another output"
            )
    remove_results(output, inside)


def summarise(results: Results) -> dict[str, Any]:
    """Return the numbers over all cells, and system by system."""
    return {
        **_numbers(results.cells),
        "systems": {s: _numbers([c for c in results.cells if c.system == s]) for s in results.systems},
    }


def _numbers(cells: Sequence[CellResult]) -> dict[str, Any]:
    def worst(values: list[float | None]) -> float | None:
        known = [v for v in values if v is not None]
        return max(known) if known and all(math.isfinite(v) for v in known) else None

    passed = sum(cell.verdict == "pass" for cell in cells)
    return {
        "cells": len(cells),
        "passed": passed,
        "converged": sum(cell.converged for cell in cells),
        "success_rate": round(passed / len(cells), 6) if cells else 0.0,
        "worst_rms_px": worst([cell.rms_px for cell in cells]),
        "worst_translation_mm": worst([cell.truth.translation_mm if cell.truth else None for cell in cells]),
        "worst_rotation_deg": worst([cell.truth.rotation_deg if cell.truth else None for cell in cells]),
    }
