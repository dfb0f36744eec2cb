# ruff: noqa: E501 (Rigelfiles on one line)
from collections.abc import Callable
from pathlib import Path

import pytest
import yaml

from calibration.addons.rigel.conversion import Conversion, convert
from calibration.addons.rigel.document import read_rigelfile
from calibration.addons.rigel.fields import variable_name
from calibration.base import InputError
from tests.addons.rigel.conftest import noted, software

Converted = Callable[[str], Conversion]
COMPOSE = """
application: {{distro: {distro}}}
jobs:
  calibrate:
    plugin: rigel.plugins.core.ComposePlugin
    with:
      components:
        - {{name: c, image: other, artifacts: [/t.csv], {fields}}}
{rest}
"""


def compose(fields: str, distro: str = "noetic", rest: str = "") -> str:
    return COMPOSE.format(fields=fields, distro=distro, rest=rest)


@pytest.mark.parametrize(
    ("fields", "key", "value"),
    [
        ("command: run it", "command", ["run", "it"]),
        ("command: run 'it", "command", ["bash", "-c", "run 'it"]),
        ("command: [run, 3, true]", "command", ["run", "3", "true"]),
        ("command: [run, '{x}', '${HOME}']", "command", ["run", "{{x}}", "${{HOME}}"]),
        ("command: [run, '{{ vars.NAME }}', '{{ NAME }}']", "command", ["run", "${NAME}", "${NAME}"]),
        ("entrypoint: /bin/sh -c", "entrypoint", ["/bin/sh", "-c"]),
        ("workdir: /x", "working-directory", "/x"),
        ("user: 1000", "user", "1000"),
        ("memory: 2g", "memory", "2g"),
        ("cpus: 1.5", "cpus", 1.5),
        ("devices: ['/dev/video0:/dev/video0']", "devices", ["/dev/video0"]),
        ("gpus: all", "gpus", True),
        ("privileged: True", "privileged", True),
        ("envs: {A: 1, B: true, C: null, D: 'x {{ vars.E }}'}", "environment",
         {"A": "1", "B": "true", "C": "", "D": "x ${E}"}),
        ("envs: {TOKEN: '{{ vars.TOKEN }}'}", "secrets", ["TOKEN"]),
        ("envs: {TOKEN: pl4nted}", "secrets", ["TOKEN"]),
        ("volumes: ['a:/b:ro', ['c', '/d:ro']]", "mounts", ["a:/b", "c:/d"]),
        ("volumes: ['a:/b']", "mounts", [{"source": "a", "target": "/b", "writable": True}]),
        ("volumes: ['/var/run/docker.sock:/var/run/docker.sock']", "docker-socket", True),
        ("command: x", "image", "other"),
        ("command: x", "ros", 1),
    ],
)  # fmt: skip
def test_fields_of_a_component(converted: Converted, fields: str, key: str, value: object) -> None:
    conversion = converted(compose(fields))
    assert software(conversion)[key] == value
    assert "pl4nted" not in str(conversion.systems)


@pytest.mark.parametrize(
    ("fields", "where", "text"),
    [
        ("envs: {A_TOKEN: '{{ vars.B_TOKEN }}'}", "envs.A_TOKEN", "the variable A_TOKEN is passed on"),
        ("envs: {A_TOKEN: 'x{{ vars.B_TOKEN }}'}", "envs.A_TOKEN", "a secret, which is not copied"),
        ("shm_size: 1g", "shm_size", "there is no such setting"),
        ("cpus: two", "cpus", "a number was expected"),
        ("volumes: [/only]", "volumes.0", "/only is not HERE:THERE"),
        ("volumes: ['/tmp/.X11-unix:/tmp/.X11-unix']", "volumes.0", "no X server"),
        ("envs: {URL: 'https://x?t={{ vars.MY_TOKEN }}'}", "envs.URL", "a secret in a longer text"),
        ("command: [run, '{{ data.world }}']", "command", "data.world is none of the noise matrix"),
        ("command: [run, '{{ foo.bar }}']", "command.1", "{{ foo.bar }} is no reference"),
        ("command: [run, '{{ vars.MY_TOKEN }}']", "command", "no shell reads $MY_TOKEN here"),
        ("volumes: ['${HERE}/a:/b:ro']", "volumes.0", "${HERE} is now read from the environment"),
    ],
)
def test_what_is_said_of_a_component(converted: Converted, fields: str, where: str, text: str) -> None:
    notes = converted(compose(fields)).notes
    prefixes = ("jobs.calibrate.with.components.c", "jobs.calibrate.with.components.0")
    assert any(note.where in [f"{p}.{where}" for p in prefixes] and text in note.text for note in notes), list(notes)


