"""RoboMaker simulation jobs, of Rigel's plugin or of the service itself, as jobs for AWS Batch."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml

from calibration.addons.rigel.conversion import Conversion, convert, written
from calibration.addons.rigel.document import read_rigelfile
from calibration.addons.rigel.robomaker import region_of
from calibration.base import InputError
from calibration.base.records import read
from calibration.ci.execution.job_check import check_jobs
from calibration.pipeline.configuration import read_configuration
from calibration.pipeline.containers import collection_job

from .conftest import noted

checks = pytest.importorskip("calibration.addons.aws_batch.checks")
definition = pytest.importorskip("calibration.addons.aws_batch.definition")
BatchSettings = pytest.importorskip("calibration.addons.aws_batch.settings").BatchSettings
Converted = Callable[[str], Conversion]
ARN = "arn:aws:robomaker:eu-west-1:123456789012:robot-application/arm/1"
ROLE = "arn:aws:iam::123456789012:role/robomaker"
RIGEL = """
jobs:
  run: {{plugin: r.aws.RoboMakerPlugin, with: {{{fields}}}}}
  build: {{plugin: r.BuildXPlugin, with: {{image: lab/robot}}}}
"""


@pytest.fixture
def of_rigel(converted: Converted) -> Callable[[str], Conversion]:
    """Convert the plugin's fields, with a robot application."""
    return lambda fields: converted(
        RIGEL.format(fields=f"robot_application: {{ecr: lab/robot, command: [run]}}, {fields}")
    )


@pytest.fixture
def of_aws(converted: Converted) -> Callable[..., Conversion]:
    """Convert a request for a robot application."""

    def conversion(application: dict[str, Any] | None = None, **fields: Any) -> Conversion:
        robot = {"application": ARN, "launchConfig": {"command": ["run"]}, **(application or {})}
        document = {"iamRole": ROLE, "maxJobDurationInSeconds": 600, "robotApplications": [robot], **fields}
        return converted(yaml.safe_dump(document))

    return conversion


def entry(conversion: Conversion) -> dict[str, Any]:
    [simulation] = conversion.simulations
    return simulation.entry


def robot(conversion: Conversion) -> dict[str, Any]:
    found: dict[str, Any] = entry(conversion)["containers"]["robot"]
    return found


# --- Rigel's plugin


def test_a_robot_application_alone(converted: Converted) -> None:
    fields = (
        "iam_role: x, compute: {a: 1}, speed: 2, robot_application: {ecr: lab/robot, command: [run], ports: [], "
        "colour: red, environment: [A=b=c, ROS_IP=1.2.3.4]}"
    )
    conversion = converted(RIGEL.format(fields=fields))
    assert entry(conversion) == {
        "containers": {"robot": {"command": ["run"], "environment": {"A": "b=c", "ROS_IP": "1.2.3.4"}}},
        "ros": "none",
        "backend": "aws-batch",
        "timeout": "300s",
        "dataset": "{output}/dataset",
    }
    notes = noted(conversion)
    assert notes["jobs.run.with.compute.a"] == notes["jobs.run.with.speed"] == "there is no such setting here"
    assert notes["jobs.run.with.robot_application.colour"] == "there is no such setting of a container here"
    assert "have one address" not in str(list(conversion.notes))


def test_two_applications_without_a_master_between_them(converted: Converted) -> None:
    fields = (
        "robot_application: {ecr: a, command: [x]}, simulation_application: {ecr: b, command: [y], world_configs: [z]}"
    )
    conversion = converted(RIGEL.format(fields=fields))
    assert entry(conversion)["containers"] == {
        "simulation": {"image": "b", "command": ["y"], "essential": False},
        "robot": {"image": "a", "command": ["x"]},
    }
    assert any("have one address" in note.text for note in conversion.notes)


