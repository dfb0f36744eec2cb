import sys
from pathlib import Path

import pytest

from calibration.addons.coverage.tests import CommandOfTests, parse_command
from calibration.base import InputError
from tests.repositories import write


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A project, with programs of its own that do nothing; ``bin/python3`` is ours."""
    write(
        tmp_path,
        {
            "tests/test_a.py": "",
            "robot/__init__.py": "",
            "robot/tests/__init__.py": "",
            "bin/make": "#!/bin/sh\n",
            "bin/pytest": "#!/bin/sh\n",
            "run tests.sh": "#!/bin/sh\n",
            "bin/no-pytest": "#!/bin/sh\nexit 1\n",
            "bin/broken": "#!/no/such/interpreter\n",
        },
    )
    for program in [*(tmp_path / "bin").iterdir(), tmp_path / "run tests.sh"]:
        program.chmod(0o755)
    (tmp_path / "bin/python3").symlink_to(sys.executable)
    return tmp_path


def parse(folder: Path, text: str, interpreter: str | None = None, path: str | None = None) -> CommandOfTests:
    environment = {"PATH": str(folder / "bin") if path is None else path}
    return parse_command(text, folder, interpreter, environment, Path("/out/tests.xml"))


JUNIT = ["--junitxml=/out/tests.xml", "--override-ini=junit_family=xunit1"]


@pytest.mark.parametrize(
    ("text", "interpreter", "arguments"),
    [
        ("pytest -q 'a test'", None, ["pytest", "-q", "a test", *JUNIT]),
        ("pytest -q", "{bin}/python3", ["{bin}/python3", "-m", "pytest", "-q", *JUNIT]),
        ("pytest", "python3", ["{bin}/python3", "-m", "pytest", *JUNIT]),
        ("py.test x", None, ["{bin}/python3", "-m", "pytest", "x", *JUNIT]),
        ("python3 -W error -m pytest", None, ["python3", "-W", "error", "-m", "pytest", *JUNIT]),
        ("python -m unittest", None, ["{bin}/python3", "-m", "unittest"]),
        ("python3 -m unittest -v a.b", "{bin}/python3", ["{bin}/python3", "-m", "unittest", "-v", "a.b"]),
        ("{bin}/python3 -m unittest", None, ["{bin}/python3", "-m", "unittest"]),
        ("unittest a.b", None, ["{bin}/python3", "-m", "unittest", "a.b"]),
        ("unittest tests", None, ["{bin}/python3", "-m", "unittest", "discover", "-s", "tests"]),
        ("unittest robot/tests", None, ["{bin}/python3", "-m", "unittest", "discover", "-s", "robot/tests", "-t", "."]),
        ("tests", None, ["{bin}/python3", "-m", "pytest", "tests", *JUNIT]),
        ("tests", "no-pytest", ["{bin}/no-pytest", "-m", "unittest", "discover", "-s", "tests"]),
        ("make test; echo $HOME && exit", None, ["make", "test;", "echo", "$HOME", "&&", "exit"]),
        ("'./run tests.sh' pytest", None, ["./run tests.sh", "pytest"]),
        ("make run pytest -x", None, ["make", "run", "pytest", "-x", *JUNIT]),
    ],
)
def test_what_is_run(folder: Path, text: str, interpreter: str | None, arguments: list[str]) -> None:
    programs = str(folder / "bin")
    given = None if interpreter is None else interpreter.replace("{bin}", programs)
    text = text.replace("{bin}", programs)
    found = parse(folder, text, given)
    assert list(found.arguments) == [argument.replace("{bin}", programs) for argument in arguments]
    assert found.text == text


@pytest.mark.parametrize(
    ("text", "junit"),
    [
        ("pytest", "/out/tests.xml"),
        ("pytest --junitxml=mine.xml", "{folder}/mine.xml"),
        ("pytest --junit-xml mine.xml -q", "{folder}/mine.xml"),
        ("pytest --junitxml /abs/mine.xml", "/abs/mine.xml"),
        ("pytest --junitxml", "/out/tests.xml"),  # pytest will say what is wrong
        ("make", None),
    ],
)
def test_where_pytest_writes_its_results(folder: Path, text: str, junit: str | None) -> None:
    found = parse(folder, text)
    assert found.junit == (None if junit is None else Path(junit.replace("{folder}", str(folder))))
    if "mine" in text:
        assert list(found.arguments) == text.split()  # nothing is added


@pytest.mark.parametrize(
    ("text", "interpreter", "path", "message"),
    [
        ("", None, None, "tests is empty"),
        (" ", None, None, "tests is empty"),
        ("pytest 'x", None, None, 'tests: "pytest \'x" cannot be split into arguments: No closing quotation'),
        ("no-such", None, None, "tests: there is no program 'no-such' (the command is not run by a shell"),
        ("./no-such.sh", None, None, "there is no program './no-such.sh'"),
        ("pytest", "no-python", None, "interpreter: 'no-python' is not a program"),
        ("make test", "python3", None, "interpreter is given, but 'make' uses its own"),
        ("unittest", None, "/nowhere", "tests: there is no python3 on the PATH"),
        ("tests", None, "/nowhere", "tests: there is no python3 on the PATH"),
        ("tests", "broken", None, "broken does not run: "),
    ],
)
def test_what_cannot_be_run(folder: Path, text: str, interpreter: str | None, path: str | None, message: str) -> None:
    with pytest.raises(InputError) as refused:
        parse(folder, text, interpreter, path)
    assert message in str(refused.value)
