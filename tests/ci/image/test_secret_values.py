import io
import os
from pathlib import Path

import pytest

from calibration.base import InputError
from calibration.ci.github.service import GITHUB
from calibration.ci.image.build_request import MAX_BYTES, read_secrets, refuse_secrets_in, secret_files
from calibration.ci.image.specification import Secret
from calibration.ci.workflow import Runner

VALUE = "hunter2-hunter2"


def test_read_masked_and_hidden(tmp_path: Path) -> None:
    (tmp_path / "key").write_bytes(b"\xff" + VALUE.encode() + b"\n")
    runner = Runner(GITHUB, stdout=io.StringIO())
    found = read_secrets([Secret("a", "TOKEN"), Secret("b", file=tmp_path / "key")], runner, {"TOKEN": VALUE})
    assert [(secret.id, secret.value) for secret in found] == [
        ("a", VALUE.encode()),
        ("b", b"\xff" + VALUE.encode() + b"\n"),
    ]
    assert "hunter2" not in repr(found)
    assert isinstance(runner.stdout, io.StringIO)
    assert f"::add-mask::{VALUE}" in runner.stdout.getvalue()


def test_missing(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="secrets: a: the environment variable TOKEN is not set or empty"):
        read_secrets([Secret("a", "TOKEN")], Runner(), {"TOKEN": " "})
    with pytest.raises(InputError, match="the secret a was expected, but it cannot be read"):
        read_secrets([Secret("a", file=tmp_path / "no")], Runner())
    with (tmp_path / "big").open("wb") as file:
        file.truncate(MAX_BYTES + 1)
    with pytest.raises(InputError, match="the secret a of at most"):
        read_secrets([Secret("a", file=tmp_path / "big")], Runner())


def test_files_for_this_user_alone_and_not_for_long() -> None:
    secrets = read_secrets([Secret("a", "A"), Secret("b/../c", "B")], Runner(), {"A": "1", "B": "2"})
    with secret_files(secrets) as files:
        assert {name: path.read_text() for name, path in files.items()} == {"a": "1", "b/../c": "2"}
        assert {path.stat().st_mode & 0o777 for path in files.values()} == {0o600}
        assert {path.parent.stat().st_mode & 0o777 for path in files.values()} == {0o700}
        kept = list(files.values())
    assert not any(map(os.path.exists, kept))


def test_a_secret_that_the_image_would_show() -> None:
    secrets = read_secrets([Secret("a", "A"), Secret("short", "B")], Runner(), {"A": VALUE + "\n", "B": "x"})
    refuse_secrets_in(secrets, {"the Dockerfile": "FROM x"})
    with pytest.raises(InputError, match=r"secrets: a: its value occurs in labels\.team") as error:
        refuse_secrets_in(secrets, {"labels.team": f"my {VALUE}!"})
    assert "hunter2" not in str(error.value)
