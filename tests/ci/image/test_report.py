import io

import pytest

from calibration.ci.github.service import GITHUB
from calibration.ci.image.building import BuildResult, BuiltImage, Failure, report
from calibration.ci.report import Report
from calibration.ci.workflow import Runner
from calibration.ci.workflow.runner import TERMINAL


def make(image: BuiltImage | None = None, runner: Runner | None = None, **fields: object) -> Report:
    return report(BuildResult(**((vars(image) if image else {}) | fields)), "calibration.yml", runner or Runner())


@pytest.mark.parametrize(
    ("image", "line"),
    [
        (BuiltImage("r:key-1", "1", built=True), "pass: r:key-1: built (2.5 s)"),
        (
            BuiltImage("r:key-1", "1", built=False, found_in="local"),
            "pass: r:key-1: unchanged, found on the engine (2.5 s)",
        ),
        (
            BuiltImage("r:key-1", "1", built=False, found_in="registry"),
            "pass: r:key-1: unchanged, found in the registry (2.5 s)",
        ),
    ],
)
def test_the_verdicts_line(image: BuiltImage, line: str) -> None:
    assert make(image, seconds=2.5).line == line


def test_outputs_name_every_tag_once() -> None:
    image = BuiltImage("r:key-1", "1", built=True, tags=("r:a", "r:b"))
    assert make(image, promoted=("r:b", "r:c")).outputs["tags"] == ["r:a", "r:b", "r:c"]


def test_a_failure_without_lines_and_hostile_text() -> None:
    found = make(failure=Failure("image r: step 1 of 1, RUN <b>|`x`: exit code 1", ()))
    assert found.markdown() == "## Image: fail: image r: step 1 of 1, RUN &lt;b&gt;&#124;\\`x\\`: exit code 1\n"
    assert (found.exit_code, found.document["reasons"]) == (1, ["image r: step 1 of 1, RUN <b>|`x`: exit code 1"])


@pytest.mark.parametrize(("terminal", "github"), [(True, False), (False, False), (True, True)])
def test_a_terminal_is_shown_the_last_lines_of_the_step(terminal: bool, github: bool) -> None:
    class Log(io.StringIO):
        def isatty(self) -> bool:
            return terminal

    failure = Failure("image r: step 1 of 1", ("one", "two"))
    found = make(failure=failure, runner=Runner(GITHUB if github else TERMINAL, stdout=Log()))
    assert found.log() == ("one\ntwo" if terminal and not github else "")
