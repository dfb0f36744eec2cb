"""Conversion of simulation jobs of RoboMaker, a discontinued service, to containers on AWS Batch."""

import re
import shlex
from dataclasses import replace
from typing import Any

from calibration.addons.rigel.batch_section import batch_section
from calibration.addons.rigel.containers import Surroundings, component_entry, named, pair_environment
from calibration.addons.rigel.document import RigelJob
from calibration.addons.rigel.fields import Fields, Notes, plain, text_at
from calibration.ci.execution.job import OUTPUT
from calibration.ci.execution.outcome import Glob

ROBOMAKER_PLUGIN = "RoboMakerPlugin"
_RIGEL_KEY_OF = {
    "max_job_duration_in_seconds": "simulation_duration",
    "robot_applications": "robot_application",
    "simulation_applications": "simulation_application",
    "exit_behaviour": "exit_behavior",
}
"""Keys that differ in Rigel."""
_KEY_OF_APPLICATION = {"simulation": "simulation_application", "robot": "robot_application"}
_ADDRESS_VARIABLE = re.compile(r"ROBOMAKER_(ROBOT|SIM)_APP_IP")
_MASTER_ADDRESS = re.compile(r"http://(robot|simulation):(\d+)/?")
_SUPER_WILDCARD = re.compile(r"\*\*(?=[^/])")
"""RoboMaker's ``**.log``, which matches files in all subfolders."""
_DATA_FOLDER = "/opt/robomaker/datasources"
"""RoboMaker's default folder of data sources."""
_ABOUT_SCENARIOS = "worlds come from a scenario set here: calibration schema scenario-set"
_ADVICE_OF_LOST_KEY = {
    "worldforge_exported_job": _ABOUT_SCENARIOS,
    "logging_config": "record a bag in a container of its own, with essential: false, into {output}",
}
_OF_AN_APPLICATION = {
    "stream_ui": "there is no screen: record what is to be seen into {output}",
    "world_configs": _ABOUT_SCENARIOS,
    "name": "a container is called robot or simulation",
    "requirements": "requirements on ROS messages belong to a bag: write them below requirements.hpl",
    "application_version": "an image has a tag",
    "use_default_tools": "there are none",
    "use_default_upload_configurations": "name the files to be copied under artifacts",
}
_ABOUT_PORTS = "the containers reach each other; nothing is reachable from outside"


def plain_key(key: str) -> str:
    """Normalise both spellings: ``s3Bucket`` and ``s3_bucket`` give ``s3_bucket``."""
    found = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", key).lower()
    return _RIGEL_KEY_OF.get(found, found)


def robomaker_job(
    job: RigelJob, around: Surroundings, region: str = ""
) -> tuple[dict[str, Any], dict[str, Any]] | None:
    """Convert a simulation job to an entry of ``simulation`` and the section ``aws-batch``; None without application.

    Args:
        job: of the plugin, or a request of ``CreateSimulationJob``.
        around: context of the conversion.
        region: region of the job, if known from elsewhere.

    Raises:
        InputError: a field has the wrong type.
    """
    notes = around.notes
    around = replace(around, replaced=_with_names)
    fields = Fields(job.fields, job.where, notes, plain_key)
    applications = {
        name: _Application(name, found, around)
        for name, key in _KEY_OF_APPLICATION.items()
        if (found := fields.fields(key))
    }
    if not applications:
        notes.lost(job.where or job.name, "it has neither a robot application nor a simulation application")
        return None
    containers = {name: application.entry for name, application in applications.items()}
    gpu = _distribute_compute(containers, fields.fields("compute"), notes)
    _data_sources(containers, fields.several("data_sources"), around)
    _set_order(containers)
    for application in applications.values():
        containers |= application.tools()
    fields.refuse(_ADVICE_OF_LOST_KEY)
    _note_failure_behavior(fields, notes)
    entry = {
        "containers": containers,
        "ros": "none",
        "backend": "aws-batch",
        "timeout": f"{fields.text('simulation_duration', '300')}s",
        "dataset": "{output}/dataset",
    }
    essential = "robot" if "robot" in applications else "simulation"
    notes.changed(
        fields.at("simulation_duration"),
        f"a time limit: reaching it is a failure. The job ends when the container {essential} ends, with exit code 0",
    )
    notes.changed(
        job.where or job.name, "it runs on AWS Batch (docs/aws-batch.md); with backend: docker on this machine"
    )
    if len(containers) > 1:
        notes.changed(
            job.where or job.name,
            "on AWS Batch all its containers have one address, so no two may listen on the same port. Their names lead "
            "there in containers that run as root, and always in ROS_MASTER_URI and ROS_HOSTNAME: else write 127.0.0.1",
        )
    notes.to_do(
        job.where or job.name,
        "let the collection write its dataset to {output}/dataset, which is copied from the container",
    )
    arns = [region_of(application.arn) for application in applications.values()]
    found_region = region or next(filter(None, arns), "")
    for secret in sorted({name for entry in containers.values() for name in entry.get("secrets", ())}):
        why = (
            f"put {secret} into Secrets Manager or Parameter Store, and its ARN here: its value never passes through us"
        )
        notes.to_do(f"aws-batch.secrets.{secret}", why)
    images = [str(container.get("image", "")) for container in containers.values()]
    section = batch_section(fields, found_region, gpu=gpu, images=[*images, around.image or ""], notes=notes)
    fields.rest()
    return entry, section