def test_a_command_for_a_shell_is_given_its_secret_as_a_variable(converted: Converted) -> None:
    conversion = converted(compose("command: [bash, -c, 'login {{ vars.MY_TOKEN }} glpat-pl4ntedpl4ntedpl4nted']"))
    assert software(conversion)["command"] == ["bash", "-c", "login $MY_TOKEN $SECRET_1"]
    assert software(conversion)["secrets"] == ["MY_TOKEN", "SECRET_1"]


@pytest.mark.parametrize(("distro", "version"), [("noetic", 1), ("melodic", 1), ("humble", 2), ("jazzy", 2)])
def test_ros_by_its_distribution(converted: Converted, distro: str, version: int) -> None:
    assert software(converted(compose("command: x", distro)))["ros"] == version


def test_a_calibration_without_a_command_has_one_to_write(converted: Converted) -> None:
    conversion = converted(compose("user: x"))
    assert software(conversion)["command"] == ["TODO"]
    assert "write it for TODO" in noted(conversion)["jobs.calibrate.with.components"]


MATRICES = """
sequences:
  one: {{stages: [{{matrix: {first}, parallel: [{{jobs: [calibrate]}}]}}]}}
  two: {{stages: [{{matrix: {second}, parallel: [{{jobs: [calibrate]}}]}}]}}
"""


@pytest.mark.parametrize(
    ("first", "second", "noise", "note"),
    [
        ("{trans_noise: [0, 0.5], rot: 1}", "{}", {"translation": [0, 0.5], "rotation": [1]}, None),
        ("{trans: [0, 1]}", "{trans: [0, 1]}", {"translation": [0, 1]}, None),
        ("{trans: [0, 1]}", "{trans: [1, 2]}", {"translation": [0, 1, 2]}, "all stages together"),
        ("{trans: [0]}", "{rot: [1]}", {"translation": [0], "rotation": [1]}, "all stages together"),
        ("{trans: [1e-3, '2', -1, x, true, .nan]}", "{}", {"translation": [0.001, 2]}, "'-1' is no noise"),
        ("{world: [a]}", "{}", {}, "a matrix is of translation and rotation noise"),
        ("{seed: [1, 2]}", "{}", {}, "and of seeds: noise.seeds"),
    ],
)
def test_noise(converted: Converted, first: str, second: str, noise: object, note: str | None) -> None:
    conversion = converted(compose("command: x", rest=MATRICES.format(first=first, second=second)))
    assert conversion.noise == noise
    assert (note is None) or any(note in text.text for text in conversion.notes)
    assert (note is not None) or not any("matrix" in text.where for text in conversion.notes)


JUDGES = """
  other: {plugin: x.ComposePlugin, with: {components: [{name: d, command: y, artifacts: [/u.csv]}]}}
  judge:
    plugin: file_introspection.FileIntrospection
    with: {introspection_target_columns: [{RMS: {validation_max: 2}}]}
"""


@pytest.mark.parametrize(
    ("stages", "judged"),
    [
        ("[{jobs: [calibrate, judge, other]}]", [0]),
        ("[{jobs: [calibrate, other, judge]}]", [1]),
        ("[{jobs: [other], dependencies: [calibrate]}, {jobs: [other, judge]}]", [1]),
        ("[{jobs: [calibrate, judge]}, {jobs: [other, judge]}]", [0, 1]),
        ("[{jobs: [judge]}]", []),
    ],
)
def test_a_judge_belongs_to_the_job_before_it(converted: Converted, stages: str, judged: list[int]) -> None:
    text = compose("command: x", rest=f"{JUDGES}sequences: {{s: {{stages: {stages}}}}}")
    conversion = converted(text)
    rules = [{"column": "RMS", "every-max": 2}]
    assert [system.entry.get("rules") for system in conversion.systems] == [
        rules if i in judged else None for i in (0, 1)
    ]
    assert ("no job before it makes its table" in str(conversion.notes.found)) is (judged == [])


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ("{columns_to_verify: [RMS]}", "an earlier form of the file introspection"),
        (
            "{introspection_target_columns: [{RMS: {acceptable_max: '{{ data.x }}', value_row: a}}]}",
            "only Rigel fills in",
        ),
        ("{introspection_target_columns: []}", "there is no rule"),
        ("{introspection_target_columns: [{RMS: {bound: 3}}]}", "there is no key 'bound'"),
        ("{file: /x/v.csv, introspection_target_columns: [{R: {validation_max: 3}}]}", "v.csv is no artifact"),
    ],
)
def test_rules_that_are_not_carried_over_are_named(converted: Converted, settings: str, said: str) -> None:
    rest = f"  judge: {{plugin: file.FileIntrospection, with: {settings}}}"
    assert said in str(converted(compose("command: x", rest=rest)).notes.found)


