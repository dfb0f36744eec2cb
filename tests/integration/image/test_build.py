"""Real builds of images, by both of the engine's builders."""

import hashlib
import json
import os
from typing import Any

import pytest

from calibration.base import ExitCode, InfrastructureError, InputError
from calibration.ci.image.build_request import BuildFailedError
from tests.ci.image.test_several_platforms import SCRIPT as SEVERAL
from tests.docker_engine import Registry
from tests.integration.image.builds import Builds, builds

__all__ = ["builds"]

BASE = "debian:bookworm"
BUILDERS = ("engine", "buildkit")
HOSTILE = """a\\b "c" $HOME 'd' ünï # <<EOF ${x} `id` $(id)"""

FAKE_ROS = {
    "opt/ros/fake/setup.bash": "export ROS_FAKE=1\n",
    "usr/local/bin/rosdep": '#!/bin/sh\necho "$@" >> /rosdep-calls\ncat /proc/sys/kernel/random/uuid > /rosdep-ran\n'
    '[ "$1" != install ] || find "$3" -type f | sort > /rosdep-saw\n',
    "usr/local/bin/catkin_make": '#!/bin/sh\n[ "$ROS_FAKE" = 1 ] && mkdir -p devel && id -un > built-by &&'
    ' printf "<%s>" "$@" > built-with && echo >> built-with && echo "export WORKSPACE=1" > devel/setup.bash\n',
    "usr/local/bin/colcon": "#!/bin/sh\nmkdir -p install && echo 'export WORKSPACE=2' > install/setup.bash\n",
    "usr/local/bin/apt-get": "#!/bin/sh\n",
    "etc/ros/rosdep/sources.list.d/20-default.list": "",
}
"""Programs of ROS that a workspace needs, which record their arguments."""


def buildkit_or_skip() -> None:
    from calibration.ci.image.builders import find_buildkit

    if find_buildkit(os.environ["PATH"]) is None:
        pytest.skip("needs a docker that does BuildKit (Debian's docker.io has one)")


@pytest.fixture(params=BUILDERS)
def builder(request: pytest.FixtureRequest) -> str:
    if request.param == "buildkit":
        buildkit_or_skip()
    return str(request.param)


@pytest.fixture
def fake_ros(builds: Builds) -> str:
    """Build a base with `FAKE_ROS`."""
    for path, content in FAKE_ROS.items():
        builds.write(f"fake/{path}", content, 0o755)
    builds.write("fake.Dockerfile", f"FROM {BASE}\nCOPY fake /\n")
    name = f"fake-ros/{builds.name}"
    return builds.build({"builder": "engine"}, name=name, dockerfile="fake.Dockerfile").reference


@pytest.mark.thorough
def test_from_packages_to_a_running_image(builds: Builds, python_image: str) -> None:
    builds.write("robot/run.py", "import six, os; print(six.__name__, os.environ['FROM_ENTRYPOINT'], os.getuid() != 0)")
    builds.write("req.txt", "# nothing\n")
    entry: dict[str, Any] = {
        "base": python_image,
        "apt": ["python3-pip"],
        "pip": ["six>=1.16", "-r req.txt"],
        "files": [{"from": "robot", "to": "/opt/robot"}],
        "entrypoint": ["export FROM_ENTRYPOINT=yes"],
        "command": ["python3", "/opt/robot/run.py"],
    }
    image = builds.build(**entry)
    assert image.built
    assert (image.digest, image.found_in) == (None, None)
    assert image.reference == f"{builds.name}:key-{image.key[:24]}"
    assert image.tags == (f"{builds.name}:latest",)
    assert builds.run(f"{builds.name}:latest") == "six yes True"
    labels = builds.engine.images.get(image.reference).labels
    assert labels["ci.calibration.key"] == image.key
    assert builds.run(image.reference, "ls", "/var/lib/apt/lists") == ""

    built_at = builds.engine.images.get(image.reference).attrs["Created"]
    again = builds.build(**entry)
    assert not again.built
    assert (again.id, again.found_in, again.key) == (image.id, "local", image.key)
    assert builds.engine.images.get(image.reference).attrs["Created"] == built_at
    assert "nothing has changed, found on the engine" in builds.log

    builds.write("robot/run.py", "print('changed')")
    changed = builds.build(**entry)
    assert changed.built
    assert changed.key != image.key
    assert builds.run(f"{builds.name}:latest") == "changed"


