import pytest

from tests.engine import PYTHON_IMAGE


@pytest.fixture(autouse=True)
def image(python_image: str) -> str:
    """Every test here runs containers of this image."""
    assert python_image == PYTHON_IMAGE
    return python_image
