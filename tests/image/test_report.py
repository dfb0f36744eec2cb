import pytest

from calibration.image.builders.failure import BuildFailedError
from calibration.image.building import BuiltImage
from calibration.image.report import Report


@pytest.mark.parametrize(
    ("image", "sentence"),
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
def test_the_sentence(image: BuiltImage, sentence: str) -> None:
    assert Report(image, seconds=2.5).sentence() == sentence


def test_outputs_name_every_tag_once() -> None:
    image = BuiltImage("r:key-1", "1", built=True, tags=("r:a", "r:b"))
    assert Report(image, promoted=("r:b", "r:c")).outputs()["tags"] == ["r:a", "r:b", "r:c"]


def test_a_failure_without_lines_and_hostile_text() -> None:
    report = Report(failure=BuildFailedError("r", "step 1 of 1, RUN <b>|`x`", "exit code 1"))
    assert (
        report.markdown() == "## build-image: fail: image r: step 1 of 1, RUN &lt;b&gt;&#124;\\`x\\`: exit code 1\n\n"
    )
