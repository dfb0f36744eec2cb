import pytest

from tests.engine import PYTHON_IMAGE


@pytest.fixture(autouse=True)
def image(python_image: str) -> str:
    """Return the image of all containers of these tests."""
    assert python_image == PYTHON_IMAGE
    return python_image
