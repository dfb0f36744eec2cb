"""RoboMaker's jobs, whose service has ended, as containers of a simulation."""

import re
from dataclasses import replace
from typing import Any

from calibration.rigel.containers import Surroundings, component_entry, pair_environment
from calibration.rigel.document import RigelJob, list_at, mapping_at, text_at
from calibration.rigel.notes import Notes

ROBOMAKER = "RoboMakerPlugin"
_APPLICATIONS = {"simulation": "simulation_application", "robot": "robot_application"}
_ADDRESS = re.compile(r"ROBOMAKER_(ROBOT|SIM)_APP_IP")
_MASTER = re.compile(r"http://robot:(\d+)/?")
_GONE = {
    "iam_role": "there is no RoboMaker: containers run on this machine",
    "output_location": "there is no RoboMaker: the dataset is brought out to the output folder",
    "vpc_config": "there is no RoboMaker: the containers have a private network of their own",
    "compute": "limit memory and cpus of each container instead",
    "data_sources": "mount a folder that was downloaded before",
    "worldforge_exported_job": "worlds come from a scenario set here: calibration schema scenario-set",
}
_OF_AN_APPLICATION = {
    "ports": "the containers find each other by name; nothing is reachable from outside",
    "stream_ui": "there is no screen",
    "world_configs": "worlds come from a scenario set here: calibration schema scenario-set",
    "name": "a container is called robot or simulation",
}


def robomaker_entry(job: RigelJob, around: Surroundings) -> dict[str, Any]:
    """The entry of ``simulation``.

    Raises:
        InputError: a field is of the wrong kind.
    """
    notes, where = around.notes, job.where
    around = replace(around, replaced=_with_names)
    containers: dict[str, dict[str, Any]] = {}
    fields = dict(job.fields)
    for name, key in _APPLICATIONS.items():
        if fields.get(key):
            application = mapping_at(fields[key], f"{where}.{key}")
            containers[name] = _application(application, name, around, f"{where}.{key}")
        fields.pop(key, None)
    if not containers:
        notes.lost(where, "it has neither a robot application nor a simulation application")
        return {}
    _order(containers)
    duration = fields.pop("simulation_duration", 300)
    entry = {
        "containers": containers,
        "ros": "none",
        "timeout": f"{text_at(duration, where)}s",
        "dataset": "{output}/dataset",
    }
    essential = "robot" if "robot" in containers else "simulation"
    notes.changed(
        f"{where}.simulation_duration",
        f"a limit: whoever reaches it has failed. The job ends when the container {essential} ends, with exit code 0",
    )
    notes.to_do(where, "let the collection write its dataset to {output}/dataset, which is brought out")
    for key in fields:
        notes.lost(f"{where}.{key}", _GONE.get(key, "there is no such setting here"))
    return entry


def _application(application: dict[str, Any], name: str, around: Surroundings, where: str) -> dict[str, Any]:
    fields = dict(application)
    for key, why in _OF_AN_APPLICATION.items():
        if fields.pop(key, None):
            around.notes.lost(f"{where}.{key}", why)
    _tools(list_at(fields.pop("tools", []), f"{where}.tools"), around.notes, f"{where}.tools")
    fields["image"] = fields.pop("ecr", "")
    environment = pair_environment(list_at(fields.pop("environment", []), f"{where}.environment"), where)
    own_address = {"ROBOMAKER_ROBOT_APP_IP": "robot", "ROBOMAKER_SIM_APP_IP": "simulation"}
    if own_address.get(environment.get("ROS_IP", "")) == name:
        del environment["ROS_IP"]  # of a network where the address is not known before: the name in its place
        environment["ROS_HOSTNAME"] = name
    fields["envs"] = {key: value for key, value in environment.items() if key}
    for key in ("requirements",):
        if fields.pop(key, None):
            around.notes.lost(f"{where}.{key}", "requirements on ROS messages are not checked here")
    return component_entry(fields, around, where)


def _tools(tools: list[Any], notes: Notes, where: str) -> None:
    for number, tool in enumerate(tools):
        name = mapping_at(tool, where).get("name", number)
        notes.lost(
            f"{where}.{name}", "a tool beside an application: add a container with `essential: false` if it is needed"
        )


def _order(containers: dict[str, dict[str, Any]]) -> None:
    """Who starts first: whoever runs the ROS master; its end, or that of the robot, ends the job."""
    if len(containers) < 2:
        return
    containers["simulation"]["essential"] = False
    master = containers["simulation"].get("environment", {}).get("ROS_MASTER_URI", "")
    found = _MASTER.fullmatch(master)
    if found:
        containers["robot"]["ready"] = {"port": int(found[1])}
        containers["simulation"]["after"] = ["robot"]


def _with_names(text: str) -> str:
    """The names of the containers in the place of the addresses that RoboMaker filled in."""
    return _ADDRESS.sub(lambda match: "robot" if match[1] == "ROBOT" else "simulation", text)
