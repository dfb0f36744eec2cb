"""The maps as tables: translation noise down, rotation noise across."""

from calibration.introspection.numbers import number_text
from calibration.pipeline.convergence.convergence_map import ConvergenceMap
from calibration.pipeline.convergence.results import ConvergenceResults
from calibration.pipeline.matrix.cell import noise_text
from calibration.pipeline.summary import Grid
from calibration.workflow.summary import escape_markdown, markdown_table

LOST_SHOWN = 10
"""Maps of which a start that does not converge is named."""


def map_grid(of: ConvergenceMap) -> Grid:
    """The share in percent of each pair."""
    rows = [
        (f"{number_text(t)} m", *(of.pairs[t, r].percent for r in of.rotations))  # in the form of the noise pairs
        for t in of.translations
    ]
    return Grid(("", *(f"{number_text(r)} rad" for r in of.rotations)), tuple(rows))


def largest_grid(results: ConvergenceResults) -> Grid:
    """Up to which noise every start converges, a row for each map."""

    def shown(value: float | None, unit: str) -> str:
        return "none" if value is None else f"{number_text(value)} {unit}"

    rows = [
        (
            each.name if each.judged else f"{each.name} (to compare)",
            shown(each.largest.translation, "m"),
            shown(each.largest.rotation, "rad"),
            noise_text(*each.largest.diagonal) if each.largest.diagonal else "none",
        )
        for each in results.maps
    ]
    return Grid(("Every start converges up to", "Translation alone", "Rotation alone", "Both, up to"), tuple(rows))


def sentence(results: ConvergenceResults) -> str:
    """The verdict in one line."""
    if results.largest_diagonal is None:
        return f"{results.verdict}: the start without noise does not converge"
    translation, rotation = results.largest_translation or 0.0, results.largest_rotation or 0.0
    return (
        f"{results.verdict}: every start converges up to {number_text(translation)} m alone, "
        f"{number_text(rotation)} rad alone, and {noise_text(*results.largest_diagonal)} together"
    )


def first_lost(of: ConvergenceMap) -> str:
    """A start that does not converge, of those with the least noise, and how to look at it; empty where all do."""
    for (t, r), pair in of.pairs.items():
        if pair.lost:
            options = f"--translation-noise {number_text(t)} --rotation-noise {number_text(r)}"
            how = f"calibrate-matrix {options} --seed-list {pair.lost[0]} --start {of.start}"
            return f"{of.name}, {noise_text(t, r)}, seed {pair.lost[0]}: {pair.reason} (to look at it: {how})"
    return ""


def markdown(results: ConvergenceResults) -> str:
    """The verdict, why it is fail, up to where all converges, and the maps."""
    seeds = len(results.noise.seeds)
    table = largest_grid(results)
    lines = [f"## Convergence: {escape_markdown(sentence(results))}", ""]
    lines += [f"- {escape_markdown(reason)}" for reason in results.reasons]
    lines += ["", markdown_table(table.header, table.rows)]
    for each in results.maps:
        grid = map_grid(each)
        lines += [f"### {escape_markdown(each.name)}", "", markdown_table(grid.header, grid.rows)]
    lines += [f"Starts that converge, in percent of {seeds} for each pair of noises.", ""]
    lost = [line for each in results.maps if (line := first_lost(each))]
    if lost:
        lines += ["### Starts that do not converge", ""]
        lines += [f"- {escape_markdown(line)}" for line in lost[:LOST_SHOWN]]
        lines += ["", "One for each map; results.json has all of them.", ""]
    lines += [f"{escape_markdown(note)}." for note in results.notes]
    return "\n".join(lines)