def test_texts_of_the_user_arrive_as_they_are(builds: Builds, builder: str) -> None:
    builds.write("it's a file", "content")
    image = builds.build(
        {"builder": builder},
        base=BASE,
        environment={"A": HOSTILE},
        labels={"a.b": HOSTILE},
        files=[{"from": "it's a file", "to": "/opt/it's $HOME é/"}],
        commands=['printf %s "$A" > /a', "echo one > /b\nFROM=two\necho $FROM >> /b", "echo '<<EOF' > /c"],
        command=["cat", "/opt/it's $HOME é/it's a file", "/a", "/b", "/c"],
    )
    assert builds.run(image.reference) == f"content{HOSTILE}one\ntwo\n<<EOF"
    assert builds.run(image.reference, "printenv", "A") == HOSTILE
    assert builds.engine.images.get(image.reference).labels["a.b"] == HOSTILE
    assert builds.run(image.reference, "id", "-un") == "robot"


def test_the_user_of_the_base_or_one_of_ours(builds: Builds, python_image: str) -> None:
    assert builds.run(builds.build(base=python_image).reference, "id", "-u") == "1000"
    assert builds.run(builds.build(base=python_image, user="pilot").reference, "id", "-u") == "1001"
    assert builds.run(builds.build(base=python_image, user="root").reference, "id", "-u") == "0"


def test_a_change_of_code_installs_nothing_again(builds: Builds, fake_ros: str, builder: str) -> None:
    builds.write("src/robot/package.xml", "<package><name>robot</name></package>")
    builds.write("src/robot/src/main.cpp", "int main() {}")
    builds.write("src/.git/HEAD", "x")
    entry: dict[str, Any] = {
        "base": fake_ros,
        "ros": "fake",
        "workspace": {"tool": "catkin_make", "sources": ["src"], "cmake-arguments": {"X": "a b"}},
        "command": ["sh", "-c", "echo $ROS_FAKE $WORKSPACE"],
    }
    first = builds.build({"builder": builder}, **entry)
    assert builds.run(first.reference) == "1 1"
    assert builds.run(first.reference, "cat", "/workspace/built-by") == "robot"
    assert builds.run(first.reference, "cat", "/workspace/built-with") == "<--cmake-args><-DX=a b>"
    assert builds.run(first.reference, "cat", "/rosdep-saw") == "/workspace/src/src/robot/package.xml"
    calls = "update --include-eol-distros --rosdistro fake\n"
    calls += "install --from-paths /workspace/src --ignore-src -y --rosdistro fake"
    assert builds.run(first.reference, "cat", "/rosdep-calls") == calls

    def installed() -> str:
        return builds.run(builds.build({"builder": builder}, **entry).reference, "cat", "/rosdep-ran")

    before = installed()
    builds.write("src/robot/src/main.cpp", "int main() { return 1; }")
    assert installed() == before
    builds.write("src/robot/package.xml", "<package><name>robot</name><depend>x</depend></package>")
    assert installed() != before


def test_colcon(builds: Builds, fake_ros: str) -> None:
    builds.write("robot/package.xml", "<package/>")
    image = builds.build(base=fake_ros, workspace={"tool": "colcon", "sources": ["robot"], "rosdep": False})
    assert builds.run(image.reference, "printenv", "WORKSPACE") == "2"
    assert builds.run(image.reference, "ls", "-l", "/workspace/src/robot/package.xml").split()[2:4] == [
        "robot",
        "robot",
    ]


