"""``python -m benchmarks.speed_table REPORT README``: write the speed table of the README from a report of `peers`.

The report is that of ``python -m benchmarks --only peers --json REPORT``.
"""

import json
import re
import sys
from pathlib import Path

from benchmarks.peers import COLLECTIONS

BEGIN, END = "<!-- speed -->", "<!-- /speed -->"
OURS = {"least squares": "least squares, here", "whole calibration": "whole calibration, here: checks to error bars"}
PEERS = {
    "ceres": "least squares by ceres 2.1 (C++, a block per view)",
    "mrcal": "by mrcal 2.2 (C)",
    "pyceres": "by pyceres 2.6 (Python, analytic derivatives)",
    "gtsam": "by gtsam 4.3 (C++, a factor per view, its derivatives from Python)",
    "scipy": "by scipy (trf, sparse 2-point differences, vectorised)",
}


def main(report: str, readme: str) -> None:
    """Replace what is between the marks of a document."""
    values = {row["name"]: row["value"] for row in json.loads(Path(report).read_text())["rows"]}
    path = Path(readme)
    text, count = re.subn(
        f"{BEGIN}.*?{END}", lambda _: f"{BEGIN}\n{table(values)}\n{END}", path.read_text(), flags=re.S
    )
    if count != 1:
        sys.exit(f"{path}: {BEGIN} and {END} were expected once")
    path.write_text(text)


def table(values: dict[str, float | None]) -> str:
    """Return the table, of times in ms; a peer's from the ratio of ours to its own, measured side by side."""
    head = "| 2 cameras, collections | " + " | ".join(map(str, COLLECTIONS)) + " |"
    lines = [head, "| --- |" + " --- |" * len(COLLECTIONS)]
    for name, words in (OURS | PEERS).items():
        lines.append(f"| {words} | " + " | ".join(_cell(values, name, n) for n in COLLECTIONS) + " |")
    return "\n".join(lines)


def _cell(values: dict[str, float | None], name: str, collections: int) -> str:
    value = values.get(f"peers/{name}, 2 x {collections}")
    ours = values.get(f"peers/least squares, 2 x {collections}")
    if not value or not ours:
        return "-"
    return f"{_short(value)} ms" if name in OURS else f"{_short(ours / value)} ms ({_short(1 / value)} x)"


def _short(value: float) -> str:
    """Two digits: 0.98, 1.1, 63, 3700."""
    return f"{float(f'{value:.2g}'):g}"


if __name__ == "__main__":
    main(*sys.argv[1:])