def test_the_first_name_of_a_job_that_is_always_overridden(converted: Converted) -> None:
    rest = """
sequences:
  s:
    stages:
      - jobs: [{name: calibrate, with: {timeout: 5}}, {name: calibrate, with: {timeout: 7}}]
      - {name: calibrate, jobs: [{name: calibrate, with: {timeout: 5}}, {name: nobody}]}
"""
    conversion = converted(compose("command: x", rest=rest))
    found = [(system.name, system.entry["software"]["timeout"]) for system in conversion.systems]
    assert found == [("calibrate", "5s"), ("calibrate-3", "7s")] or found == [
        ("calibrate", "5s"),
        ("calibrate-2", "7s"),
    ]
    assert "there is no job 'nobody'" in noted(conversion)["sequences.s.stages.1"]


def test_several_containers_that_bring_out_a_dataset_are_a_simulation(converted: Converted) -> None:
    conversion = converted("""
jobs:
  collect:
    plugin: x.ComposePlugin
    with:
      timeout: 60
      extra: 1
      components:
        - {name: A B, image: i}
        - {name: a-b, image: i, artifacts: [/d/dataset.json, /d/log.txt]}
  demo: {plugin: x.ComposePlugin, with: {components: [{name: a, image: i}]}}
""")
    [simulation] = conversion.simulations
    assert simulation.entry == {
        "containers": {
            "a-b": {"image": "i", "essential": False},
            "a-b-2": {"image": "i", "artifacts": ["/d/log.txt"]},
        },
        "ros": 1,
        "timeout": "60s",
        "dataset": "/d",
    }
    assert noted(conversion)["jobs.collect.with.extra"] == "there is no such setting here"
    assert "neither a table nor a dataset" in noted(conversion)["jobs.demo.with"]


IMAGE = """
application: {{distro: noetic}}
providers: {providers}
jobs:
  dockerfile: {{plugin: r.DockerfilePlugin, with: {{compiler: {{name: colcon, extra: 1}}, {fields}}}}}
  build: {{plugin: r.BuildXPlugin, with: {{image: '{image}', {build}}}}}
"""


def image(fields: str = "", image: str = "lab/robot", build: str = "", providers: str = "{}") -> str:
    return IMAGE.format(fields=fields, image=image, build=build, providers=providers)


@pytest.mark.parametrize(
    ("text", "key", "value"),
    [
        (image(image="host:5000/robot"), "name", "host:5000/robot"),
        (image(image="host:5000/robot:v1"), "tags", ["v1", "latest"]),
        (image(build="tags: [a, a]"), "tags", ["a", "latest"]),
        (image(build="tags: [a, latest], force_tag_latest: false"), "tags", ["a"]),
        (image(build="push: 'True'"), "push", True),
        (image("docker_run: ['a ${X} $Y {{ vars.Z }}', {command: b}]"), "commands", ["a ${X-} $Y ${Z}", "b"]),
        (image("docker_run: ['curl -u x:{{ vars.MY_TOKEN }} y']"), "commands", ["curl -u x:$(cat /run/secrets/MY_TOKEN) y"]),
        (image("docker_run: ['curl {{ vars.MY_TOKEN }}']"), "secrets", [{"id": "MY_TOKEN", "variable": "MY_TOKEN"}]),
        (image("apt: [' a ', a, b=1]"), "apt", ["a", "b=1"]),
        (image("env: [{name: A, value: 3}]"), "environment", {"A": "3"}),
        (image("command: [a, b]"), "command", ["a", "b"]),
        (image("entrypoint: [a, '']"), "entrypoint", ["a", ""]),
        (image(providers="{p: {provider: x.SSHProvider}}"), "ssh", True),
        (
            image(image="ghcr.io/a/b", providers="{p: {provider: x.ContainerRegistryProvider, with: {server: 'https://ghcr.io/v2/', username: u, password: '{{ vars.PW }}'}}}"),
            "registry", {"username": "u", "password-variable": "PW"},
        ),
        (
            image(providers="{p: {provider: x.ContainerRegistryProvider, with: {server: '', password: 'pl4nted {{ vars.x }}'}}}"),
            "registry", {"username": "TODO", "password-variable": "REGISTRY_PASSWORD"},
        ),
        (
            image(image="1.dkr.ecr.x.amazonaws.com/r", providers="{p: {provider: x.AWSProvider, with: {services: [ecr]}}}"),
            "registry", {"kind": "ecr"},
        ),
    ],
)  # fmt: skip
def test_fields_of_an_image(converted: Converted, text: str, key: str, value: object) -> None:
    conversion = converted(text)
    assert conversion.image[key] == value
    assert "pl4nted" not in str(conversion)