def test_a_dockerfile_of_ones_own(builds: Builds, builder: str) -> None:
    builds.write("context/keep.txt", "kept")
    builds.write("context/drop.log", "dropped")
    builds.write("context/.dockerignore", "*.log\n.dockerignore")
    text = (
        f"ARG BASE=nothing:1\nFROM ${{BASE}} AS first\nARG A\nCOPY . /c\nRUN echo $A > /c/a\nFROM {BASE}\nRUN false\n"
    )
    builds.write("docker/Dockerfile", text)
    image = builds.build(
        {"builder": builder},
        dockerfile="docker/Dockerfile",
        context="context",
        build_arguments={"A": "a 'b' $c", "BASE": BASE},
        target="first",
        labels={"x": HOSTILE},
    )
    assert set(builds.run(image.reference, "ls", "-A", "/c").split()) - {".calibration.Dockerfile"} == {"keep.txt", "a"}
    assert builds.run(image.reference, "cat", "/c/a") == "a 'b' $c"
    assert builds.engine.images.get(image.reference).labels["x"] == HOSTILE
    assert not builds.build(
        {"builder": builder},
        dockerfile="docker/Dockerfile",
        context="context",
        build_arguments={"A": "a 'b' $c", "BASE": BASE},
        target="first",
        labels={"x": HOSTILE},
    ).built


def test_a_failing_step(builds: Builds, builder: str) -> None:
    lines = "; ".join(f"echo line {i}" for i in range(30))
    with pytest.raises(BuildFailedError) as error:
        builds.build({"builder": builder}, base=BASE, commands=["true", f"{lines}; echo ::error::evil; exit 7"])
    assert error.value.exit_code == ExitCode.FAIL
    assert "RUN echo line 0;" in error.value.headline
    assert error.value.headline.endswith(": exit code 7")
    assert error.value.lines == (*(f"line {i}" for i in range(11, 30)), "::error::evil")
    stop = builds.log.index("::stop-commands::")
    token = builds.log[stop:].splitlines()[0].removeprefix("::stop-commands::")
    assert stop < builds.log.index("::error::evil") < builds.log.index(f"::{token}::")
    assert not [c for c in builds.engine.api.containers(all=True) if "line 29" in c["Command"]]


@pytest.mark.parametrize("text", ["FROM debian:bookworm\nCOPY nothing /x\n", "FROM debian:bookworm\nFORM x\n"])
def test_a_dockerfile_that_is_wrong(builds: Builds, builder: str, text: str) -> None:
    builds.write("Dockerfile", text)
    with pytest.raises(BuildFailedError, match=r"nothing|unknown instruction: FORM"):
        builds.build({"builder": builder}, dockerfile="Dockerfile")


def test_a_base_that_is_not_there(builds: Builds, registry: Registry) -> None:
    with pytest.raises(InputError, match=f"base image {registry.address}/no/such:1: found neither on this machine nor"):
        builds.build(base=f"{registry.address}/no/such:1")
    with pytest.raises(InfrastructureError):
        builds.build(base="127.0.0.1:1/no/such:1")


@pytest.mark.parametrize(
    ("address", "kind", "message"),
    [
        ("", InputError, "it cannot be pulled: .*check the name, or log in"),
        ("127.0.0.1:1", InfrastructureError, "refused"),
    ],
)
def test_a_pinned_base_that_cannot_be_pulled(
    builds: Builds, registry: Registry, address: str, kind: type[Exception], message: str
) -> None:
    base = f"{address or registry.address}/no/such@sha256:{'e' * 64}"
    with pytest.raises(kind, match=f"image '{base}': .*{message}"):
        builds.build(base=base)


def test_a_dockerfile_that_the_engine_does_not_even_begin(builds: Builds) -> None:
    builds.write("Dockerfile", "")
    with pytest.raises(BuildFailedError, match=r"Dockerfile.* cannot be empty"):
        builds.build({"builder": "engine"}, dockerfile="Dockerfile")
    (builds.folder / "Dockerfile").write_bytes(b"\xff")
    with pytest.raises(InputError, match="this is no Dockerfile: no text in UTF-8"):
        builds.build(dockerfile="Dockerfile")


