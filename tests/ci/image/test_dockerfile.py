import json
import re
import subprocess
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from calibration.base import InputError
from calibration.ci.image.dockerfile import Rendered, render
from calibration.ci.image.specification import parse_image_specification

INSTRUCTION = re.compile(
    r"^(FROM|SHELL|USER|ENV|RUN|COPY|WORKDIR|LABEL|ENTRYPOINT|CMD) \S", re.MULTILINE
)  # all instructions that the renderer writes
DIGEST = f"sha256:{'a' * 64}"


def rendered(folder: Path = Path("nowhere"), digest: str | None = None, **entry: Any) -> Rendered:
    entry = {key.replace("_", "-"): value for key, value in {"base": "debian:bookworm", **entry}.items()}
    return render(parse_image_specification(entry, folder, "f.yml"), digest)


def instructions(dockerfile: str) -> list[str]:
    """Return the instructions, each on one line, as a builder reads them."""
    text = "\n".join(line for line in dockerfile.split("\n") if not line.startswith("#"))
    return [line for line in text.replace("\\\n", "").split("\n") if line]


def test_the_smallest() -> None:
    found = rendered()
    assert found.dockerfile == (
        "# Made by `calibration build-image`: change the specification, not this file.\n"
        "FROM debian:bookworm\n"
        'SHELL ["/bin/bash", "-eo", "pipefail", "-c"]\n'
        "USER root\n"
        "RUN id -u robot >/dev/null 2>&1 || useradd --create-home --shell /bin/bash robot\n"
        "USER robot\n"
    )
    assert found.entrypoint is None
    assert not found.needs_buildkit


def test_a_ros_workspace_in_layers_for_the_cache(tmp_path: Path) -> None:
    for name in ("src/robot", "config"):
        (tmp_path / name).mkdir(parents=True)
    found = rendered(
        tmp_path,
        digest=DIGEST,
        base="ros:noetic",
        ros="noetic",
        apt=["curl", "bzip2", "curl"],
        pip=["numpy<2", "a[b] ; python_version<'3.13'"],
        environment={"B": "2", "A": "1"},
        files=[{"from": "config", "to": "/opt/config", "owner": "robot"}, {"from": "x.yml", "to": "/opt/"}],
        commands=["ldconfig"],
        workspace={
            "tool": "catkin_make",
            "sources": ["src/robot"],
            "cmake-arguments": {"CMAKE_BUILD_TYPE": "Release", "X": "a b"},
            "packages": ["robot"],
            "rosdep-skip": ["gazebo", "rviz"],
        },
        entrypoint=["export ROS_LOG_DIR=/tmp"],
        command=["roslaunch", "robot", "robot.launch"],
        labels={"team": "a"},
    )
    assert instructions(found.dockerfile) == [
        f"FROM ros:noetic@{DIGEST}",
        'SHELL ["/bin/bash", "-eo", "pipefail", "-c"]',
        "USER root",
        'ENV A="1"',
        'ENV B="2"',
        (
            "RUN apt-get update  && DEBIAN_FRONTEND=noninteractive apt-get install --yes --no-install-recommends"
            " -o Acquire::Retries=3 bzip2 curl  && rm -rf /var/lib/apt/lists/*"
        ),
        (
            "RUN { python3 -m pip --version >/dev/null 2>&1 || { apt-get update && DEBIAN_FRONTEND=noninteractive"
            " apt-get install --yes --no-install-recommends -o Acquire::Retries=3 python3-pip"
            " && rm -rf /var/lib/apt/lists/*; }; }  && PIP_BREAK_SYSTEM_PACKAGES=1 PIP_ROOT_USER_ACTION=ignore"
            """ python3 -m pip install --no-cache-dir 'numpy<2' 'a[b] ; python_version<'"'"'3.13'"'"''"""
        ),
        "RUN id -u robot >/dev/null 2>&1 || useradd --create-home --shell /bin/bash robot",
        "RUN install --directory --owner=robot /workspace /workspace/src",
        'COPY --chown=robot ["manifests/0/", "/workspace/src/robot/"]',
        (
            "RUN apt-get update"
            "  && { command -v rosdep >/dev/null || DEBIAN_FRONTEND=noninteractive apt-get install --yes"
            " --no-install-recommends -o Acquire::Retries=3 python3-rosdep; }"
            "  && { test -e /etc/ros/rosdep/sources.list.d/20-default.list || rosdep init; }"
            "  && export DEBIAN_FRONTEND=noninteractive"
            "  && rosdep update --include-eol-distros --rosdistro noetic"
            "  && PIP_BREAK_SYSTEM_PACKAGES=1 PIP_ROOT_USER_ACTION=ignore rosdep install --from-paths /workspace/src"
            " --ignore-src -y --rosdistro noetic --skip-keys 'gazebo rviz'"
            "  && rm -rf /root/.ros  && rm -rf /var/lib/apt/lists/*"
        ),
        'COPY --chown=robot ["files/0/", "/opt/config/"]',
        'COPY ["files/1", "/opt/x.yml"]',
        "RUN ldconfig",
        "WORKDIR /workspace",
        "USER robot",
        'COPY --chown=robot ["sources/0/", "/workspace/src/robot/"]',
        (
            "RUN source /opt/ros/noetic/setup.bash  && catkin_make --only-pkg-with-deps robot"
            " --cmake-args -DCMAKE_BUILD_TYPE=Release '-DX=a b'"
        ),
        'LABEL "team"="a"',
        'COPY ["entrypoint.sh", "/usr/local/bin/calibration-entrypoint"]',
        'ENTRYPOINT ["/usr/local/bin/calibration-entrypoint"]',
        'CMD ["roslaunch", "robot", "robot.launch"]',
    ]
    assert found.entrypoint == (
        "#!/bin/bash\nset -e\nsource /opt/ros/noetic/setup.bash\nsource /workspace/devel/setup.bash\n"
        'export ROS_LOG_DIR=/tmp\nexec "$@"\n'
    )