@pytest.mark.parametrize(("master", "other"), [("robot", "simulation"), ("simulation", "robot")])
def test_whoever_runs_the_master_comes_first(converted: Converted, master: str, other: str) -> None:
    address = {"robot": "ROBOT", "simulation": "SIM"}[master]
    environment = f"environment: ['ROS_MASTER_URI=http://ROBOMAKER_{address}_APP_IP:11311']"
    fields = ", ".join(
        f"{name}_application: {{ecr: a, command: [x], {environment}}}" for name in ("robot", "simulation")
    )
    containers = entry(converted(RIGEL.format(fields=fields)))["containers"]
    assert containers[master]["ready"] == {"port": 11311}
    assert containers[other]["after"] == [master]
    assert "ready" not in containers[other]
    assert "after" not in containers[master]


def test_no_application_at_all(converted: Converted) -> None:
    conversion = converted(RIGEL.format(fields="iam_role: x"))
    assert conversion.simulations == []
    assert conversion.batch == {}
    assert "neither a robot application nor a simulation" in noted(conversion)["jobs.run.with"]


def test_a_secret_of_the_environment_of_an_application_is_not_copied(converted: Converted) -> None:
    fields = "robot_application: {ecr: a, command: [x], environment: ['DB_PASSWORD=pl4nted', HOST=db]}"
    conversion = converted(RIGEL.format(fields=fields))
    assert robot(conversion)["secrets"] == ["DB_PASSWORD"]
    assert "its ARN here" in noted(conversion)["aws-batch.secrets.DB_PASSWORD"]
    assert "pl4nted" not in str(conversion)


@pytest.mark.parametrize(
    ("fields", "section"),
    [
        (f"iam_role: '{ROLE}'", {"job-role": ROLE, "execution-role": "arn:aws:iam::123456789012:role/TODO"}),
        ("iam_role: '{{ vars.ROLE }}'", {"job-role": "${ROLE}"}),
        ("iam_role: x", {"job-role": "arn:aws:iam::000000000000:role/TODO"}),
        ("output_location: lab-logs", {"bucket": "lab-logs"}),
        ("output_location: s3://lab-logs/a/b/", {"bucket": "lab-logs", "prefix": "a/b"}),
        ("output_location: 'Lab Logs'", {"bucket": "todo"}),
        ("output_location: 'lab/..'", {"bucket": "lab"}),
        ("speed: 1", {"bucket": "todo", "region": "xx-todo-1", "queue": "TODO", "tools-image": "TODO"}),
        ("vpc_config: {subnets: [s], security_groups: [g], assign_public_ip: True}", {"public-ip": True}),
        ("compute: {compute_type: GPU_AND_CPU, gpu_unit_limit: 1}", {"platform": "ec2"}),
    ],
)
def test_the_section_of_aws_batch(of_rigel: Callable[[str], Conversion], fields: str, section: dict[str, Any]) -> None:
    found = of_rigel(fields).batch
    assert section.items() <= found.items()
    assert set(found) - set(section) <= {"region", "queue", "bucket", "tools-image", "job-role", "execution-role"}
    if "${" not in str(found):
        assert isinstance(read(BatchSettings, found, "converted"), BatchSettings)


