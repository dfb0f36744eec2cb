"""Messages about a pipeline's results: the verdict in one line, reasons, findings, notes."""

from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path

from calibration.ci.report import count_of
from calibration.engine.baseline.quality import QUALITY
from calibration.engine.baseline.settings import SameData
from calibration.engine.baseline.verdict import MOVED, exceeds
from calibration.engine.diagnosis.finding import Severity
from calibration.pipeline.matrix.cell import REPROJECTION
from calibration.pipeline.matrix.cell_result import CellResult
from calibration.pipeline.results import ImageResult, Results

NOT_CONVERGED = "it has not converged"


def verdict_sentence(results: Results) -> str:
    """Return the verdict in one line."""
    done, failed = [], []
    for things, what, verb in ((results.cells, "cell", "calibrated"), (results.collections, "dataset", "collected")):
        verdicts = Counter(thing.verdict for thing in things)
        count = count_of(len(things), what)
        nothing = not results.judged and results.image is None and not results.of_stages.all
        counted = [(verdicts["fail"], "failed")] if verdicts["fail"] or (what == "cell" and nothing) else []
        counted += [(verdicts["undecided"], "undecided")] if verdicts["undecided"] else []
        if counted:
            (number, word), *more = counted
            failed += [f"{number} of {count} {word}", *(f"{number} {word}" for number, word in more)]
        elif things:
            done.append(f"{count} {verb}")
    if results.image is not None and not results.judged:
        done.append("the image is built" if results.image.built else "the image is there")
    done += [each.sentence for each in results.of_stages.all]
    return ", ".join((*failed, *done))


def failures(results: Results) -> list[str]:
    """Return the reasons of everything that failed, a line each, worst first."""
    collected = [f"collected {each.name}: {reason}" for each in results.collections for reason in each.reasons]
    return failures_of_cells(results, results.systems) + collected


def failures_of_cells(results: Results, systems: Collection[str]) -> list[str]:
    """Return the reasons of the cells of some systems that failed, a line each, worst first.

    Equal reasons of several cells of a system are merged into one line; cells are named if there are several in all.
    """
    references = {cell.start_of_cell: cell for cell in results.comparisons if not cell.by_other_method}
    lines = {
        # Whose fault it is follows the first reason: GitHub shows nine annotations of a step.
        cell.name: (*cell.reasons[:1], *_whose_fault(cell, references.get(cell.start_of_cell)), *cell.reasons[1:])
        or (NOT_CONVERGED,)
        for cell in results.cells
        if cell.verdict == "fail" and cell.system in systems
    }
    return _lines_of_cells(results.cells, lines)


def undecided_limits(results: Results, systems: Collection[str]) -> list[str]:
    """Return a line for every undecided limit of the cells of some systems, likewise."""
    lines = {
        cell.name: [f"undecided: {why}" for why in cell.undecided] for cell in results.cells if cell.system in systems
    }
    return _lines_of_cells(results.cells, lines)


def _lines_of_cells(cells: Sequence[CellResult], lines: Mapping[str, Sequence[str]]) -> list[str]:
    """Return the lines of cells, given by the cells' names, each once; of several cells with their names in front."""
    alike: dict[tuple[str, str], list[CellResult]] = {}
    for cell in cells:
        for line in dict.fromkeys(lines.get(cell.name, ())):
            alike.setdefault((cell.system, line), []).append(cell)
    if len(cells) == 1:
        return [line for _, line in alike]
    starts = Counter(cell.system for cell in cells)
    return [f"{_names(each, starts[system])}: {line}" for (system, line), each in alike.items()]


def _names(alike: Sequence[CellResult], starts: int) -> str:
    """Describe the cells of a system that have a line in common."""
    first, more = alike[0], len(alike) - 1
    if starts == 1:
        return first.system
    if len(alike) == starts:
        return f"{first.system}, all {starts} starts"
    return first.name if more == 0 else f"{first.name}, and {count_of(more, 'more start')}"


