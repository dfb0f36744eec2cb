import pytest

from calibration.errors import InputError
from calibration.execution.backends import check_backend, docker_backend
from calibration.execution.docker.backend import DockerBackend


def test_by_name() -> None:
    check_backend("embedded")
    check_backend("docker")
    assert isinstance(docker_backend(run="r"), DockerBackend)


def test_unknown() -> None:
    with pytest.raises(
        InputError, match=r"backend: found 'doker', expected embedded or docker: did you mean 'docker'\?"
    ):
        check_backend("doker")


@pytest.mark.parametrize("name", ["", "a b", "-x", "x" * 62, "a/b"])
def test_the_name_of_a_run(name: str) -> None:
    with pytest.raises(InputError, match="expected letters, digits"):
        DockerBackend(run=name)
