"""Watches a recording while it is made: each image is judged, and the calibration and the next pose follow it."""

import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from calibration.base import CalibrationError, InputError, one_line, temporary_folder, write_atomically
from calibration.base.process import Terminated
from calibration.ci.pages.html import Html, bullets, element, page, section, table
from calibration.ci.report import Lines, Report, Table, count_of
from calibration.ci.workflow import Runner
from calibration.engine.dataset.model import Dataset
from calibration.engine.dataset.reading import FILE_NAME, read_dataset
from calibration.engine.dataset.writing import write_document
from calibration.engine.diagnosis.limits import Limits
from calibration.engine.diagnosis.projection import projection, projection_limit
from calibration.engine.estimation.calibrate import calibrate
from calibration.engine.estimation.covariance.projection import projection_of
from calibration.engine.estimation.covariance.result import Calibration
from calibration.engine.estimation.options import Options
from calibration.engine.next_pose import next_poses
from calibration.pipeline.next_poses import AdvisedPoses, described_advice
from calibration.pipeline.page.label_residuals import poses_in_images, reduced_jpeg
from calibration.robot.importing.arrivals import Arrivals, FollowedBag
from calibration.robot.importing.description import ImportDescription
from calibration.robot.importing.document import Imported, dataset_document
from calibration.robot.importing.files.pictures import Pictures, order_by_number
from calibration.robot.importing.image_views import View
from calibration.robot.importing.importing import (
    check_printed_patterns,
    described_lenses,
    read_description,
    recorded_views,
    write_dataset,
)
from calibration.robot.importing.look.judging import ImageJudge, JudgedImage
from calibration.robot.importing.mounting import pattern_configurations
from calibration.robot.importing.recorded import LEAST_VIEWS, imported_moments
from calibration.robot.next_pose.candidates import candidates_of
from calibration.robot.simulation.dataset_folder import refuse_existing

TITLE, DESCRIPTION_FILE, PAGE = "watch", "import.yml", "watch.html"
POLL_SECONDS = 0.1
"""From one look into the folders to the next; an image is taken when it has not changed for as long."""
LATER_CALIBRATION = 1.05
"""Further views, relative to those of the last calibration, for the next: of many views one more changes nothing."""
COVERED_COLUMNS = ("camera", "used", "corners in the image")
IMAGE_COLUMNS = ("image", "", "what was measured, or why it is not used")
SHOWN_IMAGES = 30
"""Images on the page, the latest ones."""


@dataclass(frozen=True, eq=False)
class CalibratedSoFar:
    """What the used views tell."""

    imported: Imported | None = None
    """The dataset of the used views; None if they make none yet."""
    fault: str = ""
    """Why there is no dataset or no calibration; empty if there is one."""
    error_bars: str = ""
    """Standard deviations of what is calibrated, in words."""
    advice: tuple[str, ...] = ()
    """What to record next."""
    poses: AdvisedPoses | None = None
    """The same to be drawn."""


