"""Cost of a run: each job's minutes rounded up, with unknown times reported as such."""

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from calibration.base.records import document_of
from calibration.pipeline.gathering import SECONDS_FILE, Cost, JobTime, Needs, cost_of_run, jobs_table, money
from calibration.pipeline.workflow_plan import JobCell, WorkflowPlan

ONE = JobCell("one", "slug-of-one", "robot", (0.0,), (0.0,))
TWO = JobCell("two", "slug-of-two", "robot", (0.5,), (0.0,))
LATER = JobCell("later", "slug-of-later", "fresh", (0.0,), (0.0,), collected=True)
PLAN = WorkflowPlan((ONE, TWO, LATER), simulations=("fresh",), unit_tests=True, image=True, minute_rate=0.008)
ALL = dict.fromkeys(("plan", "image", "calibrate", "collect-data", "calibrate-collected", "unit-tests"), "success")
SORTED = dict(sorted(ALL.items()))
SECONDS = {"plan": 5, "image": 61, "collect-data": 60, "unit-tests": 0}


def costs(*seconds: int | None, rate: float | None = None) -> Cost:
    return Cost(tuple(JobTime("job", str(i), value) for i, value in enumerate(seconds)), rate)


@pytest.mark.parametrize(("seconds", "minutes"), [(0, 1), (1, 1), (59, 1), (60, 1), (61, 2), (120, 2), (3601, 61)])
def test_a_begun_minute_is_billed(seconds: int, minutes: int) -> None:
    assert JobTime("plan", "plan", seconds).minutes == minutes


def test_the_run_of_the_paper() -> None:
    """Its 0.284 is 35.5 minutes of wall clock times 0.008; what is billed are three jobs, each rounded up."""
    jobs = costs(35 * 60 + 34, 7 * 60 + 51, 18, rate=0.008)
    assert [time.minutes for time in jobs.times] == [36, 8, 1]
    assert jobs.amount == 0.36


@given(st.lists(st.integers(0, 9_999_999), max_size=20), st.floats(0, 1000))
def test_laws_of_cost(seconds: list[int], rate: float) -> None:
    cost = costs(*seconds, rate=rate)
    assert cost.seconds <= cost.minutes * 60 <= cost.seconds + 60 * len(seconds)
    assert cost.amount == pytest.approx(cost.minutes * rate, abs=1e-6)
    assert costs(*seconds, None, rate=rate).minutes == cost.minutes
    assert costs(*seconds).amount is None
    assert cost.sentence.startswith(f"{cost.minutes} billed minutes: ")
    assert costs(*seconds, None).sentence == f"at least {cost.minutes} billed minutes"


@pytest.mark.parametrize(
    ("amount", "text"), [(None, ""), (0.0, "0"), (0.36, "0.36"), (10.0, "10"), (0.000001, "0.000001"), (100.5, "100.5")]
)
def test_money(amount: float | None, text: str) -> None:
    assert money(amount) == text


def left(folder: Path, **seconds: str) -> Path:
    for name, text in seconds.items():
        (folder / f"slug-of-{name}").mkdir()
        (folder / f"slug-of-{name}" / SECONDS_FILE).write_text(text)
    return folder


def test_every_job_that_ran_is_counted(tmp_path: Path) -> None:
    folder = left(tmp_path, one="30\n", two="100\n", later="7\n")
    cost = cost_of_run(PLAN, Needs(SORTED, seconds=SECONDS), folder, 9, promotes=False)
    assert [(time.job, time.name, time.seconds) for time in cost.times] == [
        ("plan", "plan", 5),
        ("image", "image", 61),
        ("calibrate", "one", 30),
        ("calibrate", "two", 100),
        ("collect-data", "collect-data", 60),
        ("calibrate-collected", "later", 7),
        ("unit-tests", "unit-tests", 0),
        ("verdict", "verdict", 9),
    ]
    assert (cost.seconds, cost.minutes, cost.amount) == (272, 10, 0.08)
    assert document_of(cost)["complete"] is True
    assert document_of(cost)["jobs"][3] == {"job": "calibrate", "name": "two", "seconds": 100, "billed_minutes": 2}
    table = jobs_table(ALL, cost).markdown()
    assert table.splitlines() == [
        "| Job | Result | Jobs | Seconds | Billed minutes | Cost at 0.008 a minute |",
        "| --- | --- | --- | --- | --- | --- |",
        "| plan | success | 1 | 5 | 1 | 0.008 |",
        "| image | success | 1 | 61 | 2 | 0.016 |",
        "| calibrate | success | 2 | 130 | 3 | 0.024 |",
        "| collect-data | success | 1 | 60 | 1 | 0.008 |",
        "| calibrate-collected | success | 1 | 7 | 1 | 0.008 |",
        "| unit-tests | success | 1 | 0 | 1 | 0.008 |",
        "| verdict | this job | 1 | 9 | 1 | 0.008 |",
        "| all |  | 8 | 272 | 10 | 0.08 |",
    ]


def test_unknown_times_are_reported_and_not_guessed(tmp_path: Path) -> None:
    folder = left(tmp_path, one="30", two="forty")
    results = {**ALL, "calibrate": "cancelled", "calibrate-collected": "failure", "collect-data": "failure"}
    cost = cost_of_run(PLAN, Needs(results, seconds={"plan": 5}), folder, None, promotes=True)
    assert not document_of(cost)["complete"]
    assert document_of(cost)["jobs"][-1] == {
        "job": "promote",
        "name": "promote",
        "seconds": None,
        "billed_minutes": None,
    }
    assert cost.sentence == "at least 2 billed minutes: 0.016 at 0.008 a minute"
    rows = {line.split(" | ")[0].strip("| "): line for line in jobs_table(results, cost).markdown().splitlines()}
    assert rows["calibrate"] == "| calibrate | cancelled | 2 | 30 + ? | 1 + ? | 0.008 + ? |"
    assert rows["calibrate-collected"] == "| calibrate-collected | failure | 1 | ? | ? | ? |"
    assert rows["promote"] == "| promote | to come | 1 | ? | ? | ? |"
    assert rows["all"] == "| all |  | 9 | 35 + ? | 2 + ? | 0.016 + ? |"


def test_the_upload_of_the_coverage_is_counted(tmp_path: Path) -> None:
    needs = Needs({"plan": "success", "unit-tests": "success", "coverage": "success"}, seconds={"coverage": 61})
    times = cost_of_run(WorkflowPlan(unit_tests=True), needs, tmp_path, 1, promotes=False).times
    assert [(time.job, time.seconds) for time in times if time.seconds] == [("coverage", 61), ("verdict", 1)]


def test_what_did_not_run_costs_nothing(tmp_path: Path) -> None:
    results = {"plan": "success", "image": "failure", "calibrate": "skipped", "unit-tests": "skipped"}
    cost = cost_of_run(PLAN, Needs(results, seconds={"plan": 1, "image": 2}), tmp_path, 3, promotes=False)
    assert [time.job for time in cost.times] == ["plan", "image", "verdict"]
    assert "| calibrate | skipped | 0 | 0 | 0 | 0 |" in jobs_table(results, cost).markdown()


def test_without_a_rate_there_are_minutes_only(tmp_path: Path) -> None:
    cost = cost_of_run(WorkflowPlan(), Needs({"plan": "failure"}, seconds={"plan": 1}), tmp_path, 3, promotes=False)
    table = jobs_table({"plan": "failure"}, cost).markdown()
    assert "Cost" not in table
    assert "| all |  | 2 | 4 | 2 |" in table
    assert document_of(cost)["cost"] is None
