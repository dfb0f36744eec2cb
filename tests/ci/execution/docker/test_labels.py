import os
import subprocess
import sys
from dataclasses import replace

import pytest

from calibration.ci.execution.docker import labels
from calibration.ci.execution.docker.labels import Owner


def test_this_process_lives_and_its_labels_say_who_it_is() -> None:
    owner = Owner.this_process()
    assert Owner.from_labels({**owner.labels, "other": "x"}) == owner
    assert not owner.is_dead


def test_a_process_that_ended_is_dead() -> None:
    code = "from calibration.ci.execution.docker.labels import Owner; print(Owner.this_process().process)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert replace(Owner.this_process(), process=done.stdout.strip()).is_dead


def test_another_process_of_the_same_number_is_not_him() -> None:
    assert replace(Owner.this_process(), started="1").is_dead


def test_a_machine_that_was_started_anew_has_forgotten_him() -> None:
    assert replace(Owner.this_process(), boot="another").is_dead


@pytest.mark.parametrize("elsewhere", [{"host": "another"}, {"namespace": "pid:[1]", "process": "999999"}])
def test_who_is_somewhere_else_may_live(elsewhere: dict[str, str]) -> None:
    assert not replace(Owner.this_process(), **elsewhere).is_dead


@pytest.mark.parametrize("name", ["host", "boot", "namespace", "process", "started"])
def test_labels_of_another_version_say_nothing(name: str) -> None:
    found = Owner.this_process().labels
    del found[f"ci.calibration.owner.{name}"]
    assert Owner.from_labels(found) is None
    assert Owner.from_labels({}) is None
    assert Owner.from_labels({**Owner.this_process().labels, "ci.calibration.owner.process": "-1"}) is None


def test_a_machine_without_proc(monkeypatch: pytest.MonkeyPatch) -> None:
    def nothing(*_: object) -> str:
        raise OSError

    monkeypatch.setattr(labels.Path, "read_text", nothing)
    monkeypatch.setattr(labels.Path, "readlink", nothing)
    owner = Owner.this_process()
    assert (owner.process, owner.boot, owner.started) == (str(os.getpid()), "", "")
    assert Owner.from_labels(owner.labels) is None  # so it is never taken for dead
    assert not owner.is_dead