class WatchedRecording:
    """Recording that is being made: its images so far, and the calibration by them."""

    def __init__(self, path: Path, limits: Limits, folder: Path) -> None:
        """Read the description of the recording.

        Args:
            path: import.yml, or a folder that has it.
            limits: those to be decided.
            folder: for images that are taken from a bag.

        Raises:
            InputError: it is missing or wrong, or has other sources than folders of images, or a bag.
        """
        self.config, self.limits = _description_file(path), limits
        self.described = read_description(self.config)
        _check_sources(self.config, self.described)
        check_printed_patterns(self.config, self.described)
        self.lenses, self.models = described_lenses(self.config, self.described)
        places = {each.name: each.images for each in self.described.sensors if each.images}
        self.arrivals = Arrivals(places) if places else FollowedBag(self.described, self.lenses, folder)
        self.judge = ImageJudge(pattern_configurations(self.described), tuple(places))
        self.images: list[str] = []
        """What was said of each image."""
        self.used: dict[str, dict[Path, View]] = {name: {} for name in places}
        """Used views by camera and file."""
        self.calibrated = CalibratedSoFar(fault="no view is used yet")
        self._views_of_calibration = 0
        self._faults: Mapping[str, str] = {}

    def next_lines(self) -> Iterator[str]:
        """Yield what is new: a line for each image that has arrived, and what the views tell if they are more."""
        for arrival in self.arrivals.poll():
            if self.arrivals.is_gone(arrival):
                continue
            judged = self.judge.judge(arrival)
            if judged.view is None or judged.kind:
                self.arrivals.refuse(arrival)
            else:
                self.used.setdefault(arrival.sensor, {})[arrival.path] = judged.view
            self.images.append(self._line_of_image(judged))
            yield self.images[-1]
        if self.arrivals.faults != self._faults:
            self._faults = self.arrivals.faults
            yield from (f"{name}: {fault}; waiting for it" for name, fault in self._faults.items())
        if self._count_used() > LATER_CALIBRATION * self._views_of_calibration:
            yield from self.calibrate()

    def calibrate(self) -> Iterator[str]:
        """Calibrate by the views that are used so far, and yield what that tells."""
        self._views_of_calibration, known = self._count_used(), self.calibrated.advice
        self.calibrated = self._calibrated()
        yield self.sentence
        yield from (f"next: {line}" for line in self.calibrated.advice if line not in known)

    @property
    def sentence(self) -> str:
        """How far it is, in words."""
        found = self.calibrated
        if found.imported is None or found.fault:
            return f"{count_of(self._count_used(), 'view')} used; no calibration yet: {found.fault}"
        return f"{count_of(len(found.imported.moments), 'collection')}: {found.error_bars}"

    def _line_of_image(self, judged: JudgedImage) -> str:
        arrival = judged.arrival
        name = f"{arrival.sensor} {arrival.path.name}"
        if judged.kind:
            return f"{name}: not used: {judged.reason}"
        return f"{name}: used: {', '.join(judged.remarks)}; covered {self.judge.cameras[arrival.sensor].coverage}"

    def _calibrated(self) -> CalibratedSoFar:
        counts = {name: len(seen.names) for name, seen in self.judge.cameras.items()}
        if few := [
            f"{name} has {count} of {LEAST_VIEWS} views" for name, count in counts.items() if count < LEAST_VIEWS
        ]:
            return CalibratedSoFar(fault=", ".join(few))
        imported: Imported | None = None
        try:
            imported = self._imported()
            options = Options(description="rough", intrinsics=tuple(imported.estimated))
            calibration = calibrate(_dataset_of(imported), options)
            if not calibration.converged:
                return CalibratedSoFar(imported, calibration.reason)
            candidates = candidates_of(calibration)
            advice = next_poses(calibration, candidates.dataset, self.limits, (), 1)
            poses = described_advice(advice, candidates, None)
            bars = [
                f"{g.name} {g.now or 0:.2g} {g.unit} ({g.wanted:.2g} decides its limit of {g.limit:.2g})"
                for g in poses.found.goals
            ]
            bars += _projections(calibration, self.limits)
            lines = poses.found.lines if poses.found.goals else ()
            lines += tuple(each.text for each in projection(calibration, self.limits))
            lines = lines or ("enough: the limits of the projection hold",)
            return CalibratedSoFar(imported, "", ", ".join(bars), lines, poses)
        except CalibrationError as error:
            return CalibratedSoFar(imported, str(error))

    def _imported(self) -> Imported:
        """Return the dataset of the used views.

        Raises:
            InputError: images of the cameras do not belong together, or not to the samples.
        """
        if isinstance(self.arrivals, FollowedBag):
            recorded = self.arrivals.recorded(self.used)
        else:
            pictures = [
                Pictures(name, self.arrivals.places[name], tuple(sorted(views, key=order_by_number)))
                for name, views in self.used.items()
            ]
            views = {file: view for own in self.used.values() for file, view in own.items()}
            recorded = recorded_views(self.described, self.lenses, pictures, views)
        robot = self.described.robot or self.config.resolve().parent.name
        return imported_moments(robot, replace(recorded, models=self.models))

    def _count_used(self) -> int:
        return sum(map(len, self.used.values()))

    @property
    def covered(self) -> tuple[tuple[str, ...], ...]:
        """Of each camera its name, the number of used views, and the parts of the image with corners."""
        return tuple((name, str(len(each.names)), each.coverage) for name, each in self.judge.cameras.items())

    @property
    def page(self) -> str:
        """The page of the state, which a browser reads again each second."""
        found = self.calibrated
        figures = []
        if found.poses is not None:
            images = {name: reduced_jpeg(list(views)[-1]) for name, views in self.used.items() if views}
            figures.append(poses_in_images(found.poses.found, found.poses.candidates.dataset, None, images))
        covered = [(name, count, _drawn_cells(cells)) for name, count, cells in self.covered]
        images_so_far = [_row_of_image(line) for line in self.images[: -SHOWN_IMAGES - 1 : -1]]
        sections = [
            element("h1", f"{TITLE} {self.config.resolve().parent.name}"),
            section("Now", element("p", self.sentence)),
            section("Next", bullets(found.advice), *figures),
            section("Covered", table(COVERED_COLUMNS, covered)),
            section("Images", table(IMAGE_COLUMNS, images_so_far)),
        ]
        return page(TITLE, sections, refresh=1)


def _drawn_cells(coverage: str) -> Html:
    """Return the parts of an image with corners and without, row by row."""
    rows = (row.replace("x", "\u25a0").replace(".", "\u25a1") for row in coverage.split())
    return element("span", *(each for row in rows for each in (row, element("br"))), class_="cells")


def _row_of_image(line: str) -> tuple[str, str, str]:
    """Return what was said of an image in columns."""
    name, state, rest = line.split(": ", 2)
    return (
        name,
        state if state == "used" else element("span", state, class_="undecided"),
        rest.partition("; covered")[0],
    )


