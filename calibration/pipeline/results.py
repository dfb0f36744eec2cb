"""``results.json`` and what else a pipeline leaves: a table of cells, JUnit, a summary."""

import csv
import io
import json
import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from calibration.errors import ExitCode, InputError, WorldError, exit_code_of
from calibration.estimation.intrinsics_file import FILE_NAME as INTRINSICS
from calibration.files import write_atomically
from calibration.json_file import parse_json
from calibration.pipeline.collection.collected import Collected
from calibration.pipeline.image_result import ImageResult
from calibration.pipeline.matrix.cell import OUR_METHOD, CellResult, Deviation, Verdict
from calibration.report import Outcome

SCHEMA = Path(__file__).with_name("results.schema.json")
FILE = "results.json"
_PLAIN = (
    *("system", "translation_noise", "rotation_noise", "seed", "method", "start", "loss"),
    *("converged", "rms_px", "table", "dataset", "seconds", "detail"),
)
"""The fields of a cell that stand in the file as they are."""


@dataclass(frozen=True)
class Results:
    """The cells of a matrix, the other methods on the same data, and what was collected in simulation."""

    cells: tuple[CellResult, ...]
    comparisons: tuple[CellResult, ...] = ()
    collections: tuple[Collected, ...] = ()
    image: ImageResult | None = None
    """The image that was built for the cells and collections that run in containers."""

    @property
    def judged(self) -> tuple[CellResult | Collected, ...]:
        """What has a part in the verdict."""
        return (*self.cells, *self.collections)

    @property
    def verdict(self) -> Verdict:
        """Pass when every cell and every collection passed, and there is one; or where only an image was built."""
        if not self.judged and self.image is None:
            return "fail"
        return "pass" if all(each.verdict == "pass" for each in self.judged) else "fail"

    @property
    def exit_code(self) -> ExitCode:
        """2 or 3 where something could not be done because of bad input or a failing world, else the verdict's."""
        return exit_code_of(self.verdict == "pass", (each.error for each in self.judged))

    @property
    def systems(self) -> tuple[str, ...]:
        """The systems, in order."""
        return tuple(dict.fromkeys(cell.system for cell in (*self.cells, *self.comparisons)))


def write_results(results: Results, output: Path, more: Mapping[str, Any] | None = None) -> None:
    """Write ``results.json``, ``cells.csv`` and ``junit.xml`` into the output folder, and each cell's own results.

    Args:
        results: what to write.
        output: the folder.
        more: further entries of ``results.json``.

    Raises:
        WorldError: a file cannot be written.
    """
    write_atomically(output / FILE, _json({**_document(results), **(more or {})}))
    write_atomically(output / "cells.csv", cells_csv(results))
    write_atomically(output / "junit.xml", _junit(results))
    for cell in (*results.cells, *results.comparisons):
        if cell.dataset is not None and cell.details:
            alone = _document(Results((cell,)))
            alone["cells"][0].update(cell.details)
            write_atomically((output / cell.dataset).with_name(FILE), _json(alone))