def test_colcon_without_rosdep_and_as_root() -> None:
    workspace = {"tool": "colcon", "rosdep": False, "packages": ["a", "b"]}
    found = rendered(workspace=workspace, user="root")
    assert "rosdep" not in found.dockerfile
    assert "python3-colcon-common-extensions" in found.dockerfile
    assert "colcon build --packages-up-to a b\n" in found.dockerfile
    assert "useradd" not in found.dockerfile
    assert re.findall("^USER .*", found.dockerfile, re.MULTILINE) == ["USER root"]
    assert found.entrypoint is not None
    assert "source /workspace/install/setup.bash" in found.entrypoint
    assert found.dockerfile.endswith('CMD ["/bin/bash"]\n')  # an ENTRYPOINT resets the CMD of the base


def test_repositories_are_cloned_in_a_stage_of_their_own(tmp_path: Path) -> None:
    (tmp_path / "a.repos").write_text(
        f"repositories: {{tools/r: {{type: git, url: 'https://github.com/team/r.git', version: {'b' * 40}}}}}"
    )
    found = rendered(
        tmp_path,
        digest=DIGEST,
        secrets=[{"id": "token", "variable": "TOKEN", "host": "github.com"}],
        ssh=True,
        commands=["make"],
        workspace={"tool": "colcon", "repositories": ["a.repos"]},
    )
    assert found.needs_buildkit
    before, after = found.dockerfile.split(f"\nFROM debian:bookworm@{DIGEST}\n")
    assert f"FROM debian:bookworm@{DIGEST} AS repositories\n" in before
    mounts = "--mount=type=secret,id=token --mount=type=ssh "
    assert f"RUN {mounts}git clone -- https://github.com/team/r.git /repositories/tools/r \\\n" in before
    assert f"git -C /repositories/tools/r checkout --quiet {'b' * 40} --" in before
    assert 'COPY --from=repositories --chown=robot ["/repositories/", "/workspace/src/"]\n' in after
    assert f"RUN {mounts}make\n" in after
    assert "git" not in after
    assert "ARG" not in found.dockerfile


def test_git_gets_the_password_from_the_secret_of_its_host_only(tmp_path: Path) -> None:
    (tmp_path / "a.repos").write_text("repositories: {r: {type: git, url: 'https://github.com/team/r.git'}}")
    secret = {"id": "token", "variable": "TOKEN", "host": "github.com", "username": "bot"}
    found = rendered(tmp_path, secrets=[secret], workspace={"tool": "colcon", "repositories": ["a.repos"]})
    [line] = [line for line in found.dockerfile.splitlines() if "git config" in line]
    (tmp_path / "token").write_text("hunter2")
    script = line.removeprefix("RUN ").replace("/run/secrets", str(tmp_path))
    environment = {"HOME": str(tmp_path), "PATH": "/usr/bin:/bin", "GIT_TERMINAL_PROMPT": "0"}
    subprocess.run(["bash", "-c", script], check=True, env=environment)

    def ask(host: str) -> str:
        question = f"protocol=https\nhost={host}\n\n"
        command = ["git", "credential", "fill"]
        return subprocess.run(command, input=question, capture_output=True, text=True, env=environment).stdout

    assert "username=bot\npassword=hunter2\n" in ask("github.com")
    assert "hunter2" not in ask("evil.example")


@pytest.mark.parametrize(
    "command",
    [
        "echo one\nFROM evil\nUSER root",
        "echo a \\",
        "cat <<EOF",
        "[ -e /a ]",
        "--mount=type=bind echo",
        "# nothing",
        "echo a\tb",
        "echo \"a\" 'b' \\\\ é \u2028 $HOME",
    ],
)
def test_a_command_is_one_step_whatever_it_holds(command: str) -> None:
    before = instructions(rendered().dockerfile)
    after = instructions(rendered(commands=[command]).dockerfile)
    [step] = [line for line in after if line not in before]
    word, _, rest = step.partition(" ")
    assert word == "RUN"
    if rest.startswith("["):
        assert json.loads(rest) == ["/bin/bash", "-eo", "pipefail", "-c", command]
        assert "<<" not in rest
    else:
        assert rest == command