@pytest.mark.parametrize(
    ("fields", "where", "said"),
    [
        ("vpc_config: {subnets: [a, b]}", "jobs.run.with.vpc_config.subnets", "set its subnets to a, b"),
        ("vpc_config: {security_groups: [g]}", "jobs.run.with.vpc_config.security_groups", "security groups to g"),
        ("vpc_config: {x: 1}", "jobs.run.with.vpc_config.x", "no such setting"),
        (
            "compute: {compute_type: GPU_AND_CPU}, vpc_config: {assign_public_ip: True}",
            "jobs.run.with.vpc_config.assign_public_ip", "on EC2 the subnets say",
        ),
        ("compute: {compute_type: GPU_AND_CPU}", "jobs.run.with.compute.compute_type", "the GPU is that of robot"),
        ("compute: {simulation_unit_limit: many}", "jobs.run.with.compute.simulation_unit_limit", "a number was"),
        ("iam_role: x", "jobs.run.with.iam_role", "x is not the ARN of a role"),
        (f"iam_role: '{ROLE}'", "jobs.run.with.iam_role", "calibration aws-policy --for trust"),
        ("speed: 1", "aws-batch.job-role", "there is none"),
        ("speed: 1", "aws-batch.region", "unknown: set it"),
        ("speed: 1", "aws-batch.bucket", "it names none"),
        ("speed: 1", "aws-batch.queue", "whose compute environment is Fargate"),
        ("compute: {compute_type: GPU_AND_CPU}", "aws-batch.queue", "EC2 instances with a GPU"),
        ("output_location: 'A B'", "jobs.run.with.output_location", "A B is no name of a bucket"),
        ("output_location: 'lab/..'", "jobs.run.with.output_location", ".. is no prefix"),
        ("worldforge_exported_job: x", "jobs.run.with.worldforge_exported_job", "scenario set"),
        ("simulation_duration: 60", "jobs.run.with.simulation_duration", "reaching it is a failure"),
        (
            "data_sources: [{name: d, s3_bucket: b, s3_keys: ['a b'], colour: red}]",
            "jobs.run.with.data_sources.0", "aws s3 cp 's3://b/a b' data/d/",
        ),
        ("data_sources: [{name: d, colour: red}]", "jobs.run.with.data_sources.0.colour", "no such setting"),
        ("data_sources: [{name: d, destination: a}]", "jobs.run.with.data_sources.0", "a is no place in a container"),
    ],
)  # fmt: skip
def test_what_is_said(of_rigel: Callable[[str], Conversion], fields: str, where: str, said: str) -> None:
    assert said in noted(of_rigel(fields))[where]


def test_units_are_shared_out(converted: Converted) -> None:
    fields = (
        "compute: {simulation_unit_limit: 3}, robot_application: {ecr: a, command: [x]}, "
        "simulation_application: {ecr: b, command: [y]}"
    )
    for container in entry(converted(RIGEL.format(fields=fields)))["containers"].values():
        assert (container["cpus"], container["memory"]) == (1.5, "3072m")


def test_the_gpu_goes_to_the_simulation(converted: Converted) -> None:
    fields = (
        "compute: {compute_type: GPU_AND_CPU}, robot_application: {ecr: a, command: [x]}, "
        "simulation_application: {ecr: b, command: [y]}"
    )
    conversion = converted(RIGEL.format(fields=fields))
    assert [c.get("gpus", False) for c in entry(conversion)["containers"].values()] == [True, False]
    assert "execution-role" not in conversion.batch


def test_no_gpu_where_its_limit_is_0(of_rigel: Callable[[str], Conversion]) -> None:
    conversion = of_rigel("compute: {compute_type: GPU_AND_CPU, gpu_unit_limit: 0}")
    assert "gpus" not in robot(conversion)
    assert "platform" not in conversion.batch


def test_the_region_is_the_providers(converted: Converted) -> None:
    text = RIGEL.format(fields="robot_application: {ecr: a, command: [x]}")
    provider = "providers: {aws: {provider: r.AWSProvider, with: {region_name: us-east-2, services: [robomaker]}}}\n"
    assert converted(provider + text).batch["region"] == "us-east-2"
    conversion = converted(provider.replace("us-east-2", "here") + text)
    assert conversion.batch["region"] == "xx-todo-1"
    assert noted(conversion)["aws-batch.region"] == "here is not a region: set it"


def test_the_account_is_that_of_an_image(converted: Converted) -> None:
    image = "123456789012.dkr.ecr.eu-west-1.amazonaws.com/robot:1"
    fields = f"robot_application: {{ecr: '{image}', command: [x]}}"
    assert converted(RIGEL.format(fields=fields)).batch["job-role"] == "arn:aws:iam::123456789012:role/TODO"


