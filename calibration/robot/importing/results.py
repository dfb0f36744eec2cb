"""What ``import-data`` and ``label`` report: nothing is left out in silence."""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Literal

from calibration.base.records import field, result
from calibration.ci.report import Outcome, Report, Table, count_of
from calibration.robot.importing.bags.bag import NS_PER_S

IMPORT_TITLE, LABEL_TITLE = "import-data", "label"


@result
class RejectedView:
    """An image in which no pattern is detected."""

    file: str = field("The image.")
    reason: str = field("Why.")


@result
class SensorResult:
    """Results for the images of one camera, or the clouds or scans of one LiDAR."""

    images: int = field("Number of images.")
    labelled: int = field("Number of those with a pattern.")
    corners: int = field("Total number of corners, or points on a pattern.")
    intrinsics: Literal["given", "estimated", "none"] = field(
        "Where they come from; estimated ones are a start only; a LiDAR has none."
    )
    camera: Mapping[str, float] = field("The intrinsics by their names.")
    lens: str | None = field("Why an estimated camera has its lens model.", default=None)
    rejected: tuple[RejectedView, ...] = field("Images in which no pattern is detected.", default=())


@result
class LeftOut:
    """What an import left out by one rule in one place."""

    rule: str = field("Why.")
    place: str = field("The sensor, topic, frame or joint.")
    count: int = field("How many.")
    first_s: float | None = field("Stamp of the first.", default=None, unit="s")


@result
class ImportResults:
    """Results of import-data."""

    robot: str = field("Its name.")
    found: int = field("Number of moments found, of which the best are kept.")
    moments: int = field("Number of moments that were searched: images that belong together.")
    collections: int = field("Number of moments with a pattern: the collections of the dataset.")
    together: int = field("Collections in which two sensors or more see a pattern.")
    lag_ms: float = field("Largest time between the images of a moment.", unit="ms")
    sensors: Mapping[str, SensorResult] = field("By name.")
    evenly: str | None = field(
        "Reason why the moments are evenly spaced, and not those that calibrate best.", default=None
    )
    left_out: tuple[LeftOut, ...] = field("What was recorded and is not in the dataset.", default=())
    notes: tuple[str, ...] = field("What was read otherwise than recorded.", default=())


@result
class LabelledSensor:
    """Results for the labelled images of one camera."""

    images: int = field("Number of images that were searched.")
    labelled: int = field("Number of those with a pattern.")
    rejected: tuple[RejectedView, ...] = field("Images in which no pattern is detected.", default=())


@result
class LabelResults:
    """Results of label."""

    collections: int = field("Of the dataset.")
    sensors: Mapping[str, LabelledSensor] = field("By name.")


class LeftOutCounts:
    """What an import leaves out, counted by rule and place."""

    def __init__(self) -> None:
        self._found: dict[tuple[str, str], LeftOut] = {}

    def add(self, rule: str, place: str, stamp: float | None = None, count: int = 1) -> None:
        """Count something.

        Args:
            rule: why it is left out.
            place: its sensor, topic, frame or joint.
            stamp: its time, ns.
            count: how many there are.
        """
        first_s = None if stamp is None else round(stamp / NS_PER_S, 6)
        before = self._found.get((rule, place), LeftOut(rule, place, 0, first_s))
        if count:
            self._found[rule, place] = replace(before, count=before.count + count)

    def of(self, place: str) -> Iterator[str]:
        """Yield in words what was left out of one place."""
        return (f"{each.count} left out: {each.rule}" for each in self._found.values() if each.place == place)

    def results(self) -> tuple[LeftOut, ...]:
        """Return them as results, in the order in which they were found."""
        return tuple(self._found.values())


def report(results: ImportResults, folder: Path) -> Report:
    """Return the report of ``import-data``."""
    found: Mapping[str, int] = {name: each.labelled for name, each in results.sensors.items()}
    estimated = {name: each.lens for name, each in results.sensors.items() if each.intrinsics == "estimated"}
    rejected = tuple((name, view.file, view.reason) for name, each in results.sensors.items() for view in each.rejected)
    return Report(
        title="Import",
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
        title="Labels",
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
