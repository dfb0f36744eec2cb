"""Systems, from jobs that calibrate in containers, each with the rules of the job that judges its table.

ATOM's evaluation scripts in a container's command are recognised, so that our engine can make the same table.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import PurePosixPath
from typing import Any

from calibration.addons.rigel.containers import Surroundings, component_entry, named
from calibration.addons.rigel.document import Rigelfile, RigelJob
from calibration.addons.rigel.fields import Notes, list_at, mapping_at, plain, text_at
from calibration.base import InputError
from calibration.base.tables.rules import parse_rules
from calibration.ci.introspection import COLUMNS_KEY, translate

_SOURCE_FLAG, _TARGET_FLAG = ("-ss", "--sensor_source"), ("-st", "--sensor_target")
_RANGE_FLAG, _DEPTH_FLAG, _CAMERA_FLAG = (
    ("-rs", "--range_sensor"),
    ("-ds", "--depth_sensor"),
    ("-cs", "--camera_sensor"),
)
_PATTERN_FLAG = ("-pn", "--pattern_name")
_Flag = tuple[str, str]
_FLAGS_OF_PAIR: Mapping[str, tuple[_Flag, _Flag]] = {
    "rgb_to_rgb": (_SOURCE_FLAG, _TARGET_FLAG),
    "lidar_to_rgb": (_RANGE_FLAG, _CAMERA_FLAG),
    "depth_to_rgb": (_DEPTH_FLAG, _CAMERA_FLAG),
    "lidar_to_lidar": (_SOURCE_FLAG, _TARGET_FLAG),
    "lidar_to_depth": (_RANGE_FLAG, _DEPTH_FLAG),
    "depth_to_depth": (_SOURCE_FLAG, _TARGET_FLAG),
}
_PREFIXES_BETWEEN = ("inter_collection_", "cross_collection_")
"""Prefixes of a pair's script that makes a table between collections; earlier versions used the second."""
_REQUIRED_FLAGS: Mapping[str, tuple[_Flag, ...]] = {
    **_FLAGS_OF_PAIR,
    **{f"{before}{script}": flags for before in _PREFIXES_BETWEEN for script, flags in _FLAGS_OF_PAIR.items()},
    "single_rgb": (),  # its filters are Python functions: all cameras and patterns are used
    "ground_truth_transform": (("-p", "--parent"), ("-c", "--child")),
    "ground_truth_frame": (("-tf", "--target_frame"),),
}
_OPTIONAL_FLAGS: Mapping[str, tuple[_Flag, ...]] = {
    "single_rgb": (),
    "ground_truth_transform": (),
    "ground_truth_frame": (("-sf", "--source_frame"),),
}
_EVALUATION_COMMAND = re.compile(
    rf"\b(?P<script>{'|'.join(_REQUIRED_FLAGS)})_evaluation(?:\.py)?(?![\w.-])(?P<flags>[^\n;&|]*)"
)
"""Match one of the scripts, and its arguments up to the end of the command."""


def evaluation_in(command: str, notes: Notes, where: str) -> str | None:
    """Return the first of ATOM's evaluations in a command, as a value of ``evaluate``; None if there is none.

    An evaluation whose flags do not name the sensors is noted.
    """
    found = _EVALUATION_COMMAND.search(command.replace("\\\n", " "))
    if found is None:
        return None
    script, flags = found["script"], found["flags"]
    names = [_value_of_flag(flags, flag) for flag in _REQUIRED_FLAGS[script]]
    if None in names:
        missing = _REQUIRED_FLAGS[script][names.index(None)][1]
        notes.to_do(where, f"evaluate: {script}_evaluation has no {missing} that can be read: write the table")
        return None
    more = [_value_of_flag(flags, flag) for flag in _OPTIONAL_FLAGS.get(script, (_PATTERN_FLAG,))]
    kind = script.replace("cross_", "inter_").replace("_", "-")
    return ":".join((kind, *(name for name in (*names, *more) if name)))


def _value_of_flag(flags: str, flag: _Flag) -> str | None:
    found = re.search(rf"(?<!\S)(?:{'|'.join(flag)})(?:\s+|=)[\"']?(\w[\w.-]*)(?=[\"'\s)]|$)", flags)
    return found[1] if found else None


_ROS_2 = (
    *("ardent", "bouncy", "crystal", "dashing", "eloquent", "foxy", "galactic"),
    *("humble", "iron", "jazzy", "kilted", "lyrical", "rolling"),
)
_EARLIER_KEY = "columns_to_verify"
"""Return a key of an earlier form of the file introspection."""