@pytest.mark.parametrize(
    ("text", "where", "said"),
    [
        (image(), "jobs.dockerfile.with.compiler.extra", "no such setting"),
        (image("ssh: x"), "jobs.dockerfile.with.ssh", "no such setting"),
        (image("docker_run: [{command: a, user: b}]"), "jobs.dockerfile.with.docker_run.0.user", "no such setting"),
        (image("env: [{name: A, value: $B}]"), "jobs.dockerfile.with.env.0", "taken literally"),
        (image("env: [{name: A_TOKEN, value: x}]"), "jobs.dockerfile.with.env.0", "a secret in the image's environment"),
        (image("entrypoint: ['login {{ vars.A_TOKEN }}']"), "jobs.dockerfile.with.entrypoint", "a secret would be in"),
        (image(build="buildargs: {A: 1}"), "jobs.build.with.buildargs.A", "has no arguments"),
        (image(build="platform: x"), "jobs.build.with.platform", "no such setting"),
        (image(providers="{p: {provider: x.Other}}"), "providers.p", "there is no provider like x.Other"),
        (
            image(providers="{p: {provider: x.AWSProvider, with: {region_name: x, services: [robomaker], role: y}}}"),
            "providers.p.with.role", "no such setting",
        ),
        (
            image(providers="{p: {provider: x.ContainerRegistryProvider, with: {server: quay.io}}}"),
            "providers.p.with", "where the image is pushed: docker.io, not quay.io",
        ),
    ],
)  # fmt: skip
def test_what_is_said_of_an_image(converted: Converted, text: str, where: str, said: str) -> None:
    assert said in noted(converted(text))[where]


def test_of_several_images_that_which_is_pushed(converted: Converted) -> None:
    conversion = converted("""
jobs:
  here: {plugin: r.BuildXPlugin, with: {image: a}}
  there: {plugin: r.BuildXPlugin, with: {image: ghcr.io/b, push: True}}
application: {dir: robot/}
""")
    assert conversion.image["name"] == "ghcr.io/b"
    assert conversion.image["dockerfile"] == "robot/Dockerfile"
    assert noted(conversion)["jobs.here.with"] == "there is one image, that of there"


def test_systems_without_any_image(converted: Converted) -> None:
    text = "jobs: {c: {plugin: x.ComposePlugin, with: {components: {name: c, command: x, artifacts: [/t.csv]}}}}"
    assert noted(converted(text))["job c"] == "no image is named, and none is built: write software.image"


