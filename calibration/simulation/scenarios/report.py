"""What many worlds say together: how the error is distributed, which worlds are worst, what drives the error."""

import csv
import io
import math
import re
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any

from calibration.simulation.scenarios.drivers import LEAST_WORLDS, SIGNIFICANT, Driver, find_drivers
from calibration.simulation.scenarios.result import ScenarioResult
from calibration.workflow.summary import code_block, escape_markdown, markdown_table

PERCENTILES = (0, 5, 25, 50, 75, 95, 100)
_NAMES = {0: "least", 50: "median", 100: "worst"}
_MEASURES = {
    "translation_mm": "Translation error (mm)",
    "rotation_deg": "Rotation error (deg)",
    "joint_mm": "Joint error (mm)",
    "joint_deg": "Joint error (deg)",
    "rms_px": "RMS of the reprojection (px)",
    "corner_rms_px": "Corners against the truth (px)",
}
DRIVERS_SHOWN = 8
REASONS_SHOWN = 20
_NUMBER = re.compile(r"\d+(\.\d+)?")

Replay = Callable[[str], str]
"""The command that replays the world of an id."""


@dataclass(frozen=True)
class Report:
    """The results of many worlds of one system; at least one."""

    results: Sequence[ScenarioResult]
    lost: Collection[str] = ()
    """The ids of those that could not be run: nothing about their worlds is to blame."""

    @cached_property
    def calibrated(self) -> list[ScenarioResult]:
        """The worlds that gave a calibration."""
        return [result for result in self.results if result.converged]

    @cached_property
    def drivers(self) -> list[Driver]:
        """What goes with the translation error, the strongest first. A world without a calibration is the worst."""
        return find_drivers([result.values for result in self.ran], [_error(result) for result in self.ran])

    @property
    def ran(self) -> list[ScenarioResult]:
        """The worlds that say something: without those that could not be run."""
        return [result for result in self.results if result.id not in self.lost]

    def worst(self, count: int) -> list[ScenarioResult]:
        """The worlds without a calibration, then those with the largest translation error."""
        return sorted(self.results, key=lambda result: (-_error(result), result.id))[:count]

    def percentiles(self, measure: str) -> dict[int, float]:
        """`PERCENTILES` of a measure over the worlds that have it: each the value of one of them (nearest rank)."""
        values = sorted(value for result in self.calibrated if (value := getattr(result, measure)) is not None)
        if not values:
            return {}
        return {p: values[max(math.ceil(p / 100 * len(values)), 1) - 1] for p in PERCENTILES}


def _error(result: ScenarioResult) -> float:
    """What the worlds are ordered by: the translation error, infinite where there is none."""
    return result.translation_mm if result.converged and result.translation_mm is not None else math.inf


def markdown(report: Report, title: str, replay: Replay, worst: int = 5) -> str:
    """The report for people.

    Args:
        report: the results.
        title: of the section, such as "100 worlds of t2rgb".
        replay: the command for an id.
        worst: how many worlds are named.
    """
    return "\n".join(
        [
            f"## {escape_markdown(title)}",
            "",
            _sentence(report),
            "",
            *_distribution(report),
            *_worst(report, worst, replay),
            *_drivers(report.drivers, len(report.ran)),
            *_losses(report),
        ]
    )


def _sentence(report: Report) -> str:
    total, calibrated = len(report.results), len(report.calibrated)
    poses, kept = (sum(getattr(result, what) for result in report.results) for what in ("poses", "kept"))
    worlds = "1 world" if total == 1 else f"{total} worlds"
    return f"{calibrated} of {worlds} calibrate; {kept} of {poses} poses gave a collection."


def _distribution(report: Report) -> list[str]:
    rows = [
        [name, *(f"{value:.3g}" for value in found.values())]
        for measure, name in _MEASURES.items()
        if (found := report.percentiles(measure))
    ]
    if not rows:
        return []
    header = ["", *(_NAMES.get(p, f"{p} %") for p in PERCENTILES)]
    return [markdown_table(header, rows), "Over the worlds that calibrate; errors are those of the worst sensor.", ""]


