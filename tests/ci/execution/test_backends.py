import pytest

from calibration.base import InputError
from calibration.ci.execution.backends import CONTAINER_BACKENDS, ExecutionTarget, check_backend
from calibration.ci.execution.docker.backend import DockerBackend


def test_by_name() -> None:
    check_backend("embedded")
    check_backend("docker")
    check_backend("aws-batch", CONTAINER_BACKENDS)
    backend = ExecutionTarget(run="r").open()
    assert isinstance(backend, DockerBackend)
    assert backend.run_name == "r"


def test_unknown() -> None:
    with pytest.raises(
        InputError, match=r"backend: found 'doker', expected embedded, docker or aws-batch: did you mean 'docker'\?"
    ):
        check_backend("doker")
    with pytest.raises(InputError, match="backend: found 'embedded', expected docker or aws-batch"):
        check_backend("embedded", CONTAINER_BACKENDS)


def test_a_cloud_backend_without_settings() -> None:
    with pytest.raises(InputError, match=r"its settings are missing: expected a section aws-batch in calibration\.yml"):
        ExecutionTarget("aws-batch").open()


@pytest.mark.parametrize("name", ["", "a b", "-x", "x" * 62, "a/b"])
def test_the_name_of_a_run(name: str) -> None:
    with pytest.raises(InputError, match="expected letters, digits"):
        DockerBackend(run=name)