def test_a_platform_is_part_of_the_key(builds: Builds) -> None:
    native = builds.build(base=BASE, commands=["true"])
    own = "linux/" + builds.engine.version()["Arch"]
    assert builds.build(base=BASE, commands=["true"], platforms=[own]).key == native.key
    with pytest.raises(
        InputError, match=f"platforms: asked for linux/riscv64, but the engine's base image is for {own}"
    ):
        builds.build({"builder": "engine"}, base=BASE, platforms=["linux/riscv64"])


def test_several_platforms_need_buildx(builds: Builds, registry: Registry) -> None:
    entry: dict[str, Any] = {"name": f"{registry.address}/x/{builds.name}", "base": BASE, "push": True}
    with pytest.raises(InputError, match=r"several need docker's plugin buildx|no docker on PATH does it"):
        builds.build(platforms=["linux/amd64", "linux/arm64"], **entry)


def test_attestations_need_buildx_and_a_push(builds: Builds, registry: Registry) -> None:
    entry: dict[str, Any] = {"name": f"{registry.address}/x/{builds.name}", "base": BASE, "push": True, "attest": True}
    with pytest.raises(InputError, match="SBOM and provenance need docker's plugin buildx"):
        builds.build({"builder": "engine"}, **entry)
    plain = builds.build({"builder": "engine", "push": False}, **entry)  # as in a pull request of a stranger
    assert plain.built
    assert plain.key != builds.build({"builder": "engine", "push": False}, **{**entry, "attest": False}).key


def test_inputs_outside_of_the_key_are_reported(builds: Builds) -> None:
    builds.write("Dockerfile", f"FROM {BASE} AS a\nFROM other-$TARGETARCH AS b\nFROM a\n")
    with pytest.raises((BuildFailedError, InputError, InfrastructureError)):
        builds.build({"builder": "engine"}, dockerfile="Dockerfile")
    assert "not covered by the content key: only the builder can resolve other-$TARGETARCH" in builds.log


def test_no_registry_is_asked_for_names_without_a_host(builds: Builds) -> None:
    """Names without a host may belong to a stranger on Docker Hub, so it is not asked unless the image is pushed."""
    image = builds.build(name=f"team/{builds.name}", base=BASE, commands=["true"])
    assert image.built
    assert "registry" not in builds.log


def test_an_image_without_our_label_under_the_tag_is_not_taken_for_it(builds: Builds) -> None:
    first = builds.build(base=BASE, commands=["true"])
    builds.engine.images.get(BASE).tag(*first.reference.split(":"))
    assert builds.build(base=BASE, commands=["true"]).built


def test_force_builds_anew(builds: Builds) -> None:
    entry: dict[str, Any] = {"base": BASE, "commands": ["cat /proc/sys/kernel/random/uuid > /id"]}
    first = builds.run(builds.build(**entry).reference, "cat", "/id")
    assert builds.run(builds.build({"force": True}, **entry).reference, "cat", "/id") != first


def test_secrets_reach_the_step_and_nothing_else(builds: Builds, monkeypatch: pytest.MonkeyPatch) -> None:
    buildkit_or_skip()
    planted, filed = "planted-" + builds.name[-8:], "filed-" + builds.name[-8:]
    monkeypatch.setenv("PLANTED", planted)
    builds.write("secret", filed)
    image = builds.build(
        base=BASE,
        secrets=[{"id": "one", "variable": "PLANTED"}, {"id": "two", "file": "secret"}],
        commands=[
            # BuildKit ignores changed values of secrets in its cache, so the text of the step differs.
            f": {builds.name}; sha256sum /run/secrets/one /run/secrets/two > /sums; cat /run/secrets/*",
            "touch /run/secrets/one && ls -l /run/secrets >&2 || true",
        ],
    )
    sums = builds.run(image.reference, "cat", "/sums")
    assert hashlib.sha256(planted.encode()).hexdigest() in sums
    assert hashlib.sha256(filed.encode()).hexdigest() in sums
    archive = b"".join(builds.engine.images.get(image.reference).save())
    attributes = json.dumps(builds.engine.images.get(image.reference).attrs)
    history = json.dumps(builds.engine.images.get(image.reference).history())
    log = "\n".join(line for line in builds.log.splitlines() if not line.startswith("::add-mask::"))
    for secret in (planted, filed):
        assert secret.encode() not in archive
        assert secret not in attributes + history + log + repr(image)
    assert "***" in log  # it was in the output, and redacted