def _worst(report: Report, count: int, replay: Replay) -> list[str]:
    results = report.worst(count)
    rows = [
        [
            result.id,
            _shown(result.translation_mm, ".3g"),
            _shown(result.rotation_deg, ".2g"),
            _shown(result.sigma_mm, ".3g"),
            f"{result.kept}/{result.poses}",
            "; ".join(result.reasons) or "calibrates",
        ]
        for result in results
    ]
    header = ["World", "Error (mm)", "Error (deg)", "Stated sigma (mm)", "Collections", "Outcome"]
    first = report.results[0].values
    names = [name for name in first if any(result.values[name] != first[name] for result in report.results)]
    values = [[name, *(f"{result.values[name]:g}" for result in results)] for name in names]
    commands = "\n".join(replay(result.id) for result in results)
    return [
        "### Worst worlds",
        "",
        markdown_table(header, rows),
        "<details><summary>Their parameters, and how to replay them</summary>",
        "",
        *([markdown_table(["Parameter", *(result.id for result in results)], values)] if names else []),
        code_block(commands),
        "</details>",
        "",
    ]


def _drivers(drivers: Sequence[Driver], worlds: int) -> list[str]:
    strong = [driver for driver in drivers if driver.stands_out]
    if not drivers:
        text = f"Not known: {why_unknown(worlds)}."
    elif not strong:
        first = drivers[0]
        text = (
            f"None of the parameters that vary ({len(drivers)}) stands out. The strongest is "
            f"{escape_markdown(first.parameter)}, rank correlation {first.correlation:+.2f}: chance gives as much with "
            f"probability {first.p:.2g}."
        )
    else:
        rows = [[d.parameter, f"{d.correlation:+.2f}", f"{d.p:.2g}"] for d in strong[:DRIVERS_SHOWN]]
        found = markdown_table(["Parameter", "Rank correlation with the translation error", "p"], rows)
        text = (
            f"{found}\nSpearman's; p (below {SIGNIFICANT:g} here) is the probability that chance gives as much with "
            f"any of the {len(drivers)} parameters. Between bars: a parameter's magnitude. A world without a "
            "calibration counts as the worst."
        )
    return ["### What drives the error", "", text, ""]


def why_unknown(worlds: int) -> str:
    """Why nothing is known of drivers."""
    return f"it takes {LEAST_WORLDS} worlds" if worlds < LEAST_WORLDS else "nothing varies"


def _losses(report: Report) -> list[str]:
    """Why poses were lost, over all worlds, the most frequent reasons first; numbers in them do not tell them apart."""
    lost = [reason for result in report.results for reasons in (result.lost or {}).values() for reason in reasons]
    examples: dict[str, str] = {}
    counts = Counter(_NUMBER.sub("#", reason) for reason in lost)
    for reason in lost:
        examples.setdefault(_NUMBER.sub("#", reason), reason)
    if not lost:
        return []
    listed = sorted(counts.items(), key=lambda item: (-item[1], item[0]))
    lines = [f"- {count}: {escape_markdown(examples[kind])}" for kind, count in listed[:REASONS_SHOWN]]
    if len(listed) > REASONS_SHOWN:
        lines.append(f"- and {len(listed) - REASONS_SHOWN} other reasons")
    return ["### Why poses were lost", "", *lines, "", "One example each; the numbers differ.", ""]


def _shown(value: float | None, form: str) -> str:
    return "-" if value is None else format(value, form)


def table(results: Sequence[ScenarioResult]) -> str:
    r"""The results as CSV, a row for each world; lines end in ``\n``, what is not there is empty."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    for number, row in enumerate(map(_row, results)):
        if number == 0:
            writer.writerow(row)
        writer.writerow(row.values())
    return text.getvalue()


def _row(result: ScenarioResult) -> dict[str, object]:
    measures = (
        "corner_rms_px",
        "rms_px",
        "translation_mm",
        "rotation_deg",
        "joint_mm",
        "joint_deg",
        "sigma_mm",
        "sigma_deg",
    )
    return {
        "id": result.id,
        "hash": result.hash,
        "converged": int(result.converged),
        "poses": result.poses,
        "kept": result.kept,
        "detection_rate": min((result.detection or {}).values(), default=0.0),
        **{measure: getattr(result, measure) for measure in measures},
        **result.values,
        "reasons": "; ".join(result.reasons),
    }


def document(report: Report, worst: int = 5) -> dict[str, Any]:
    """The report for ``results.json``."""
    return {
        "worlds": len(report.results),
        "calibrated": len(report.calibrated),
        "percentiles": {
            measure: {str(p): value for p, value in report.percentiles(measure).items()} for measure in _MEASURES
        },
        "worst": [result.id for result in report.worst(worst)],
        "drivers": [{**asdict(driver), "stands_out": driver.stands_out} for driver in report.drivers],
        "scenarios": list(_documents(report.results)),
    }


def _documents(results: Sequence[ScenarioResult]) -> Iterator[dict[str, Any]]:
    for result in results:
        yield {**asdict(result), "kept": result.kept}