@dataclass(frozen=True)
class ConvertedEntry:
    """An entry of ``systems`` or ``simulation``, and its source."""

    name: str
    entry: dict[str, Any]
    origin: str


def is_compose(job: RigelJob) -> bool:
    """Return whether a job runs containers."""
    return job.kind == "ComposePlugin" or "components" in job.fields


def is_introspection(job: RigelJob) -> bool:
    """Return whether a job judges a table."""
    return COLUMNS_KEY in job.fields or _EARLIER_KEY in job.fields or "introspection" in job.kind.lower()


def judged_by(rigelfile: Rigelfile) -> dict[str, list[RigelJob]]:
    """Return the judging jobs, by the name of the job whose table they judge: the preceding one in their stage.

    A judging job outside of all stages belongs to the only job that runs containers, if there is only one.
    """
    judges: dict[str, list[RigelJob]] = {}
    placed = set()
    for stage in rigelfile.stages:
        last = None
        for job in stage.jobs:
            if is_compose(job):
                last = job
            elif is_introspection(job) and last is not None:
                placed.add(job.name)
                if job not in judges.setdefault(last.name, []):
                    judges[last.name].append(job)
    running = [job for job in rigelfile.jobs if is_compose(job)]
    for job in rigelfile.jobs:
        if is_introspection(job) and job.name not in placed:
            if len(running) == 1:
                judges.setdefault(running[0].name, []).append(job)
            else:
                rigelfile.notes.lost(job.where, "no job before it makes its table: write its rules by hand")
    return judges


def ros_version(distro: str | None) -> int:
    """Return the ROS version, 1 or 2, of the distribution; without one Rigel starts a ROS 1 master."""
    return 2 if distro in _ROS_2 else 1


def system_of(
    job: RigelJob, judges: list[RigelJob], distro: str | None, around: Surroundings, folder: str
) -> ConvertedEntry | None:
    """Return the system of a job that calibrates; None if it does not.

    Raises:
        InputError: a field has the wrong type.
    """
    components = _components_of_job(job)
    chosen = _judged_component(components, bool(judges))
    if chosen is None:
        return None
    where = f"{job.where}.components"
    for other in components:
        if other is not chosen:
            name = other.get("name", "without a name")
            around.notes.lost(
                f"{where}.{name}", "a calibration is one container here: start what it needs in its command"
            )
    software = component_entry(chosen, around, f"{where}.{chosen.get('name', 0)}")
    if "command" not in software:
        around.notes.to_do(where, "the command that calibrates is not in the Rigelfile: write it for TODO")
        software = {"command": ["TODO"], **software}
    software["ros"] = ros_version(distro)
    software |= _convert_timeout(job, around.notes)
    if not any(str(path).endswith((".json", "*")) for path in software.get("artifacts", ())):
        software["calibrated"] = "none"
        around.notes.to_do(
            f"{where}.{chosen.get('name', 0)}",
            "calibrated: bring the calibrated dataset out too, and remove 'none': then it is held against our optimum, "
            "while a table alone is believed",
        )
    entry: dict[str, Any] = {"dataset": "TODO"}
    around.notes.to_do(
        f"{where}.{chosen.get('name', 0)}",
        "dataset: name the folder of the dataset in the repository; the command gets the noisy one as {start}",
    )
    evaluate = evaluation_in(" ".join(map(str, software["command"])), around.notes, where)
    if evaluate:
        entry["evaluate"] = evaluate
    entry["software"] = software
    rules = [rule for judge in judges for rule in _convert_rules(judge, software, around.notes, folder)]
    if rules:
        entry["rules"] = rules
    elif not judges:
        around.notes.to_do(job.where, "no job judges its table: write rules, or only its exit code counts")
    _refuse_others(job, around.notes)
    origin = f"job {job.name}" + (f", judged by {', '.join(judge.name for judge in judges)}" if judges else "")
    return ConvertedEntry(named_system(job.name), entry, origin)