def _description_file(path: Path) -> Path:
    file = path / DESCRIPTION_FILE if path.is_dir() else path
    if not path.exists() or not file.is_file():
        what = "no such folder" if not path.exists() else f"no {DESCRIPTION_FILE}"
        raise InputError(
            f"{path}: found {what}, expected a folder with {DESCRIPTION_FILE}, which names the folders of the cameras' "
            "images and the pattern ('calibration pattern' prints its lines), or such a file"
        )
    return file


def _check_sources(config: Path, described: ImportDescription) -> None:
    if described.has_videos:
        raise InputError(
            f"{config}: found a video, which is not followed while it is written; expected folders of images (ffmpeg "
            "writes them, docs/watch.md) or a bag; or 'calibration look' at the recording afterwards"
        )
    if described.bags is not None:
        return
    if others := [each.name for each in described.sensors if not each.images or each.clouds]:
        raise InputError(f"{config}: sensors/{others[0]}: found no folder of images, expected 'images' of each sensor")


def _dataset_of(imported: Imported) -> Dataset:
    with temporary_folder() as folder:
        write_document(dataset_document(imported), folder / FILE_NAME)
        return read_dataset(folder)


def _projections(calibration: Calibration, limits: Limits) -> Iterator[str]:
    """Yield the error bar of each camera whose intrinsics are calibrated."""
    for name, intrinsics in calibration.intrinsics.items():
        found = projection_of(calibration, name)
        sigma = found.most(np.asarray(found.sigmas(intrinsics.covariance, found.distance)))
        yield f"projection of {name} {sigma:.2g} px (limit {projection_limit(found.camera, limits):.2g})"


def watch(
    recording: WatchedRecording,
    runner: Runner,
    output: Path | None = None,
    overwrite: bool = False,
    idle: float | None = None,
) -> Report:
    """Watch a recording until Ctrl-C, and say what is new.

    Args:
        recording: the recording.
        runner: where it is said.
        output: folder for the dataset of the used views, written at the end; none by default.
        overwrite: whether a dataset there is replaced.
        idle: seconds without a new image after which it ends too; never by default.

    Raises:
        InputError: the folder of the dataset is not empty.
        InfrastructureError: a file cannot be written.
    """
    if output is not None:
        refuse_existing(output, overwrite)
    page_file = recording.config.parent / PAGE
    runner.log(f"watching {', '.join(recording.arrivals.places.values())}; page: {page_file}; end with Ctrl-C")
    try:
        last, is_new = time.monotonic(), True
        while idle is None or time.monotonic() - last < idle:
            for line in recording.next_lines():
                _say(runner, line)
                is_new = True
            if is_new and page_file.parent.is_dir():
                write_atomically(page_file, recording.page)
            last, is_new = time.monotonic() if is_new else last, False
            time.sleep(POLL_SECONDS)
    except Terminated:
        raise
    except KeyboardInterrupt:
        runner.log()
    return _finished(recording, output, overwrite)


def _say(runner: Runner, line: str) -> None:
    line = one_line(line)  # names of files may be hostile
    if not runner.on_terminal:
        runner.log(line)
        return
    from rich.console import Console  # here, as rich is slow to import, and a log needs none of it

    style = "yellow" if ": not used: " in line else "bold" if line.startswith("next: ") else ""
    Console(file=runner.stdout).print(line, style=style, markup=False, highlight=False, soft_wrap=True)


def _finished(recording: WatchedRecording, output: Path | None, overwrite: bool) -> Report:
    """Write the dataset, and return the summary."""
    list(recording.calibrate())
    found, counts = recording.calibrated, recording.judge.counts
    folder = recording.config.resolve().parent.name
    command = f"calibration import-data --recordings {recording.config} --output data/{folder}"
    if counts["unreadable"] or counts["other size"] or counts["same as before"]:
        command = f"calibration watch {recording.config} --idle 2 --output data/{folder}  # only the used views"
    then = f"make a dataset of it: {command}"
    if output is not None and found.imported is not None:
        write_dataset(found.imported, output, overwrite)
        then = f"dataset of the used views: {output}; next: calibration init, calibration run"
    elif output is not None:
        then = f"no dataset is written: {found.fault}"
    total, used = counts.total(), counts[""]
    collections = len(found.imported.moments) if found.imported else 0
    return Report(
        title="Recording",
        verdict="fail" if found.fault else "pass",
        sentence=f"{count_of(total, 'image')}, {used} used; {recording.sentence}",
        results={"images": total, "used": used, "collections": collections},
        blocks=(
            Table(("not used", "images"), tuple((k, str(n)) for k, n in counts.most_common() if k)),
            Table(
                ("camera", "used", "covered"),
                tuple((n, str(len(s.names)), s.coverage) for n, s in recording.judge.cameras.items()),
            ),
            Lines((*found.advice, then), title="Next"),
        ),
    )