def clear_results(output: Path, inputs: Collection[Path] = ()) -> None:
    """Remove what an earlier matrix left in the output folder, so that none of it passes for this one's.

    Only files that `write_results` and the cells make; images and point clouds stay.

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
        earlier = Results(())
    everything = (*earlier.cells, *earlier.comparisons)
    named = [path for cell in everything for path in (cell.table, cell.dataset) if path]
    own = [str(Path(cell.dataset).with_name(FILE)) for cell in everything if cell.dataset and cell.details]
    own += [str(Path(cell.dataset).with_name(INTRINSICS)) for cell in everything if cell.dataset and cell.details]
    paths = [output / name for name in (FILE, "cells.csv", "junit.xml", "summary.md", *named, *own)]
    inside = [path for path in paths if path.resolve().is_relative_to(output.resolve())]
    needed = {path.resolve() for path in inputs}
    for path in inside:
        if path.resolve() in needed:
            raise InputError(f"{path}: this input is an earlier result in the output folder; choose another output")
    for path in inside:
        try:
            path.unlink(missing_ok=True)
        except OSError as error:
            raise WorldError(f"{path}: an earlier result cannot be removed: {error.strerror}") from error


def read_results(output: Path) -> Results:
    """Read what `write_results` wrote, without the verdicts of cells: they are to be made again.

    Raises:
        InputError: there are no results, or they are not of this form.
    """
    path = output / FILE
    try:
        document = parse_json(path.read_bytes(), finite=False)
        return Results(
            tuple(_cell(entry, output) for entry in document["cells"]),
            tuple(_cell(entry, output) for entry in document["comparisons"]),
            tuple(Collected.of_document(entry) for entry in document["collections"]),
            ImageResult.of_document(document["image"]) if document["image"] else None,
        )
    except OSError as error:
        raise InputError(f"{path}: the results of the stage calibrate were expected here: {error.strerror}") from None
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise InputError(f"{path}: this is not a results file of calibrate-matrix: {error!r}") from None


def summarise(results: Results) -> dict[str, Any]:
    """The numbers over all cells, and system by system."""
    return {
        **_numbers(results.cells),
        "systems": {s: _numbers([c for c in results.cells if c.system == s]) for s in results.systems},
    }


def cells_csv(results: Results) -> str:
    """One row for each cell and comparison: for introspect-csv, a spreadsheet or a plot."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    header = (
        "Cell",
        "System",
        "Method",
        "Translation noise (m)",
        "Rotation noise (rad)",
        "Seed",
        "Verdict",
        "RMS (pix)",
    )
    writer.writerow([*header, "Trans error (mm)", "Rot error (deg)"])
    for cell in (*results.cells, *results.comparisons):
        truth = (f"{cell.truth.translation_mm:.4f}", f"{cell.truth.rotation_deg:.5f}") if cell.truth else ("", "")
        rms = "" if cell.rms_px is None else f"{cell.rms_px:.4f}"
        noise = ["" if v is None else f"{v:g}" for v in (cell.translation_noise, cell.rotation_noise, cell.seed)]
        verdict = "" if cell.by_other_method else cell.verdict
        writer.writerow([cell.name, cell.system, cell.method, *noise, verdict, rms, *truth])
    return text.getvalue()


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


def _document(results: Results) -> dict[str, Any]:
    return {
        "schema": 1,
        "verdict": results.verdict,
        "cells": [_object(cell) for cell in results.cells],
        "comparisons": [_object(cell) for cell in results.comparisons],
        "collections": [collected.document for collected in results.collections],
        "image": results.image.document if results.image else None,
        "summary": summarise(results),
    }


def _object(cell: CellResult) -> dict[str, Any]:
    return {
        **{name: getattr(cell, name) for name in _PLAIN},
        "verdict": cell.verdict,
        "truth": cell.truth.document if cell.truth else None,
        "sigma": cell.sigma.document if cell.sigma else None,
        "reasons": list(cell.reasons),
        "error": cell.error,
        "warnings": list(cell.warnings),
    }


def _cell(entry: Mapping[str, Any], output: Path) -> CellResult:
    error = entry["error"]
    return CellResult(
        **{name: entry[name] for name in _PLAIN},
        truth=Deviation(**entry["truth"]) if entry["truth"] else None,
        sigma=Deviation(**entry["sigma"]) if entry["sigma"] else None,
        reasons=() if entry["converged"] else tuple(entry["reasons"]),
        error=None if error is None else ExitCode(error),
        warnings=tuple(entry["warnings"]),
        details=_details(entry, output),
    )


def _details(entry: Mapping[str, Any], output: Path) -> dict[str, Any]:
    """What a cell's own results say beyond the common fields."""
    if entry["method"] != OUR_METHOD or entry["translation_noise"] is None or entry["dataset"] is None:
        return {}
    own = json.loads((output / entry["dataset"]).with_name(FILE).read_bytes())["cells"][0]
    return {key: value for key, value in own.items() if key not in entry}


def _json(document: Mapping[str, Any]) -> str:
    return json.dumps(document, indent=1, allow_nan=False, default=_not_finite) + "\n"


def _not_finite(value: object) -> object:
    raise TypeError(f"{value!r} does not belong into results")


def _junit(results: Results) -> str:
    from calibration.report.junit import junit_xml  # XML is slow to import

    def outcome(group: str, each: CellResult | Collected) -> Outcome:
        return Outcome(name=each.name, group=group, reasons=each.reasons, error=each.error, seconds=each.seconds)

    suites = {s: [outcome(s, cell) for cell in results.cells if cell.system == s] for s in results.systems}
    if results.collections:
        suites["collected"] = [outcome("collected", collected) for collected in results.collections]
    return junit_xml(suites)
