"""What was promised of further poses, against what a later recording has reached."""

from dataclasses import replace

import pytest

from calibration.engine.baseline.calibration_document import CalibratedPose, CalibrationDocument, PromiseDocument
from calibration.engine.baseline.quality import promise_not_kept

POSE = CalibratedPose("base", "camera", (0, 0, 0), (0, 0, 0), "camera", (0.3, 0.3, 0.3), (0.01, 0.01, 0.01), (0,) * 15)
BEFORE = CalibrationDocument(
    data="0" * 64,
    collections=8,
    engine="1",
    poses=(POSE,),
    rejected_labels=0,
    labels=100,
    iterations=3,
    views={"camera": 8},
    covered={},
    promise=PromiseDocument(3, {"camera": {"mm": 0.2}}),
)
LATER = replace(BEFORE, data="1" * 64, collections=11)


@pytest.mark.parametrize(("sigma", "severity"), [(0.1155, None), (0.18, "warning"), (0.16, None), (0.07, "note")])
def test_a_promise_that_is_off_is_stated(sigma: float, severity: str | None) -> None:
    """By more than 1.5, either way: 0.2 mm against the norm of three axes."""
    now = replace(LATER, poses=(replace(POSE, own_mm=(sigma,) * 3),))
    found = list(promise_not_kept(BEFORE, now, "the baseline"))
    assert [each.severity for each in found] == ([severity] if severity else [])
    assert all(each.value == pytest.approx(sigma * 3**0.5, rel=1e-3) for each in found)


FAR = replace(LATER, poses=(replace(POSE, own_mm=(9.0,) * 3),))


@pytest.mark.parametrize(
    ("before", "now"),
    [
        (BEFORE, replace(FAR, collections=10)),
        (BEFORE, replace(FAR, data=BEFORE.data)),
        (replace(BEFORE, promise=None), FAR),
    ],
)
def test_nothing_is_compared_without_the_poses(before: CalibrationDocument, now: CalibrationDocument) -> None:
    """Of a recording with fewer of them, of the same one, and without a promise."""
    assert list(promise_not_kept(before, now, "the baseline")) == []
    assert list(promise_not_kept(BEFORE, FAR, "the baseline"))
