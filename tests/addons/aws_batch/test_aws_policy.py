import json
from pathlib import Path

import pytest

from calibration.__main__ import _execute
from calibration.addons.aws_batch.aws_policy import command, policy, trust
from calibration.addons.aws_batch.settings import BatchSettings
from calibration.base.records import read
from tests.addons.aws_batch.test_settings import NEEDED


def run(*arguments: str) -> int:
    return _execute(command, "aws-policy", arguments)


@pytest.fixture
def config(tmp_path: Path) -> Path:
    file = tmp_path / "calibration.yml"
    file.write_text(json.dumps({"aws-batch": NEEDED}))
    return file


def test_the_policies(config: Path, capsys: pytest.CaptureFixture[str]) -> None:
    settings = read(BatchSettings, NEEDED, "x")
    for holder, expected in [
        ([], policy("caller", settings)),
        (["--for", "caller"], policy("caller", settings)),
        (["--for", "job"], policy("job", settings)),
        (["--for", "execution"], policy("execution", settings)),
        (["--for", "trust"], trust()),
    ]:
        assert run("--config", str(config), *holder) == 0
        assert json.loads(capsys.readouterr().out) == expected


def test_a_configuration_without_aws(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "calibration.yml"
    file.write_text("systems: []\n")
    assert run("--config", str(file)) == 2
    assert "missing aws-batch" in capsys.readouterr().err


def test_an_unknown_holder(config: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("--config", str(config), "--for", "root") == 2
    assert "'root' is not one of" in capsys.readouterr().err
