from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from calibration.addons.aws_batch.definition import Resources, Usage, billed, estimate, shape_of, total_size, usage_of
from calibration.addons.aws_batch.settings import Prices
from tests.addons.aws_batch.samples import EC2, SETTINGS, container, job

PRICES = Prices(0.04, 0.005, "EUR")
ONE = Resources(1, 3072)


def test_an_estimate_is_an_upper_bound() -> None:
    jobs = [job(seconds=1800), job(seconds=1800, name="k"), job(seconds=None, name="l")]
    found = estimate([(each, shape_of(each, SETTINGS)) for each in jobs], SETTINGS)
    assert found.usage == Usage(3600, 1, 3)  # a task of 1 CPU and 3 GiB
    assert found.unlimited == 1
    assert found.text(SETTINGS) == (
        "at most 1 vCPU-hours and 3 GB-hours, if no host is lost; not including 1 job without a time limit"
    )
    priced = replace(SETTINGS, prices=PRICES)
    assert found.text(priced).startswith("at most 1 vCPU-hours and 3 GB-hours, 0.06 EUR, if")  # 0.04 + 3 * 0.005


def test_an_estimate_on_instances() -> None:
    found = estimate([(each, shape_of(each, EC2)) for each in [job(seconds=3600)]], EC2)
    assert found.usage == Usage(3600, 3, 3)
    assert found.text(EC2) == "at most 3 vCPU-hours and 3 GB-hours, if no host is lost and instances are filled"


def test_jobs_of_two_shapes() -> None:
    jobs = [job(seconds=3600), job(container("a"), container("b"), container("c"), seconds=3600, name="k")]
    found = estimate([(each, shape_of(each, SETTINGS)) for each in jobs], SETTINGS)
    assert found.usage == Usage(7200, 1 + 4, 3 + 8)


@pytest.mark.parametrize(
    ("milliseconds", "seconds"), [(0, 60), (1_000, 60), (60_000, 60), (60_001, 61), (3_600_000, 3600)]
)
def test_fargate_bills_a_minute_and_then_seconds(milliseconds: int, seconds: int) -> None:
    started = 1_700_000_000_000
    found = billed([(started, started + milliseconds)], ONE, "fargate")
    assert found == Usage(seconds, seconds / 3600, 3 * seconds / 3600)


def test_each_attempt_counts_if_it_ran() -> None:
    attempts = [(1_000, 31_000), (None, 50_000), (60_000, None), (90_000, 80_000), (100_000, 190_000)]
    assert billed(attempts, ONE, "fargate").seconds == 60 + 90
    assert billed(attempts, ONE, "ec2").seconds == 30 + 90
    assert billed([], ONE, "ec2") == billed([(1_000, 1_000)], ONE, "ec2") == Usage()


def test_the_whole_task_is_paid() -> None:
    assert total_size(shape_of(job(), SETTINGS), "fargate") == ONE


@given(st.lists(st.floats(0, 10**6), max_size=5))
def test_usages_add_up(seconds: list[float]) -> None:
    found = sum((usage_of(each, ONE, "ec2") for each in seconds), Usage())
    assert found.seconds >= sum(seconds)
    assert found.price(Prices(3600, 0)) == pytest.approx(found.seconds)