def test_unknown_keys_are_named(converted: Converted) -> None:
    conversion = converted("""
application: {distro: noetic, colour: red}
extra: 1
packages: []
jobs: {other: {plugin: my.Plugin, also: 1}}
sequences:
  a: {matrix: {x: [1]}, colour: red, stages: [other, {jobs: [other], colour: red}]}
""")
    notes = noted(conversion)
    assert notes["extra"] == notes["application.colour"] == notes["sequences.a.colour"] == "Rigel has no such key"
    assert notes["sequences.a.stages.1.colour"] == notes["jobs.other.also"] == "Rigel has no such key"
    assert "of Rigel 0.2" in notes["packages"]
    assert "does not use it" in notes["sequences.a.matrix"]
    assert notes["jobs.other"] == "there is nothing like my.Plugin here"
    assert conversion.is_empty


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("vars: {a: '{{ vars.b }}', b: '{{ vars.a }}'}\njobs: {x: {plugin: '{{ vars.a }}'}}", "a refers to itself (a -> b -> a)"),
        ("vars: {a: 'x {{ vars.a }}'}\njobs: {x: {plugin: '{{ vars.a }}'}}", "a refers to itself (a -> a)"),
        ("jobs: []", "jobs: found [], a mapping was expected"),
        ("jobs: {a: 3}", "jobs.a: found 3, a mapping was expected"),
        ("jobs: {a: {}}", "jobs.a.plugin: found None, a text was expected"),
        ("jobs: {a: {plugin: x.ComposePlugin, with: {components: 3}}}", "components: found 3, a list was expected"),
        ("jobs: {a: {plugin: x.BuildXPlugin, with: {push: 3}}}", "push: found 3, true or false was expected"),
        ("jobs: {}\nproviders: {p: {provider: x.y, with: pl4nted}}", "a mapping was expected"),
        ("jobs: {'a!': {plugin: x.ComposePlugin, with: &c {components: {command: x, artifacts: [/t.csv]}}}, 'a?': {plugin: x.ComposePlugin, with: *c}}", "jobs: two are called 'a'"),
        ("jobs: {a: {plugin: x.y}, 'a': {plugin: x.y}}", "the key 'a' occurs twice"),
        ("application: {~: a, None: b}", "the same as texts"),
        ("colour: red", "found colour, the keys application and jobs were expected"),
        ("[]", "a Rigelfile was expected"),
        ("", "a Rigelfile was expected"),
    ],
)  # fmt: skip
def test_what_is_wrong(converted: Converted, text: str, message: str) -> None:
    with pytest.raises(InputError) as caught:
        converted(text)
    assert "Rigelfile" in str(caught.value)
    assert message in str(caught.value)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (
            "vars: {n: {type: a.B, with: {x: 1}}}\njobs: {c: {plugin: a.B, with: '{{ vars.n }}'}}",
            "a mapping was expected",
        ),
        ("jobs: {b: {plugin: BuildXPlugin, with: {image: a, created: 2020-01-01}}}", None),
        ("vars: {n: null}\njobs: {b: {plugin: BuildXPlugin, with: {image: 'a{{ vars.n }}'}}}", None),
        ("jobs: {b: {plugin: BuildXPlugin, with: {image: 'a', tags: ['{{ }}']}}}", None),
        ("jobs: {b: {plugin: BuildXPlugin, with: {image: '{{ vars. }}'}}}", None),
    ],
)
def test_odd_values(converted: Converted, text: str, said: str | None) -> None:
    if said is None:
        assert converted(text).image["name"]
        return
    with pytest.raises(InputError, match=said):
        converted(text)


@pytest.mark.parametrize(("name", "variable"), [("a-b", "A_B"), ("aB", "aB"), ("1", "SECRET_1"), ("", "SECRET")])
def test_names_for_variables(name: str, variable: str) -> None:
    assert variable_name(name) == variable


TESTED = """
application: {{distro: noetic}}
jobs:
  talk:
    plugin: rigel.plugins.core.TestPlugin
    with: {fields}
"""


def test_requirements_of_a_test_job_become_properties_over_a_bag(converted: Converted) -> None:
    fields = (
        "{hostname: robot, port: 9090, timeout: 60, ignore: 2, requirements: ['globally: some /x', 'globally:  no /y']}"
    )
    conversion = converted(TESTED.format(fields=fields))
    assert conversion.requirements == {"bag": "TODO.bag", "hpl": ["globally: some /x", "globally: no /y"]}
    assert conversion.requirements_origin == "job talk"
    for key in ("hostname", "port", "timeout", "ignore"):
        assert f"jobs.talk.with.{key}" in noted(conversion)


def test_a_test_job_without_requirements_is_noted(converted: Converted) -> None:
    conversion = converted(TESTED.format(fields="{hostname: robot}"))
    assert conversion.requirements == {}
    assert noted(conversion)["jobs.talk"] == "it has no requirements"


def test_requirements_of_components_are_converted_too(converted: Converted) -> None:
    conversion = converted(compose("introspection: {requirements: ['globally: some /x']}"))
    assert conversion.requirements["hpl"] == ["globally: some /x"]


def test_the_examples_job_of_tests_becomes_the_properties_that_the_example_judges() -> None:
    example = Path(__file__).parents[3] / "examples" / "ros1"
    conversion = convert(read_rigelfile(example / "Rigelfile"))
    judged = yaml.safe_load((example / "calibration.yml").read_text())["requirements"]
    assert conversion.requirements["hpl"] == judged["hpl"]
