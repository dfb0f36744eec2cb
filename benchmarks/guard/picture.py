"""``python -m benchmarks.guard.picture``: draw docs/check.svg, the share of planted shifts that are found."""

from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib import pyplot as plt

from benchmarks.guard import planted_shifts

PAGE = Path(__file__).parents[2] / "docs" / "check.svg"
CLIPS = 200
EDGES_PX = (0.05, 0.1, 0.2, 0.3, 0.5, 1, 5, 40)


def main() -> None:
    """Plant shifts, and draw what is found of them."""
    draw([(each.shift_px, each.is_red) for each in planted_shifts(range(CLIPS))])


def draw(found: Sequence[tuple[float, bool]]) -> None:
    """Draw the share that is found of shifts by their size, px, with its standard error (E. Wilson, 1927)."""
    sizes, red = np.array(found, float).T
    mpl.rcParams |= {"svg.hashsalt": "check", "svg.fonttype": "none"}
    figure, axes = plt.subplots(figsize=(7, 3.2))
    for low, high in pairwise(EDGES_PX):
        inside = (sizes >= low) & (sizes < high)
        if number := int(inside.sum()):
            share, at = red[inside].mean(), np.sqrt(low * high)
            centre = (share + 0.5 / number) / (1 + 1 / number)
            error = np.sqrt(share * (1 - share) / number + 0.25 / number**2) / (1 + 1 / number)
            axes.plot([at, at], [100 * (centre - error), 100 * (centre + error)], color="#999")
            axes.plot(at, 100 * share, "o", color="#e8710a")
            axes.annotate(f"of {number}", (at, 4), ha="center", fontsize=8, color="#666")
    axes.axvline(0.5, color="#1a73e8", linewidth=1)
    axes.annotate("0.05 deg", (0.52, 30), color="#1a73e8", fontsize=9)
    axes.set(
        xscale="log",
        xlim=(0.05, 40),
        ylim=(0, 103),
        xlabel="planted shift, px (60 degrees are 640 px)",
        ylabel="found, %",
    )
    axes.set_xticks(EDGES_PX, [f"{edge:g}" for edge in EDGES_PX])
    axes.minorticks_off()
    figure.tight_layout()
    figure.savefig(PAGE, metadata={"Date": None})
    plt.close(figure)


if __name__ == "__main__":
    main()