def collection_of(job: RigelJob, distro: str | None, around: Surroundings) -> ConvertedEntry | None:
    """Return the simulation of a job that writes a dataset, or runs several containers; None if it does not.

    Raises:
        InputError: a field has the wrong type.
    """
    components = _components_of_job(job)
    where = f"{job.where}.components"
    containers: dict[str, dict[str, Any]] = {}
    dataset = None
    for number, component in enumerate(components):
        name = named(str(component.get("name", f"container-{number}")))
        while name in containers:
            name = f"{name}-2"
        entry = component_entry(component, around, f"{where}.{name}")
        brought = [path for path in entry.get("artifacts", []) if path.endswith(("dataset.json", "/dataset"))]
        if brought:
            dataset = brought[0].removesuffix("/dataset.json")
            entry["artifacts"] = [path for path in entry["artifacts"] if path not in brought]
            if not entry["artifacts"]:
                del entry["artifacts"]
        elif len(components) > 1:
            entry["essential"] = False
        containers[name] = entry
    if dataset is None:
        return None
    if all(entry.get("essential") is False for entry in containers.values()):
        raise AssertionError("the container that has the dataset is essential")
    simulation: dict[str, Any] = {"containers": containers, "ros": ros_version(distro)}
    simulation |= _convert_timeout(job, around.notes)
    simulation["dataset"] = dataset
    _refuse_others(job, around.notes)
    return ConvertedEntry(named_system(job.name), simulation, f"job {job.name}")


def named_system(name: str) -> str:
    """Return a name that is valid in calibration.yml."""
    return re.sub(r"[^A-Za-z0-9_.-]+", "-", name).strip("-_.")[:64] or "robot"


def _components_of_job(job: RigelJob) -> list[dict[str, Any]]:
    where = f"{job.where}.components"
    return [mapping_at(c, f"{where}.{i}") for i, c in enumerate(list_at(job.fields.get("components"), where))]


def _judged_component(components: list[dict[str, Any]], judged: bool) -> dict[str, Any] | None:
    """Return the component whose table is judged: one with a CSV file as artifact, or the last one of a judged job."""

    def has_table(component: Mapping[str, Any]) -> bool:
        artifacts = component.get("artifacts")
        return isinstance(artifacts, list) and any(str(path).endswith(".csv") for path in artifacts)

    with_table = [component for component in components if has_table(component)]
    return with_table[-1] if with_table else components[-1] if judged and components else None


def _convert_rules(judge: RigelJob, software: dict[str, Any], notes: Notes, path: str) -> list[dict[str, Any]]:
    if COLUMNS_KEY not in judge.fields:
        notes.lost(judge.where, "an earlier form of the file introspection: write its limits as rules")
        return []
    try:
        document = translate(_plain_values(judge.fields, notes, judge.where), f"{path}: {judge.where}")
        parse_rules(document, f"{path}: {judge.where}")
    except InputError as error:
        notes.lost(judge.where, str(error).removeprefix(f"{path}: {judge.where}: "))
        return []
    _set_table(str(document.get("file", "")), software, judge.where, notes)
    notes.changed(judge.where, "a number equal to a limit passes here; add `exclusive: true` to a rule if it must not")
    rules: list[dict[str, Any]] = document["rules"]
    return rules


def _set_table(file: str, software: dict[str, Any], where: str, notes: Notes) -> None:
    """Return the artifact that is judged."""
    name = PurePosixPath(file).name
    tables = [path for path in software.get("artifacts", []) if path.endswith(".csv")]
    if file and any(PurePosixPath(path).name == name for path in tables):
        if len(tables) > 1:
            software["table"] = f"*{name}"
    elif file:
        notes.to_do(f"{where}.file", f"{name} is no artifact of the job before it: add it to software.artifacts")


def _plain_values(node: Any, notes: Notes, where: str) -> Any:
    if isinstance(node, dict):
        return {plain(key, notes, where): _plain_values(value, notes, f"{where}.{key}") for key, value in node.items()}
    if isinstance(node, list):
        return [_plain_values(value, notes, where) for value in node]
    return plain(node, notes, where) if isinstance(node, str) else node


def _convert_timeout(job: RigelJob, notes: Notes) -> dict[str, str]:
    timeout, where = job.fields.get("timeout"), f"{job.where}.timeout"
    if timeout in (None, 0):
        return {}
    notes.changed(where, "a limit, no waiting: the job ends when its container ends")
    return {"timeout": f"{text_at(timeout, where).removesuffix('.0')}s"}


def _refuse_others(job: RigelJob, notes: Notes) -> None:
    for key in job.fields:
        if key not in ("components", "timeout"):
            notes.lost(f"{job.where}.{key}", "there is no such setting here")
