"""Reports of ``import-data`` and ``label``."""

from collections.abc import Mapping
from pathlib import Path

from calibration.ci.report import Outcome, Report, Table, count_of
from calibration.robot.importing.results import ImportResults, LabelResults

IMPORT_TITLE, LABEL_TITLE = "import-data", "label"


def report(results: ImportResults, folder: Path) -> Report:
    """Return the report of ``import-data``."""
    found: Mapping[str, int] = {name: each.labelled for name, each in results.sensors.items()}
    estimated = {name: each.lens for name, each in results.sensors.items() if each.intrinsics == "estimated"}
    rejected = tuple((name, view.file, view.reason) for name, each in results.sensors.items() for view in each.rejected)
    return Report(
        title=IMPORT_TITLE,
        verdict="pass",
        sentence=f"{count_of(results.collections, 'collection')} of {count_of(results.found, 'moment')} in {folder}",
        results=results,
        outputs={"dataset": folder, "collections": results.collections, "labelled": found},
        notes=(
            *(
                f"'{name}' has intrinsics from its corners only: calibrate them too (intrinsics); {lens}"
                for name, lens in estimated.items()
            ),
            *(f"moments are evenly chosen: {why}" for why in [results.evenly] if why is not None),
            *results.notes,
        ),
        blocks=(
            Table(
                ("sensor", "images", "labelled", "corners", "intrinsics"),
                tuple(
                    (name, str(each.images), str(each.labelled), str(each.corners), each.intrinsics)
                    for name, each in results.sensors.items()
                ),
            ),
            Table(
                ("left out", "of", "count", "first (s)"),
                tuple(
                    (each.rule, each.place, str(each.count), "" if each.first_s is None else f"{each.first_s:.3f}")
                    for each in results.left_out
                ),
                title="Left out",
            ),
            Table(("sensor", "image", "why no pattern"), rejected, title="Images without a pattern", folded=True),
        ),
        suites={IMPORT_TITLE: [Outcome(name=name) for name in results.sensors]},
    )


def label_report(results: LabelResults, folder: Path) -> Report:
    """Return the report of ``label``."""
    rows = tuple((name, str(each.images), str(each.labelled)) for name, each in results.sensors.items())
    rejected = tuple((name, view.file, view.reason) for name, each in results.sensors.items() for view in each.rejected)
    return Report(
        title=LABEL_TITLE,
        verdict="pass",
        sentence=f"{sum(each.labelled for each in results.sensors.values())} images labelled in {folder}",
        results=results,
        outputs={"dataset": folder},
        blocks=(
            Table(("sensor", "images", "labelled"), rows),
            Table(("sensor", "image", "why no pattern"), rejected, title="Images without a pattern", folded=True),
        ),
        suites={LABEL_TITLE: [Outcome(name=name) for name in results.sensors]},
    )