def test_two_jobs_have_one_section(converted: Converted) -> None:
    application = "robot_application: {ecr: a, command: [x]}"
    jobs = {
        "a": f"{application}, iam_role: '{ROLE}', output_location: one, vpc_config: {{assign_public_ip: True}}",
        "b": f"{application}, iam_role: '{ROLE}-b', output_location: two, compute: {{compute_type: GPU_AND_CPU}}",
        "c": f"{application}, output_location: one",
    }
    listed = ", ".join(f"{name}: {{plugin: RoboMakerPlugin, with: {{{fields}}}}}" for name, fields in jobs.items())
    conversion = converted(f"jobs: {{{listed}}}")
    assert [simulation.name for simulation in conversion.simulations] == ["a", "b", "c"]
    assert conversion.batch_origin == "job a"
    assert conversion.batch["bucket"] == "one"
    assert conversion.batch["job-role"] == ROLE
    assert "public-ip" not in conversion.batch  # there is none on EC2
    assert isinstance(read(BatchSettings, conversion.batch, "converted"), BatchSettings)
    said = [note.text for note in conversion.notes if note.where == "jobs.b.with"]
    assert "there is one section aws-batch, and its bucket is one, not two" in said
    assert any("job-role is" in text for text in said)
    assert any("one queue, of EC2" in text for text in said)
    assert not [note for note in conversion.notes if note.where == "jobs.c.with" and "section" in note.text]


def test_what_the_first_job_does_not_know_the_second_may(converted: Converted) -> None:
    application = "robot_application: {ecr: a, command: [x]}"
    text = (
        f"jobs: {{a: {{plugin: RoboMakerPlugin, with: {{{application}}}}}, "
        f"b: {{plugin: RoboMakerPlugin, with: {{{application}, iam_role: '{ROLE}', output_location: lab}}}}}}"
    )
    assert converted(text).batch.items() >= {"job-role": ROLE, "bucket": "lab"}.items()


# --- requests of the service


def test_tools_are_containers(of_aws: Callable[..., Conversion]) -> None:
    tools = [
        {"name": "Record", "command": "rosbag record -a | tee log", "exitBehavior": "FAIL"},
        {"command": "rviz", "streamUI": True, "streamOutputToCloudWatch": False, "x": 1},
    ]
    launch = {"command": ["run"], "environmentVariables": {"A": "1"}, "streamUI": True, "x": 1}
    conversion = of_aws({"tools": tools, "launchConfig": launch})
    assert entry(conversion)["containers"] == {
        "robot": {"image": "TODO", "command": ["run"], "environment": {"A": "1"}},
        "robot-record": {
            "image": "TODO",
            "environment": {"A": "1"},
            "command": ["/bin/bash", "-c", "rosbag record -a | tee log"],
            "success": [],
            "after": ["robot"],
        },
        "robot-1": {
            "image": "TODO",
            "environment": {"A": "1"},
            "command": ["/bin/bash", "-c", "rviz"],
            "essential": False,
            "after": ["robot"],
        },
    }
    notes = noted(conversion)
    assert notes["robotApplications.0.tools.1.x"] == "there is no such setting here"
    assert notes["robotApplications.0.launchConfig.x"] == "there is no such setting here"
    assert "no screen" in notes["robotApplications.0.tools.1.streamUI"]
    assert "no screen" in notes["robotApplications.0.launchConfig.streamUI"]
    assert "CloudWatch" in notes["robotApplications.0.tools.1.streamOutputToCloudWatch"]