def test_secrets_need_buildkit(builds: Builds, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PLANTED", "hunter2-hunter2")
    entry: dict[str, Any] = {"base": BASE, "secrets": [{"id": "one", "variable": "PLANTED"}]}
    with pytest.raises(InputError, match="builder: engine cannot build this: secrets"):
        builds.build({"builder": "engine"}, **entry)
    monkeypatch.setenv("PATH", "/nowhere")
    with pytest.raises(InputError, match="need BuildKit, and no docker on PATH supports it"):
        builds.build(**entry)
    with pytest.raises(InputError, match="builder: buildkit is requested, and no docker"):
        builds.build({"builder": "buildkit"}, base=BASE)


def test_a_secret_in_a_label_is_refused(builds: Builds, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PLANTED", "hunter2-hunter2")
    secrets = [{"id": "one", "variable": "PLANTED"}]
    for entry in (
        {"base": BASE, "labels": {"a": "hunter2-hunter2"}},
        {"base": BASE, "entrypoint": ["export A=hunter2-hunter2"]},
        {"base": BASE, "commands": ["echo hunter2-hunter2"]},
    ):
        with pytest.raises(InputError, match="secrets: one: its value occurs in"):
            builds.build(secrets=secrets, **entry)
    builds.write("Dockerfile", f"FROM {BASE}\nARG A\n")
    with pytest.raises(InputError, match=r"its value occurs in build-arguments\.A"):
        builds.build(secrets=secrets, dockerfile="Dockerfile", build_arguments={"A": "hunter2-hunter2"})


def test_no_agent_for_ssh(builds: Builds, monkeypatch: pytest.MonkeyPatch) -> None:
    buildkit_or_skip()
    monkeypatch.delenv("SSH_AUTH_SOCK", raising=False)
    with pytest.raises(InputError, match="ssh: no SSH agent runs here"):
        builds.build(base=BASE, ssh=True)


def test_several_platforms_with_a_buildx(builds: Builds, registry: Registry, monkeypatch: pytest.MonkeyPatch) -> None:
    """With a program that replaces buildx, which this engine lacks, and prints what BuildKit would have pushed."""
    builds.write("bin/docker", SEVERAL, 0o755)
    monkeypatch.setenv("PATH", f"{builds.folder}/bin:{os.environ['PATH']}")
    for name, value in {"CALLS": str(builds.folder), "DOCKER_CONFIG": str(builds.folder / "none")}.items():
        monkeypatch.setenv(name, value)
    monkeypatch.setenv("METADATA", json.dumps({"containerimage.digest": f"sha256:{'d' * 64}"}))
    name = f"{registry.address}/x/{builds.name}"
    platforms = ["linux/amd64", "linux/arm64"]
    image = builds.build(name=name, base=BASE, push=True, tags=[], platforms=platforms)
    assert (image.built, image.id, image.digest) == (True, None, f"sha256:{'d' * 64}")
    assert f"<--tag><{image.reference}>" in (builds.folder / "calls").read_text()


def test_buildkit_builds_where_a_docker_program_does_it(builds: Builds, monkeypatch: pytest.MonkeyPatch) -> None:
    buildkit_or_skip()

    def comments(image: str) -> set[str]:
        return {str(layer["Comment"]) for layer in builds.engine.images.get(image).history()}

    by_default = builds.build(base=BASE, commands=["true"])
    monkeypatch.setenv("PATH", "/nowhere")
    without_program = builds.build(base=BASE, commands=["true", "true"])
    assert "buildkit.dockerfile.v0" in comments(by_default.reference)
    assert "buildkit.dockerfile.v0" not in comments(without_program.reference)
