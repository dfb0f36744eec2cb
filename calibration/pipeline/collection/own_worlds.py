"""Worlds of our own simulation, here or in containers: in each, ``calibration collect-data-sim`` collects one of them.

The image has this package. What it says of a world is not taken on trust: its dataset is calibrated here again.
"""

import json
from dataclasses import replace
from functools import cached_property
from pathlib import Path

import cv2
import numpy as np

from calibration import __version__
from calibration.errors import ExitCode, InputError
from calibration.execution.job import OUTPUT, Artifact, Container, Job, Mount
from calibration.execution.job_folder import ARTIFACTS, LOGS
from calibration.execution.outcome import JobOutcome
from calibration.execution.workspace import identity
from calibration.files import read_bytes, write_atomically
from calibration.pipeline.collection.applications import INPUTS
from calibration.pipeline.collection.collecting import requirements_of
from calibration.pipeline.collection.motion import required_motion
from calibration.pipeline.collection.request import GENERATE, CollectionRequest, ScenarioRequest, WorldImage
from calibration.pipeline.collection.world_file import FILE, read_world
from calibration.pipeline.collection.world_folder import Judged, Worlds
from calibration.simulation.collection.proof import prove
from calibration.simulation.motion.sequence import motion_document
from calibration.simulation.scenarios.run import proven, run_scenario, unseen
from calibration.simulation.scenarios.scenario import ScenarioResult
from calibration.simulation.scenarios.scenario_set import read_scenario_set
from calibration.simulation.system import read_system
from calibration.workflow.text import one_line, shorten

WORLD = "world"
"""The name of the container."""
DATASET = "dataset"
"""The name of the folder that it leaves."""
SET_FILE, MOTION_FILE, SYSTEM_FOLDER = "scenarios.yml", "motion.json", "system"
"""In `INPUTS`; the system's folder is in the last, by its own name."""
MAX_INPUT = 64 * 1024**2
"""Bytes of a scenario set or a motion."""
_TAIL = 4096


class OwnWorlds(Worlds):
    """The worlds of a scenario set."""

    def __init__(self, collection: CollectionRequest, request: ScenarioRequest) -> None:
        """Read the request's files, and draw the worlds.

        Raises:
            InputError: one is missing or wrong, or no draw of a world keeps to the constraints.
        """
        if request.scenario_set is None:
            raise InputError("scenarios and scenario need a scenario-set: a YAML file of what varies between worlds")
        self.image = request.image
        self._collection = collection
        self._requirements = requirements_of(collection)
        self.stillness = self._requirements.stillness
        self._system = read_system(collection.system, collection.robot, collection.configuration)
        self.system = self._system.name
        self._set_file = request.scenario_set
        self._set = read_scenario_set(request.scenario_set, self._system)
        self._motion = None if collection.motion is None else required_motion(collection, self._system)
        self._scenarios = [self._set.scenario(collection.seed, number) for number in range(request.count)]
        self.unseen = [unseen(self._set, scenario, self._motion) for scenario in self._scenarios]

    # --- here

    @cached_property
    def identity(self) -> str:
        """What the worlds depend on, beside their numbers."""
        versions = f"{__version__} {np.__version__} {cv2.__version__} {self._requirements}"
        motion = json.dumps(motion_document(self._motion)) if self._motion else ""
        content = read_bytes(self._set_file, MAX_INPUT, "a scenario set")
        return identity(versions.encode(), motion.encode(), content, *self._system.sources.values())

    def collect(self, number: int) -> ScenarioResult:
        """Collect a world in this process, and calibrate it."""
        return run_scenario(self._set, self._scenarios[number], self._motion, self._requirements)

    # --- in containers

    def write_inputs(self, folder: Path) -> Path:
        """Write the system, the set and the motion."""
        for name, content in self._system.sources.items():
            write_atomically(folder / SYSTEM_FOLDER / self.system / name, content)
        write_atomically(folder / SET_FILE, read_bytes(self._set_file, MAX_INPUT, "a scenario set"))
        if (motion := self._motion_file) is not None:
            write_atomically(folder / MOTION_FILE, read_bytes(motion, MAX_INPUT, "a motion sequence"))
        return folder

    @property
    def _motion_file(self) -> Path | None:
        motion = self._collection.motion
        return None if motion is None or motion.startswith(GENERATE) else Path(motion)

    def job(self, number: int, inputs: Path | None) -> Job:
        """The job of a world."""
        of, image, name = self._collection, self.image or WorldImage(""), self.unseen[number].id
        options = {
            "--system": f"{INPUTS}/{SYSTEM_FOLDER}/{self.system}",
            "--scenario-set": f"{INPUTS}/{SET_FILE}",
            "--scenario": name,
            "--output": f"{OUTPUT}/{DATASET}",
            "--jobs": "1",  # the worlds are the parallel ones
        }
        if of.motion is not None:
            options["--motion"] = of.motion if self._motion_file is None else f"{INPUTS}/{MOTION_FILE}"
        if of.stillness is not None:
            options["--stillness-mm"] = repr(1000 * of.stillness)
        container = Container(
            name=WORLD,
            image=image.image,
            command=("calibration", "collect-data-sim", *(word for option in options.items() for word in option)),
            mounts=() if inputs is None else (Mount(inputs.resolve(), INPUTS),),
            success=(ExitCode.PASS, ExitCode.FAIL, ExitCode.BAD_INPUT),  # what these mean is in the file of the world
            artifacts=(Artifact(f"{OUTPUT}/{DATASET}", required=False),),
        )
        return Job(name, (container,), seconds=image.seconds)

    def judge(self, number: int, outcome: JobOutcome, new: Path) -> Judged:
        """What a world's job is worth: its dataset is moved to ``new``, and calibrated."""
        known = self.unseen[number]
        if outcome.exit_code != ExitCode.PASS:
            error = None if outcome.exit_code == ExitCode.FAIL else outcome.exit_code
            return Judged(replace(known, reasons=outcome.reasons), error, complete=False)
        brought = outcome.folder / ARTIFACTS / DATASET
        try:
            if not (brought / FILE).exists():
                raise InputError(f"the image left no {FILE} (it needs calibration-ci){_last_line(outcome)}")
            said = read_world(brought, known, self.stillness)
        except InputError as error:
            return Judged(replace(known, reasons=(str(error),)), complete=False)
        brought.rename(new)
        result = replace(
            known, poses=said.poses, lost=said.lost, detection=said.detection, corner_rms_px=said.corner_rms_px
        )
        if said.kept > 0:
            return Judged(proven(result, prove(new)))
        return Judged(replace(result, reasons=said.reasons or ("no pose gave a collection",)))


def _last_line(outcome: JobOutcome) -> str:
    """What the container said last, for a message; nothing where it said nothing."""
    try:
        with (outcome.folder / LOGS / f"{WORLD}.log").open("rb") as log:
            log.seek(max(0, log.seek(0, 2) - _TAIL))
            lines = log.read(_TAIL).decode("utf-8", "replace").splitlines()
    except OSError:
        return ""
    last = next((line for line in reversed(lines) if line.strip()), "")
    return f": {shorten(one_line(last), 300)}" if last else ""