def _whose_fault(cell: CellResult, reference: CellResult | None) -> tuple[str, ...]:
    """Describe our engine's result, on the same data and initial guess, for a failed cell of the team's software."""
    if reference is None or cell.error is not None:  # a failure of the container engine is not the software's fault
        return ()
    if reference.verdict != "fail":
        rms = "" if reference.rms_px is None else f" ({reference.rms_px:.4f} px)"
        return (f"our engine passes on the same data from the same start{rms}: look at the software",)
    why = next(iter(reference.reasons), NOT_CONVERGED)
    return (f"our engine fails on the same data too ({why}): look at the data",)


def findings_of(results: Results, severity: Severity) -> tuple[str, ...]:
    """Return the findings of one severity, once per system, with the system in front if there are several."""
    several = len({cell.system for cell in results.cells}) > 1
    texts = (
        f"{cell.system}: {found.text}" if several else found.text
        for cell in results.cells
        for found in cell.uncontradicted_findings
        if found.severity == severity
    )
    return tuple(dict.fromkeys(texts))


def cells_without_table(results: Results) -> str:
    """Describe the RMS of cells without a table."""
    names = [
        cell.system
        for cell in results.cells
        if cell.table and Path(cell.table).name == REPROJECTION and not (cell.details and cell.details.of_cameras_alone)
    ]
    if not names:
        return ""
    which = f"RMS of {', '.join(dict.fromkeys(names))}: of all corners against where the calibration puts them"
    return f"{which}; a table between two sensors is another number: evaluate: rgb-to-rgb:SOURCE:TARGET"


def baseline_line(results: Results) -> str:
    """Describe the systems compared with the baseline, and remarks on it."""
    update = results.baseline
    if update is None:
        return ""
    compared = "Nothing has changed since" if _unchanged(results) else "Compared with"
    parts = [f"{compared} {update.since}: {', '.join(update.compared)}"] if update.compared else []
    if update.not_accepted:
        none = "no calibration accepted yet of" if parts else "No calibration accepted yet of"
        parts.append(f"{none} {', '.join(update.not_accepted)}: calibration accept")
    parts += [update.problem] if update.problem and not update.reasons else []
    if update.unused:
        parts.append(f"{update.file} has systems that are calibrated no more: {', '.join(update.unused)}")
    return "; ".join(parts)


def _unchanged(results: Results) -> bool:
    """Whether every calibration equals the accepted one within the tolerances of a result on the same data."""
    compared = results.baseline.compared if results.baseline else ()
    cells = [cell for cell in results.cells if cell.system in compared]
    return bool(cells) and all(_equals_accepted(cell) for cell in cells)


def _equals_accepted(cell: CellResult) -> bool:
    changes = cell.details.changes if cell.details else ()
    differs = any(each.kind in ("added", "removed") or exceeds(each, SameData()) for each in changes)
    return bool(changes) and not differs and not any(each.kind in (MOVED, QUALITY) for each in cell.findings)


def without_result(results: Results) -> list[str]:
    """Return the reasons why other methods have no result, once for all cells; without our engine as a reference."""
    return list(
        dict.fromkeys(
            f"{cell.system}, {cell.method}: {'; '.join(cell.reasons)}"
            for cell in results.comparisons
            if cell.reasons and cell.by_other_method
        )
    )


def other_methods(results: Results) -> list[str]:
    """Return the implementation used by each of the other methods, and the data if there is a choice."""
    found: dict[str, dict[str, None]] = {}
    for cell in results.comparisons:
        if cell.detail is not None:
            found.setdefault(f"{cell.system}: {cell.detail}", {})[cell.method] = None
    return [f"{', '.join(methods)} on {detail}" for detail, methods in found.items()]


def image_line(image: ImageResult) -> str:
    """Describe the actions on the image."""
    what = f"built in {image.seconds:.0f} s" if image.built else "unchanged, nothing was built"
    promoted = f"; promoted to {', '.join(image.promoted)}" if image.promoted else ""
    return f"Image {image.reference}: {what}{promoted}"


def export_lines(results: Results, output: Path) -> Iterator[str]:
    """Yield the files of each export, and notes on them."""
    for each in results.exports:
        if each.files:
            yield f"{output / each.folder}: {', '.join(each.files)}"
        yield from (f"{each.system}: {note}" for note in each.notes)
