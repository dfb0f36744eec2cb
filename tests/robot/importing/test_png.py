"""Images as PNG: nothing is lost."""

import cv2
import numpy as np
import pytest

from calibration.robot.importing.image_views import encoded


@pytest.mark.parametrize("shape", [(48, 64), (48, 64, 3), (1, 1), (7, 3, 3)])
@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
def test_what_is_written_reads_back(shape: tuple[int, ...], kind: type[np.generic]) -> None:
    image = np.random.default_rng(0).integers(0, np.iinfo(kind).max, shape, kind)
    back = cv2.imdecode(np.frombuffer(encoded(image), np.uint8), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(back, image)
    assert back.dtype == kind