def test_uploads_are_artifacts(of_aws: Callable[..., Conversion]) -> None:
    paths = ["/calibration/output/*.csv", "/root/.ros/**.bag", "relative", "/a/../b", "/**.log", "/var/**/x"]
    uploads = [{"name": "n", "path": path, "uploadBehavior": "UPLOAD_ON_TERMINATE"} for path in paths]
    conversion = of_aws({"uploadConfigurations": [{**uploads[0], "x": 1}, *uploads[1:]]})
    found = [artifact["path"] for artifact in robot(conversion)["artifacts"]]
    assert found == ["/calibration/output/*.csv", "/root/.ros/**/*.bag", "/var/**/x"]
    notes = noted(conversion)
    assert notes["robotApplications.0.uploadConfigurations.0.x"] == "there is no such setting here"
    assert (
        "brings out only what lies in /calibration/output" in notes["robotApplications.0.uploadConfigurations.1.path"]
    )
    for number in (2, 3, 4):
        assert "name an absolute path" in notes[f"robotApplications.0.uploadConfigurations.{number}.path"]
    assert "robotApplications.0.uploadConfigurations.0.path" not in notes


@pytest.mark.parametrize(
    ("source", "mount", "said"),
    [
        (
            {"name": "My_Data", "s3Bucket": "b", "s3Keys": ["k"]},
            "data/my-data:/opt/robomaker/datasources/My_Data", "aws s3 cp s3://b/k data/my-data/",
        ),
        (
            {"name": "d", "s3Bucket": "b", "s3Keys": ["p/"], "type": "Prefix", "destination": "/d"},
            "data/d:/d", "aws s3 sync s3://b/p/ data/d",
        ),
        (
            {"name": "d", "s3Bucket": "b", "s3Keys": ["a", "b"], "type": "Archive", "destination": "/d"},
            "data/d:/d", "aws s3 cp s3://b/a data/d/ (and 1 more), and unpack it there",
        ),
        ({"destination": "/d"}, "data/data-0:/d", "aws s3 cp s3://BUCKET/ data/data-0/"),
    ],
)  # fmt: skip
def test_data_sources_are_folders(
    of_aws: Callable[..., Conversion], source: dict[str, Any], mount: str, said: str
) -> None:
    conversion = of_aws(dataSources=[source])
    assert robot(conversion)["mounts"] == [mount]
    assert noted(conversion)["dataSources.0"].endswith(said)


def test_what_the_service_launched(of_aws: Callable[..., Conversion]) -> None:
    conversion = of_aws({"launchConfig": {"packageName": "p", "launchFile": "f.launch"}})
    assert robot(conversion)["command"] == ["roslaunch", "p", "f.launch"]
    assert "ros2, launch" in noted(conversion)["robotApplications.0.launchConfig.launchFile"]
    conversion = of_aws({"launchConfig": {"packageName": "p"}})
    assert "command" not in robot(conversion)
    assert "write its command" in noted(conversion)["robotApplications.0"]


def test_tags_and_output(of_aws: Callable[..., Conversion]) -> None:
    tags = {f"k{i}": i for i in range(31)} | {"ci.calibration.run": "x", "aws:a": "x"}
    conversion = of_aws(tags=tags, outputLocation={"s3Bucket": "lab", "s3Prefix": "/a/", "x": 1})
    assert len(conversion.batch["tags"]) == 30
    assert conversion.batch["tags"]["k3"] == "3"
    assert (conversion.batch["bucket"], conversion.batch["prefix"]) == ("lab", "a")
    assert {"tags.k9", "tags.ci.calibration.run", "tags.aws:a", "outputLocation.x"} <= noted(conversion).keys()
    assert isinstance(read(BatchSettings, conversion.batch, "converted"), BatchSettings)


@pytest.mark.parametrize(
    ("field", "value", "said"),
    [
        ("failureBehavior", "Continue", "a task ends with its job"),
        ("loggingConfig", {"recordAllRosTopics": True}, "record a bag"),
        ("clientRequestToken", "x", "a run has a name"),
        ("colour", "red", "no such setting"),
    ],
)
def test_what_has_no_place(of_aws: Callable[..., Conversion], field: str, value: object, said: str) -> None:
    assert said in noted(of_aws(**{field: value}))[field]


