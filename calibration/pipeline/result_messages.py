"""Messages about a pipeline's results: the verdict in one line, reasons, findings, notes."""

from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path

from calibration.baseline.quality import QUALITY
from calibration.baseline.settings import SameData
from calibration.baseline.verdict import MOVED, exceeds
from calibration.diagnosis.finding import Severity
from calibration.pipeline.matrix.cell import REPROJECTION
from calibration.pipeline.matrix.cell_result import CellResult
from calibration.pipeline.results import Analysed, ImageResult, Results
from calibration.report import count_of

REASONS_SHOWN = 4


def verdict_sentence(results: Results) -> str:
    """Return the verdict in one line."""
    done, failed = [], []
    for things, what, verb in ((results.cells, "cell", "calibrated"), (results.collections, "dataset", "collected")):
        wrong = sum(thing.verdict == "fail" for thing in things)
        undecided = sum(thing.verdict == "undecided" for thing in things)
        count = count_of(len(things), what)
        nothing = not results.judged and results.image is None and results.analysis is None
        if wrong or (what == "cell" and nothing):
            failed.append(f"{wrong} of {count} failed")
        elif undecided:
            failed.append(f"{undecided} of {count} undecided")
        elif things:
            done.append(f"{count} {verb}")
    if results.image is not None and not results.judged:
        done.append("the image is built" if results.image.built else "the image is there")
    if results.analysis is not None:
        done.append(_analysis_sentence(results.analysis))
    return ", ".join((*failed, *done))


def _analysis_sentence(analysis: Analysed) -> str:
    count = count_of(analysis.findings, "finding")
    return f"{count} in the code" if analysis.new is None else f"{count} in the code, {analysis.new} new"


def failures(results: Results) -> list[str]:
    """Return a line for everything that failed, with its first reasons; results.json has all of them.

    Equal reasons of several cells of a system are merged into one line.
    """
    references = {cell.start_of_cell: cell for cell in results.comparisons if not cell.by_other_method}
    alike: dict[tuple[str, str], list[CellResult]] = {}
    for cell in results.cells:
        if cell.verdict == "fail":
            why = f"{_first(cell.reasons)}{_whose_fault(cell, references.get(cell.start_of_cell))}"
            alike.setdefault((cell.system, why), []).append(cell)
    starts = Counter(cell.system for cell in results.cells)
    cells = [f"{_names(each, starts[system])}: {why}" for (system, why), each in alike.items()]
    return cells + [f"collected {c.name}: {_first(c.reasons)}" for c in results.collections if c.verdict == "fail"]


def undecided_lines(results: Results, *, passes: bool) -> list[str]:
    """Return a line for every undecided limit, once for all cells of a system with the same reason.

    Args:
        results: the results.
        passes: of the cells where an undecided verdict counts as passed, or of the others.
    """
    alike: dict[tuple[str, str], list[CellResult]] = {}
    for cell in results.cells:
        if cell.verdict == "undecided" and cell.undecided_passes is passes:
            for why in cell.undecided:
                alike.setdefault((cell.system, why), []).append(cell)
    starts = Counter(cell.system for cell in results.cells)
    return [f"{_names(cells, starts[system])}: undecided: {why}" for (system, why), cells in alike.items()]


def _names(alike: Sequence[CellResult], starts: int) -> str:
    """Describe cells of a system with the same reasons."""
    first, more = alike[0], len(alike) - 1
    if more == 0:
        return first.name
    if len(alike) == starts:
        return f"{first.system}, all {starts} starts"
    return f"{first.name}, and {count_of(more, 'more start')}"


def _whose_fault(cell: CellResult, reference: CellResult | None) -> str:
    """Describe our engine's result, on the same data and initial guess, for a failed cell of the team's software."""
    if reference is None or cell.error is not None:  # a failure of the container engine is not the software's fault
        return ""
    if reference.verdict != "fail":
        rms = "" if reference.rms_px is None else f" ({reference.rms_px:.4f} px)"
        return f". Our engine passes on the same data from the same start{rms}: look at the software"
    return f". Our engine fails on the same data too ({_first(reference.reasons)}): look at the data"


def _first(reasons: Sequence[str]) -> str:
    more = len(reasons) - REASONS_SHOWN
    return "; ".join(reasons[:REASONS_SHOWN]) + (f"; and {more} more" if more > 0 else "")


def findings_of(results: Results, severity: Severity) -> tuple[str, ...]:
    """Return the findings of one severity, once per system."""
    texts = (f"{c.system}: {found.text}" for c in results.cells for found in c.findings if found.severity == severity)
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
