"""Hostile xacros: what they may not reach, and what they may not take."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from calibration.base import InputError
from calibration.robot.robot_description import XacroInputs, read_robot_description

pytest.importorskip("xacro")
HEAD = '<robot name="it" xmlns:xacro="http://www.ros.org/wiki/xacro">'
GLOBALS = "[c for c in ().__class__.__base__.__subclasses__() if c.__name__ == '_wrap_close'][0].__init__.__globals__"
SECRET = "s3cr3t-of-the-registry"  # noqa: S105 (a made-up one)

EXPRESSIONS = (
    f"(lambda: {GLOBALS}['system']('touch pwned'))()",
    "(lambda x: x)(1)",
    "[f for f in [1] for f in [(lambda: 1)]][0]()",
    "().__class__",
    "''.__class__.__mro__",
    "__builtins__",
    "__import__('os')",
    "getattr('', 'upper')",
    "eval('1')",
    "open('/etc/hostname')",
    "os.system('id')",
    "'%s' % python.vars(python)",
    "python.vars(math)",
    "list(map(python.vars, [math]))",
    "python.issubclass(python.type(1), int)",
    "python.type('X', (python.dict,), dict(a=1))",
    "list(map(list, map(map, list(dict(python).values())[-3:-2], [['']])))",
    "dict(**math)",
    "[python]",
    "python.type('')",
    "math.root",
    "math.parent",
    "xacro.load_yaml.func_globals",
    "xacro.load_yaml.__globals__",
    "xacro.arg.__globals__",
    "(x for x in [1]).gi_frame.f_back.f_globals",
    "[x for x in [1]].gi_frame",
    "python.map(str, [1]).__reduce__()",
    "str.format('a', 1)",
    "'a'.format(1)",
    "'a'.format_map(math)",
    "'a'.encode('utf-7')",
    "'a'.translate(1)",
    "python.dict.fromkeys([1])",
    "python.complex(1).conjugate()",
    "python.hash('a')",
    "f'1'",
    "(y := 1)",
    "[__x for __x in [1]]",
    "python.sorted([1], key=lambda x: x)",
    "list(map('a'.upper, [1]))",
    "math.update(sin=1)",
    "math.pop('sin')",
    "b'a'",
    "1j",
    "...",
    "await x",
    "1 @ 2",
    "'a' * 10**10",
    "10**10 * 'a'",
    "[0] * 10**9",
    "(0,) * 10**9",
    "10**10**9",
    "(2**9999) ** 9999",
    "(-2)**10**9",
    "1 << 10**9",
    "'%1000000000d' % 1",
    "'%.1000000000f' % 1",
    "'%*d' % (10**9, 1)",
    "'a'.zfill(10**10)",
    "len(range(10**9))",
    "python.sum(python.range(10**12))",
    "python.sum([1 for a in range(10**6) for b in range(10**6)])",
    "round(5, -10**9)",
    "math.factorial(10**9)",
    "math.comb(10**9, 10**8)",
    "list(map(str, range(10**7)))",
    "','.join(['a' * 10**6] * 10**6)",
    "('a' * 10**6).replace('a', 'a' * 10**6)",
    "(" * 3000 + "1" + ")" * 3000,
    "-" * 9000 + "1",
    "1+" * 20000 + "1",
    "[a for a in [1]" + " for a in [1, 2]" * 30 + "]",
    "xacro.load_yaml('/etc/hostname')",
    "xacro.load_yaml('/proc/self/environ')",
    "xacro.load_yaml('../outside.yaml')",
    "xacro.load_yaml('link.yaml')",
    "xacro.load_yaml('.git/config')",
    "xacro.load_yaml(xacro.abs_filename('../outside.yaml'))",
    "list(map(xacro.load_yaml, ['../outside.yaml']))",
    "xacro.load_yaml('object.yaml')",
    "xacro.load_yaml('lambda.yaml')",
    "xacro.load_yaml('bool.yaml')",
    "xacro.load_yaml('pipe.yaml')",
)
BODIES = (
    '<xacro:include filename="/etc/passwd"/>',
    '<xacro:include filename="/proc/self/environ"/>',
    '<xacro:include filename="../outside.xacro"/>',
    "<xacro:include filename=\"${'..'}/outside.xacro\"/>",
    '<xacro:include filename="link.xacro"/>',
    '<xacro:include filename="folder/outside.xacro"/>',
    '<xacro:include filename="../*.xacro"/>',
    '<xacro:include filename="/proc/[0-9]*/environ"/>',
    '<xacro:include filename="robot.urdf.xacro"/>',
    '<xacro:include filename="$(find ..)/outside.xacro"/>',
    '<xacro:include filename="$(cwd)/../outside.xacro"/>',
    '<xacro:include filename="${().__class__}"/>',
    '<xacro:if value="${(lambda: True)()}"><link name="a"/></xacro:if>',
    '<xacro:unless value="${().__class__}"><link name="a"/></xacro:unless>',
    '<xacro:element xacro:name="${().__class__}"/>',
    '<link><xacro:attribute name="a" value="${().__class__}"/></link>',
    '<xacro:macro name="m" params="a:=${().__class__}"><link name="${a}"/></xacro:macro><xacro:m/>',
    '<xacro:macro name="m" params="a"><link name="${a}"/></xacro:macro><xacro:m a="${().__class__}"/>',
    '<xacro:macro name="m"><xacro:m/></xacro:macro><xacro:m/>',
    '<xacro:property name="a" value="${b}"/><xacro:property name="b" value="${a}"/><link name="${a}"/>',
    '<xacro:property name="__builtins__" value="1"/><link name="a"/>',
    '<xacro:arg name="a" default="().__class__"/><link name="${$(arg a)}"/>',
    '<xacro:arg name="a" default="${().__class__}"/><link name="$(arg a)"/>',
    '<link name="$(eval ().__class__"/><link name="$(eval (lambda: 1)()"/>',
    '<link name="$(eval [].append)"/>',
    '<link name="$(eval 10**10**9)"/>',
    '<link name="$(env SECRET)"/>',
    '<link name="$(env CALIBRATION_REGISTRY_PASSWORD)"/>',
    '<xacro:property name="a0" value="${\'a\' * 10**5}"/>'
    + "".join(f'<xacro:property name="a{i + 1}" value="${{a{i} + a{i}}}"/>' for i in range(40))
    + '<link name="${a40}"/>',
    '<xacro:property name="a0" value="${[0] * 10}"/>'
    + "".join(f'<xacro:property name="a{i + 1}" value="${{[a{i}] * 10}}"/>' for i in range(10))
    + '<link name="${a10}"/>',
    "".join(
        f'<xacro:macro name="m{i}">{f"<xacro:m{i + 1}/>" * 10 if i < 9 else "<link/>"}</xacro:macro>' for i in range(10)
    )
    + "<xacro:m0/>",
)


def refusal(folder: Path, text: str) -> str:
    """Why a hostile xacro is not expanded."""
    inside = folder / "inside"
    (inside / ".git").mkdir(parents=True)
    (inside / ".git" / "config").write_text("token: 1")
    (folder / "outside.yaml").write_text(f"password: {SECRET}")
    (folder / "outside.xacro").write_text(f'<robot><link name="{SECRET}"/></robot>')
    (inside / "link.yaml").symlink_to(folder / "outside.yaml")
    (inside / "link.xacro").symlink_to(folder / "outside.xacro")
    (inside / "folder").symlink_to(folder)
    (inside / "object.yaml").write_text("!!python/object/apply:os.system ['touch pwned']")
    (inside / "lambda.yaml").write_text("a: !degrees (lambda{})()".replace("{}", ": 1"))
    (inside / "bool.yaml").write_text("!!bool x")
    (inside / "pipe.yaml").symlink_to("/dev/zero")
    file = inside / "robot.urdf.xacro"
    file.write_text(text)
    with pytest.raises(InputError) as error:
        read_robot_description(file)
    said = str(error.value)
    assert "\n" not in said
    assert said.startswith(f"{file}: ")
    assert "cannot be expanded" in said
    assert SECRET not in said
    assert not list(folder.rglob("pwned"))
    return said


@pytest.fixture(autouse=True)
def limits(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("calibration.robot.robot_description.SECONDS", 3)
    monkeypatch.setenv("CALIBRATION_REGISTRY_PASSWORD", SECRET)


@pytest.mark.thorough(but_first=16)
@pytest.mark.parametrize("expression", EXPRESSIONS, ids=range(len(EXPRESSIONS)))
def test_an_expression_reaches_and_takes_nothing(tmp_path: Path, expression: str) -> None:
    escaped = expression.replace("&", "&amp;").replace("<", "&lt;").replace('"', "&quot;")
    refusal(tmp_path, f'{HEAD}<link name="${{{escaped}}}"/></robot>')


def test_what_is_escaped_stays_text(tmp_path: Path) -> None:
    """xacro passes once over a file: what it wrote is not evaluated."""
    file = tmp_path / "robot.urdf.xacro"
    file.write_text(f'{HEAD}<link name="$${{1 + 1}}"/></robot>')
    assert b'<link name="${1 + 1}"/>' in read_robot_description(file)


@pytest.mark.thorough(but_first=8)
@pytest.mark.parametrize("body", BODIES, ids=range(len(BODIES)))
def test_an_element_reaches_and_takes_nothing(tmp_path: Path, body: str) -> None:
    refusal(tmp_path, f"{HEAD}{body}</robot>")


def test_what_needs_more_than_is_expanded_says_to_give_a_urdf(tmp_path: Path) -> None:
    said = refusal(tmp_path, f'{HEAD}<link name="${{(lambda: 1)()}}"/></robot>')
    assert "a lambda" in said
    assert said.endswith("give the URDF that xacro makes of it: xacro robot.urdf.xacro > robot.urdf")


@pytest.mark.parametrize("packages", ["/", "/proc/self", "/run", "home/..", "home", "runner/calibration-aws", "runner"])
def test_a_folder_with_private_files_is_not_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, packages: str
) -> None:
    (tmp_path / "home").mkdir()
    token = tmp_path / "runner/calibration-aws/token"
    token.parent.mkdir(parents=True)
    token.write_text(SECRET)
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    monkeypatch.setenv("RUNNER_TEMP", str(tmp_path / "runner"))
    file = tmp_path / "home/robot.urdf.xacro"
    file.write_text(f"{HEAD}<link name=\"${{xacro.load_yaml('{token}')}}\"/></robot>")
    with pytest.raises(InputError, match="packages: a xacro may read this whole folder"):
        read_robot_description(file, XacroInputs(packages=tmp_path / packages))


def test_a_package_in_the_home_folder_opens_only_itself(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    (tmp_path / "secret.yaml").write_text(SECRET)
    (tmp_path / "robot").mkdir()
    (tmp_path / "robot/package.xml").write_text("<package><name>robot</name></package>")
    file = tmp_path / "robot/robot.urdf.xacro"
    file.write_text(f'{HEAD}<link name="$(find robot)"/></robot>')
    assert f'<link name="{tmp_path}/robot"/>' in read_robot_description(file).decode()
    file.write_text(f"{HEAD}<link name=\"${{xacro.load_yaml('../secret.yaml')}}\"/></robot>")
    with pytest.raises(InputError, match="outside of the folders that may be read"):
        read_robot_description(file)


def test_entities_do_not_grow(tmp_path: Path) -> None:
    entities = "".join(f'<!ENTITY a{i + 1} "{f"&a{i};" * 10}">' for i in range(12))
    refusal(tmp_path, f'<!DOCTYPE robot [<!ENTITY a0 "aaaa">{entities}]><robot name="a"><link>&a12;</link></robot>')


def test_a_file_of_an_entity_is_not_read(tmp_path: Path) -> None:
    (tmp_path / "secret").write_text(SECRET)
    file = tmp_path / "robot.urdf.xacro"
    file.write_text(f'<!DOCTYPE robot [<!ENTITY a SYSTEM "file://{tmp_path}/secret">]><robot><link>&a;</link></robot>')
    assert SECRET.encode() not in read_robot_description(file)


def python(program: str) -> subprocess.CompletedProcess[str]:
    """Run a program after a process has confined itself: what would an attacker do who got as far as to run one."""
    return subprocess.run(
        [sys.executable, "-c", program],
        env={**os.environ, "TOKEN": SECRET},
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )


KERNEL = "from calibration.robot.confinement import *; restrict_by_kernel([Path({!r})]) or sys.exit(77)\n"
AUDIT = "from calibration.robot.confinement import *; import socket; restrict_by_audit([Path({!r})])\n"


@pytest.mark.parametrize("place", ["/proc/{parent}/environ", "/proc/{parent}/mem", "/etc/passwd", "{folder}/../other"])
@pytest.mark.parametrize("layer", [KERNEL, AUDIT])
def test_neither_layer_lets_a_program_read_its_parent_or_another_folder(tmp_path: Path, layer: str, place: str) -> None:
    folder = tmp_path / "folder"
    folder.mkdir()
    (folder / "own").write_text("own")
    (tmp_path / "other").write_text(SECRET)
    where = place.format(parent="'+str(os.getppid())+'", folder=folder)
    attempts = f"print(open({str(folder / 'own')!r}).read())\nprint(open('{where}','rb').read(100))"
    done = python(layer.format(str(folder)) + attempts)
    if done.returncode == 77:
        pytest.skip("this kernel has no Landlock")
    assert done.stdout == "own\n"
    assert "PermissionError" in done.stderr or "RefusedError" in done.stderr


@pytest.mark.parametrize(
    "attempt",
    [
        "os.system('touch {}/pwned')",
        "os.fork()",
        "os.execv('/bin/true', ['true'])",
        "os.posix_spawn('/bin/true', ['true'], {{}})",
        "import subprocess; subprocess.run(['true'])",
        "socket.create_connection(('127.0.0.1', 9))",
        "open('{}/pwned', 'w')",
        "os.open('{}/pwned', os.O_CREAT | os.O_WRONLY)",
        "os.listdir('/')",
        "os.remove('{}/own')",
        "ctypes.CDLL(None)",
    ],
)
def test_a_confined_process_starts_and_writes_nothing(tmp_path: Path, attempt: str) -> None:
    (tmp_path / "own").write_text("")
    done = python(AUDIT.format(str(tmp_path)) + attempt.format(tmp_path))
    assert "RefusedError" in done.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["own"]
