"""Faults: a share of the campaign, and whether it would find anything."""

import re
import sys

import pytest

from tests.campaigns import faults
from tests.campaigns.faults import problem_of


def test_a_share_of_the_campaign() -> None:
    assert [problem for seed in range(6) if (problem := problem_of("tables", seed))] == []


@pytest.mark.thorough
def test_a_second_signal_while_workers_end_is_no_hang(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(faults, "KINDS", ("two signals",))
    assert [problem for seed in range(4) if (problem := problem_of("convergence", seed))] == []


@pytest.mark.parametrize(
    ("code", "problem"),
    [
        ("import time; time.sleep(60)", "not done after"),
        ("raise SystemExit(7)", "exit code 7"),
        ("import tempfile; tempfile.mkdtemp()", "left tmp"),
        ("raise KeyError", "KeyError .*, with a traceback"),
        ("import subprocess; subprocess.Popen(['sleep', '60'], stderr=subprocess.DEVNULL)", "a process is left"),
    ],
)
def test_what_goes_wrong_is_found(code: str, problem: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(faults, "SECONDS", 1)
    monkeypatch.setattr(faults, "undisturbed", lambda _: (0.5, 0))
    monkeypatch.setattr(faults, "KINDS", ("stdout",))
    monkeypatch.setattr(faults, "PROGRAM", (sys.executable, "-c", code))
    assert re.search(problem, problem_of("tables", 1) or "")