def region_of(arn: str) -> str:
    """Return the region in an ARN; empty if there is none."""
    parts = arn.split(":")
    return parts[3] if len(parts) > 5 and parts[0] == "arn" else ""


class _Application:
    def __init__(self, name: str, fields: Fields, around: Surroundings) -> None:
        self._name, self._fields, self._around = name, fields, around
        self._notes = around.notes
        self.arn = fields.text("application")
        self.entry = component_entry(self._convert_application(), around, fields.where)
        if self.arn:
            self.entry = {"image": "TODO", **self.entry}
            self._notes.to_do(fields.at("application"), f"write the image of {self.arn}: only RoboMaker knew it")
        if "command" not in self.entry:
            self._notes.to_do(fields.where, "write its command: on AWS Batch no image is asked for its own")
        if uploads := list(filter(None, map(self._convert_upload, fields.several("upload_configurations")))):
            self.entry["artifacts"] = uploads
        self._tools = fields.several("tools")
        fields.refuse(_OF_AN_APPLICATION)
        fields.rest("there is no such setting of a container here")

    def _convert_application(self) -> dict[str, Any]:
        """Convert the application to a component of ComposePlugin."""
        fields = self._fields
        launch = fields.fields("launch_config")
        environment = pair_environment(fields.items("environment"), fields.where)
        for key, value in launch.mapping("environment_variables").items():
            environment[key] = text_at(value, launch.where)
        own_address = {"ROBOMAKER_ROBOT_APP_IP": "robot", "ROBOMAKER_SIM_APP_IP": "simulation"}
        if own_address.get(environment.get("ROS_IP", "")) == self._name:
            del environment["ROS_IP"]  # the address is unknown before the containers start: the host name replaces it
            environment["ROS_HOSTNAME"] = self._name
        command = fields.take("command") or launch.take("command") or self._launch_command(launch)
        fields.refuse({"ports": _ABOUT_PORTS})
        launch.refuse({"port_forwarding_config": _ABOUT_PORTS, "stream_ui": _OF_AN_APPLICATION["stream_ui"]})
        launch.rest()
        envs = {key: value for key, value in environment.items() if key}
        return {"image": fields.take("ecr") or "", "command": command, "envs": envs}

    def _launch_command(self, launch: Fields) -> list[str]:
        """Return the command that RoboMaker derived from a package and a launch file."""
        package, file = launch.text("package_name"), launch.text("launch_file")
        if not (package and file):
            return []
        self._notes.changed(launch.at("launch_file"), "ROS 1 launches it; for ROS 2 write [ros2, launch, ...]")
        return ["roslaunch", package, file]

    def _convert_upload(self, upload: Fields) -> dict[str, Any] | None:
        where = upload.at("path")
        path = _SUPER_WILDCARD.sub("**/*", upload.plain("path"))
        upload.take("name")  # the subfolder of the output location, which is not used: every file keeps its own path
        if "ROLLING" in upload.text("upload_behavior"):
            self._notes.changed(upload.at("upload_behavior"), "everything is copied when the job has ended")
        upload.rest()
        if not path.startswith("/") or ".." in path.split("/") or Glob(path).source == "/":
            self._notes.lost(where, f"{path}: name an absolute path with a folder, under artifacts")
            return None
        if not path.startswith(f"{OUTPUT}/"):
            self._notes.to_do(where, f"AWS Batch brings out only what lies in {OUTPUT}: let it be written there")
        return {"path": path, "required": False}

    def tools(self) -> dict[str, dict[str, Any]]:
        """Return containers for the tools of the application, with its image, variables and data."""
        shared = {key: self.entry[key] for key in ("image", "environment", "secrets", "mounts") if key in self.entry}
        return {
            named(f"{self._name}-{tool.text('name', str(number))}"): shared | self._convert_tool(tool)
            for number, tool in enumerate(self._tools)
        }

    def _convert_tool(self, tool: Fields) -> dict[str, Any]:
        command = ["/bin/bash", "-c", tool.text("command")]  # as in RoboMaker
        entry = component_entry({"command": command}, self._around, tool.where)
        if tool.text("exit_behavior").upper() == "FAIL":
            entry["success"] = []  # any exit code of the tool fails the job
        else:
            entry["essential"] = False
            self._notes.changed(tool.where, "it is not started anew when it has ended: let its command do that")
        self._notes.changed(
            tool.where, "a container of its own: of the application it shares the network and {output}, no other files"
        )
        tool.refuse({"stream_ui": _OF_AN_APPLICATION["stream_ui"]})
        if tool.truth("stream_output_to_cloud_watch") is False:
            self._notes.changed(tool.at("stream_output_to_cloud_watch"), "the logs of all containers go to CloudWatch")
        tool.rest()
        entry["after"] = [self._name]
        return entry


