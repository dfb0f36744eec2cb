"""Labels that do not fit: noted, warned of, or red, by their share."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calibration.engine.dataset.model import CornerLabels, Dataset
from calibration.engine.dataset.reading import read_dataset
from calibration.engine.diagnosis.limits import Limits
from calibration.engine.diagnosis.rejected_labels import rejected_labels
from calibration.engine.estimation.calibrate import calibrate
from calibration.engine.estimation.covariance.result import RejectedLabel
from tests.engine.estimation.scenes import Labels, relabelled
from tests.engine.estimation.systems import stereo


def with_wrong(dataset: Dataset, share: float, size: float, view: int | None = None) -> Dataset:
    """The dataset with a share of the corners moved by this many pixels: of all views of left, or of one."""
    rng = np.random.default_rng(1)

    def move(i: int, sensor: str, label: Labels) -> Labels:
        if not isinstance(label, CornerLabels) or sensor != "left" or view not in (None, i):
            return label
        wrong = rng.permutation(len(label.ids)) < round(share * len(label.ids))
        return replace(label, pixels=label.pixels + size * wrong[:, None])

    return relabelled(dataset, move)


@pytest.mark.parametrize(
    ("share", "size", "severity"),
    [(0.0, 0.0, None), (0.12, 1.1, "note"), (0.05, 20.0, "warning"), (0.12, 20.0, "red")],
)
def test_by_their_share_and_size(share: float, size: float, severity: str | None) -> None:
    dataset = with_wrong(stereo(8, pixel_noise=0.2).dataset(), share, size)
    found = rejected_labels(calibrate(dataset), Limits())
    assert [each.severity for each in found] == ([severity] if severity else [])
    if severity in ("warning", "red"):
        assert found[0].sensors == ("left",)
        assert found[0].value == pytest.approx(share / 2, abs=0.01)
        assert f"of {2 * 8 * len(dataset.patterns['board'].corners)} labels do not fit" in found[0].text


def test_one_view_is_named() -> None:
    found = rejected_labels(calibrate(with_wrong(stereo(40, pixel_noise=0.2).dataset(), 0.3, 20.0, view=7)), Limits())
    assert [(each.kind, each.severity, each.collections) for each in found] == [
        ("rejected-view", "warning", ("007",)),
        ("rejected-labels", "note", ("007",)),
    ]


def test_real_images_have_tails(shared_data: Path) -> None:
    [note] = rejected_labels(calibrate(read_dataset(shared_data / "t2rgb-paper")), Limits())
    assert note.severity == "note"


@pytest.mark.parametrize(("view", "severities"), [(0, ["red", "note"]), (39, ["red", "note"]), (20, ["note"])])
def test_a_view_at_an_end_that_does_not_fit_has_moved(view: int, severities: list[str]) -> None:
    calibration = calibrate(stereo(40, pixel_noise=0.1).dataset())
    key, count = f"{view:03}", len(calibration.dataset.patterns["board"].corners)
    rejected = tuple(RejectedLabel(key, "left", "board", "pixel", i, 0.9) for i in range(count * 2 // 3))
    calibration = replace(calibration, rejected=rejected)
    found = rejected_labels(calibration, Limits(translation_mm=0.1))
    assert [each.severity for each in found] == severities
    assert all(f"collection {key}, at an end" in each.text for each in found if each.severity == "red")
    [note] = rejected_labels(calibration, Limits(translation_mm=100.0))  # the labels are off by far less than that
    assert note.severity == "note"