TEXT = st.text(st.characters(codec="utf-8"), max_size=30)


@given(environment=TEXT, command=TEXT, label=TEXT, line=TEXT, package=TEXT, target=TEXT, argument=TEXT)
def test_no_text_of_the_user_becomes_an_instruction(
    environment: str, command: str, label: str, line: str, package: str, target: str, argument: str
) -> None:
    entry = {
        "environment": {"A": environment},
        "commands": [command],
        "labels": {"a": label},
        "entrypoint": [line],
        "pip": [package],
        "files": [{"from": "a", "to": f"/{target}"}],
        "workspace": {"tool": "colcon", "cmake-arguments": {"A": argument}},
    }
    try:
        found = rendered(**entry)
    except InputError:
        return
    harmless = rendered(
        environment={"A": "a"},
        commands=["a"],
        labels={"a": "a"},
        entrypoint=["a"],
        pip=["-r a" if package.strip().startswith("-r") else "a"],
        files=[{"from": "a", "to": "/a"}],
        workspace={"tool": "colcon", "cmake-arguments": {"A": "a"}},
    )

    def words(text: str) -> list[str]:
        return [instruction.split()[0] for instruction in instructions(text)]

    assert words(found.dockerfile) == words(harmless.dockerfile)
    assert all(INSTRUCTION.match(instruction) for instruction in instructions(found.dockerfile))
    assert rendered(**entry) == found  # reproducible byte for byte


@given(st.permutations(["a", "b", "c", "d"]))
def test_the_order_of_sets_does_not_matter(names: list[str]) -> None:
    assert rendered(apt=names, environment=dict.fromkeys(names, "1"), labels=dict.fromkeys(names, "1")) == rendered(
        apt=sorted(names), environment=dict.fromkeys(sorted(names), "1"), labels=dict.fromkeys(sorted(names), "1")
    )


def test_a_base_with_a_digest_stays_as_it_is() -> None:
    other = f"sha256:{'c' * 64}"
    assert f"FROM debian@{other}\n" in rendered(base=f"debian@{other}", digest=DIGEST).dockerfile


def test_a_single_file_keeps_its_name_in_a_folder_and_requirements_are_installed() -> None:
    found = rendered(files=[{"from": "a/b.yml", "to": "/"}], pip=["-r requirements.txt"])
    assert 'COPY ["files/0", "/b.yml"]\n' in found.dockerfile
    assert 'COPY ["requirements/0.txt", "/tmp/requirements/0.txt"]\n' in found.dockerfile
    assert "pip install --no-cache-dir --requirement /tmp/requirements/0.txt\n" in found.dockerfile


def test_underlays_are_built_before_in_layers_of_their_own(tmp_path: Path) -> None:
    for name in ("lower", "upper"):
        (tmp_path / name).mkdir()
    url = "https://github.com/team/driver"
    (tmp_path / "a.repos").write_text(f"repositories: {{driver: {{type: git, url: '{url}', version: v1}}}}")
    found = rendered(
        tmp_path,
        underlays=[
            {"tool": "colcon", "sources": ["lower"], "rosdep": False, "path": "/lower", "repositories": ["a.repos"]}
        ],
        files=[{"from": "x.yml", "to": "/opt/"}],
        workspace={"tool": "catkin_make", "sources": ["upper"], "rosdep": False},
    )
    lines = instructions(found.dockerfile)
    places = [
        lines.index(line)
        for line in (
            'COPY --from=repositories --chown=robot ["/underlay-0/repositories/", "/lower/src/"]',
            'COPY --chown=robot ["underlay-0/manifests/0/", "/lower/src/lower/"]',
            'COPY --chown=robot ["underlay-0/sources/0/", "/lower/src/lower/"]',
            "RUN colcon build",
            'COPY --chown=robot ["manifests/0/", "/workspace/src/upper/"]',
            'COPY ["files/0", "/opt/x.yml"]',
            "RUN source /lower/install/setup.bash  && catkin_make",
        )
    ]
    assert places == sorted(places)
    assert any(f"git clone -- {url} /underlay-0/repositories/driver" in line for line in lines)
    assert found.entrypoint is not None
    assert re.findall("source (.*)", found.entrypoint) == ["/lower/install/setup.bash", "/workspace/devel/setup.bash"]


def test_two_workspaces_in_one_folder_are_refused() -> None:
    workspace = {"tool": "colcon", "rosdep": False}
    with pytest.raises(InputError, match=r"f\.yml: underlays: .* /workspace"):
        rendered(underlays=[workspace], workspace=workspace)