def test_failing_as_usual_is_nothing_to_tell(of_aws: Callable[..., Conversion]) -> None:
    assert "failureBehavior" not in noted(of_aws(failureBehavior="Fail"))


def test_the_region_is_that_of_an_application(of_aws: Callable[..., Conversion]) -> None:
    assert of_aws().batch["region"] == "eu-west-1"
    assert of_aws({"application": "arm"}).batch["region"] == "xx-todo-1"
    assert region_of(ARN) == "eu-west-1"


def test_a_batch_of_jobs(converted: Converted) -> None:
    def request(name: str) -> dict[str, Any]:
        application = {"application": ARN, "launchConfig": {"command": [name]}}
        return {"iamRole": ROLE, "maxJobDurationInSeconds": 60, "robotApplications": [application], "tags": {name: "x"}}

    document = {
        "createSimulationJobRequests": [request("a"), request("b")],
        "batchPolicy": {"timeoutInSeconds": 7200, "maxConcurrency": 4, "x": 1},
        "tags": {"team": "arm"},
        "clientRequestToken": "t",
    }
    conversion = converted(yaml.safe_dump(document))
    assert [each.name for each in conversion.simulations] == ["simulation-1", "simulation-2"]
    assert [each.entry["containers"]["robot"]["command"] for each in conversion.simulations] == [["a"], ["b"]]
    assert conversion.batch["deadline"] == "7200s"
    assert conversion.batch["tags"] == {"team": "arm", "a": "x"}
    notes = noted(conversion)
    assert "maximum of vCPUs" in notes["createSimulationJobRequests.0.batchPolicy.maxConcurrency"]
    assert notes["createSimulationJobRequests.0.batchPolicy.x"] == "there is no such setting here"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("robotApplications: 3", "a mapping was expected"),
        ("robotApplications: [{application: a}, {application: b}]", "a mapping was expected"),
        ("createSimulationJobRequests: [3]", "createSimulationJobRequests.0: found 3, a mapping was expected"),
        ("robotApplications: [{application: a, tools: [3]}]", "robotApplications.0.tools.0: found 3"),
        ("robotApplications: [{application: a}]\nvpcConfig: {assignPublicIp: 3}", "true or false was expected"),
    ],
)
def test_of_the_wrong_kind(converted: Converted, text: str, said: str) -> None:
    with pytest.raises(InputError, match="Rigelfile: ") as caught:
        converted(text)
    assert said in str(caught.value)


def test_nothing_to_run(converted: Converted) -> None:
    assert converted("createSimulationJobRequests: []").is_empty


@pytest.mark.parametrize("name", ["robomaker", "simulation-job"])
def test_what_is_left_to_do_makes_a_job_that_aws_batch_takes(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As it is, only what is named as to do stands in the way."""
    for variable, value in {"TOKEN": "x", "ECR": "a.example.org"}.items():
        monkeypatch.setenv(variable, value)
    text = written(convert(read_rigelfile(Path(__file__).with_name("rigelfiles") / f"{name}.rigel")), name)
    document = yaml.safe_load(text)
    document["aws-batch"]["secrets"] = {"TOKEN": "arn:aws:secretsmanager:eu-west-1:123456789012:secret:t"}
    for folder in ("meshes", "maps"):
        (tmp_path / "data" / folder).mkdir(parents=True)
    (tmp_path / "calibration.yml").write_text(
        yaml.safe_dump(document | {"systems": {"s": {"dataset": "d"}}}).replace("/root/.ros/", "/calibration/output/")
    )
    configuration = read_configuration(tmp_path / "calibration.yml")
    [simulation] = configuration.simulations
    settings = configuration.sections.of("aws-batch")
    job = collection_job(simulation.applications.with_image("a"), "collection", "s", 1)
    check_jobs([job])
    checks.check_for_batch([job], settings)
    assert definition.job_definition(definition.shape_of(job, settings), settings)["type"] == "container"
