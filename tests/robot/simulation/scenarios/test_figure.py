import sys

import cv2
import numpy as np
import pytest

from calibration.base.errors import InfrastructureError
from calibration.robot.simulation.scenarios.figure import figure
from calibration.robot.simulation.scenarios.scenario import ScenarioResult
from calibration.robot.simulation.scenarios.statistics import Statistics


def report(count: int, lost: int = 0) -> Statistics:
    random = np.random.default_rng(0)
    return Statistics(
        [
            ScenarioResult(
                f"s1-{i:05d}",
                "0" * 12,
                {"motion.sway_mm": float(sway), r"$\frac$.bow_x_mm": float(bow)},
                converged=i >= lost,
                translation_mm=float(0.1 + sway + bow**2) if i >= lost else None,
                rotation_deg=float(0.01 + sway / 30) if i >= lost else None,
            )
            for i, (sway, bow) in enumerate(zip(random.random(count), random.standard_normal(count), strict=True))
        ]
    )


@pytest.mark.parametrize(("count", "lost"), [(40, 3), (3, 3), (1, 0)])
def test_any_report_is_drawn(count: int, lost: int) -> None:
    png = figure(report(count, lost), r"Scenarios of $\frac$", translation_limit=1, rotation_limit=0.1)
    image = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR)
    assert image.shape == (770, 1100, 3)
    assert np.ptp(image) > 100


def test_the_same_report_gives_the_same_picture() -> None:
    png = figure(report(5), "5 scenarios")
    assert png == figure(report(5), "5 scenarios")
    assert b"matplotlib" not in png
    assert png != figure(report(5, 1), "5 scenarios")


def test_without_matplotlib_the_error_names_the_package(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(InfrastructureError, match=r"pip install matplotlib"):
        figure(report(3), "3 scenarios")