def _distribute_compute(containers: dict[str, dict[str, Any]], compute: Fields, notes: Notes) -> bool:
    """Distribute processors and memory; return whether a GPU is needed."""
    units = compute.take("simulation_unit_limit")
    if isinstance(units, int | float) and not isinstance(units, bool) and units > 0:
        for entry in containers.values():
            share = units / len(containers)
            entry["cpus"] = int(share) if share == int(share) else share
            entry["memory"] = f"{round(share * 2048)}m"
        notes.changed(
            compute.at("simulation_unit_limit"),
            "of each unit one CPU and 2 GiB, shared out evenly: change it as needed",
        )
    elif units is not None:
        notes.lost(compute.at("simulation_unit_limit"), "a number was expected: give cpus and memory of each container")
    kind, limit = compute.text("compute_type"), compute.take("gpu_unit_limit")
    gpu = "GPU" in kind.upper() and limit != 0
    if gpu:
        chosen = next(name for name in _KEY_OF_APPLICATION if name in containers)
        containers[chosen]["gpus"] = True
        notes.changed(
            compute.at("compute_type"), f"the GPU is that of {chosen}; a container that needs one too gets another"
        )
    compute.rest()
    return gpu


def _data_sources(containers: dict[str, dict[str, Any]], sources: list[Fields], around: Surroundings) -> None:
    """Mount folders for the data sources: the user fills them, and their content is uploaded to S3."""
    for number, source in enumerate(sources):
        called, where = source.text("name", f"data-{number}"), source.where
        name, given = named(called), source.text("destination")
        target = plain(given, around.notes, where) or f"{_DATA_FOLDER}/{called}"
        bucket, keys = source.text("s3_bucket", "BUCKET"), source.texts("s3_keys")
        kind = source.text("type", "File")
        source.rest()
        if not target.startswith("/") or ":" in target:
            around.notes.lost(where, f"{target} is no place in a container: mount the folder by hand")
            continue
        for entry in containers.values():
            entry.setdefault("mounts", []).append(f"data/{name}:{target}")
        around.notes.to_do(where, _download_command(bucket, keys, kind, f"data/{name}"))


def _download_command(bucket: str, keys: list[str], kind: str, folder: str) -> str:
    """Return the command that downloads a data source to its folder."""
    first = shlex.quote(f"s3://{bucket}/{keys[0] if keys else ''}")
    verb = f"sync {first} {folder}" if kind.lower() == "prefix" else f"cp {first} {folder}/"
    more = f" (and {len(keys) - 1} more)" if len(keys) > 1 else ""
    unpack = ", and unpack it there" if kind.lower() == "archive" else ""
    return f"fill the folder before it is mounted: aws s3 {verb}{more}{unpack}"


def _note_failure_behavior(fields: Fields, notes: Notes) -> None:
    if fields.text("failure_behavior", "Fail").lower() == "continue":
        why = "a task ends with its job; artifacts and logs of a failed job are kept"
        notes.lost(fields.at("failure_behavior"), why)


def _set_order(containers: dict[str, dict[str, Any]]) -> None:
    """Set the start order (the ROS master first) and the container whose end ends the job (robot, or simulation)."""
    if len(containers) < 2:
        return
    containers["simulation"]["essential"] = False
    for one, other in (("robot", "simulation"), ("simulation", "robot")):
        found = _MASTER_ADDRESS.fullmatch(containers[other].get("environment", {}).get("ROS_MASTER_URI", ""))
        if found and found[1] == one:
            containers[one]["ready"] = {"port": int(found[2])}
            containers[other]["after"] = [one]
            return


def _with_names(text: str) -> str:
    """Replace RoboMaker's address variables by the names of the containers."""
    return _ADDRESS_VARIABLE.sub(lambda match: "robot" if match[1] == "ROBOT" else "simulation", text)
