import pytest

from tests.docker_engine import PYTHON_IMAGE


@pytest.fixture(autouse=True)
def image_of_all_containers(python_image: str) -> str:
    """Return it; the name must not be that of a parameter of a test, which would take its place."""
    assert python_image == PYTHON_IMAGE
    return python_image
