"""intrinsics.json: one run's output is the next one's input, and whatever else is in it is refused in one line."""

import json

import numpy as np
import pytest

from calibration.base import InputError
from calibration.engine.estimation.calibrate import Options, calibrate
from calibration.engine.estimation.problem.intrinsics import read_intrinsics, write_intrinsics
from tests.engine.estimation.systems import covering

GOOD = {
    "model": "plumb_bob",
    "parameters": ["fx", "k1"],
    "values": [600.0, 0.1],
    "covariance": [[4.0, 0.01], [0.01, 1e-4]],
}


def write(tmp_path, **changes):
    path = tmp_path / "intrinsics.json"
    path.write_text(json.dumps({"cameras": {"left": {**GOOD, **changes}}}))
    return path


def test_what_is_written_reads_back_and_is_taken(tmp_path):
    dataset = covering(20, pixel_noise=0.3).dataset()
    found = calibrate(dataset, Options(intrinsics=("all",), hold=("intrinsics-c0-k3",)))
    path = tmp_path / "deep" / "intrinsics.json"
    write_intrinsics(path, found.intrinsics, {name: each.camera for name, each in found.dataset.sensors.items()})
    read = read_intrinsics(path)
    assert list(read) == ["c0", "c1"]
    for name, each in found.intrinsics.items():
        assert (read[name].model, read[name].parameters) == (each.model, each.parameters)
        np.testing.assert_array_equal(read[name].values, each.values)
        np.testing.assert_allclose(read[name].covariance, each.covariance, rtol=1e-9)
    again = calibrate(found.dataset, Options(intrinsics_covariance=read))
    plain = calibrate(found.dataset)
    for edge, C in plain.covariances.items():
        assert np.trace(again.covariances[edge]) > 1.5 * np.trace(C)


def test_a_file_by_hand(tmp_path):
    left = read_intrinsics(write(tmp_path))["left"]
    assert left.parameters == ("fx", "k1")
    np.testing.assert_allclose(left.sigmas, [2.0, 0.01])
    assert left.units == ("px", "1")


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"model": "fov"}, "cameras/left/model: found 'fov', expected a known distortion model: plumb_bob, eq"),
        ({"model": 3}, "cameras/left/model: found 3, expected text"),
        ({"parameters": ["fx", "k4"]}, "cameras/left/parameters/1: found 'k4', expected one of fx, fy, cx, cy, k1"),
        ({"parameters": ["fx", "fx"]}, "cameras/left/parameters/1: found 'fx', expected one of fx, fy, cx, cy, k1"),
        ({"parameters": []}, "cameras/left/parameters: found an empty list, expected some of fx"),
        ({"values": [600.0]}, "cameras/left/values: found a list of 1, expected a list of 2 numbers"),
        ({"values": [600.0, float("nan")]}, "cameras/left/values/1: found nan, expected a finite number"),
        ({"values": [1e300, 0.1]}, "cameras/left/values/0: found 1e+300, expected a number from -1e+07 to 1e+07"),
        (
            {"covariance": [[4.0, 0.0]]},
            "cameras/left/covariance: found a list of 1, expected 2 rows, one for each parame",
        ),
        ({"covariance": [[4.0], [1.0]]}, "cameras/left/covariance/0: found a list of 1, expected a list of 2 numbers"),
        (
            {"covariance": [[4.0, 0.0], [0.0, 0.0]]},
            "cameras/left/covariance: found the variance 0 in row 1, expected one",
        ),
        (
            {"covariance": [[-4.0, 0.0], [0.0, 1.0]]},
            "cameras/left/covariance: found the variance -4 in row 0, expected",
        ),
        ({"covariance": [[4.0, 0.1], [0.2, 1.0]]}, "cameras/left/covariance: found a matrix that is not symmetric"),
        (
            {"covariance": [[4.0, 3.0], [3.0, 1.0]]},
            "cameras/left/covariance: found a matrix that is not positive defini",
        ),
        (
            {"covariance": [[4.0, 0.0], [0.0, 1e-250]]},
            "cameras/left/covariance: found the variance 1e-250 in row",
        ),
        ({"covariance": [[4.0, 1e308], [-1e308, 1e-150]]}, "cameras/left/covariance: found a matrix that is not"),
    ],
)
def test_invalid_input_is_reported(tmp_path, changes, said):
    path = write(tmp_path, **changes)
    with pytest.raises(InputError) as error:
        read_intrinsics(path)
    assert str(error.value).startswith(f"{path}: {said}")


@pytest.mark.parametrize("content", ["{}", "[]", '{"cameras": {}}', '{"cameras": [1]}', '{"cameras": {"a": 1}}', ""])
def test_what_is_no_such_file(tmp_path, content):
    path = tmp_path / "intrinsics.json"
    path.write_text(content)
    with pytest.raises(InputError, match=r"intrinsics\.json: "):
        read_intrinsics(path)


def test_a_file_that_is_too_large(tmp_path, monkeypatch):
    path = write(tmp_path)
    monkeypatch.setattr("calibration.engine.estimation.problem.intrinsics.MAX_BYTES", 100)
    with pytest.raises(InputError, match=r"intrinsics\.json: found 142 bytes, a JSON document of at most 100 was"):
        read_intrinsics(path)
