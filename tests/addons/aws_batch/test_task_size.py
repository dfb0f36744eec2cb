import pytest
from hypothesis import given
from hypothesis import strategies as st

from calibration.addons.aws_batch.definition import TOOLS_MEMORY, Resources, TaskSize, task_size
from calibration.base import InputError

GIB = 1024


def asked(*resources: tuple[float, int]) -> list[Resources]:
    return [Resources(cpus, memory) for cpus, memory in resources]


def is_fargate_size(resources: Resources) -> bool:
    """Sizes as listed in the API reference."""
    memory, cpus = resources.memory, resources.cpus
    gib, rest = divmod(memory, GIB)
    if memory == 512:
        return cpus == 0.25
    if rest:
        return False
    return {
        0.25: gib in (1, 2),
        0.5: 1 <= gib <= 4,
        1: 2 <= gib <= 8,
        2: 4 <= gib <= 16,
        4: 8 <= gib <= 30,
        8: 16 <= gib <= 60 and gib % 4 == 0,
        16: 32 <= gib <= 120 and gib % 8 == 0,
        32: gib in (60, 120, 244),
    }.get(cpus, False)


def test_one_container_of_one_cpu_is_a_task_of_one_cpu() -> None:
    size = task_size(asked((1, 2 * GIB)), "fargate")
    assert size == TaskSize(
        total=Resources(1, 3 * GIB),
        containers=(Resources(0.5, 2 * GIB),),
        prepare=Resources(0.25, 512),
        watch=Resources(0.25, 512),
    )


def test_surplus_memory_is_assigned_to_our_container() -> None:
    size = task_size(asked((2, 100), (0.1, 100)), "fargate")
    assert size.total == Resources(4, 8 * GIB)  # tasks have neither 2.25 CPUs, nor 4 with less memory
    assert [each.memory for each in size.containers] == [100, 100]
    assert [each.cpus for each in size.containers] == [3.25, 0.25]
    assert size.watch.memory == 8 * GIB - 200 - TOOLS_MEMORY


def test_much_memory_needs_more_cpus() -> None:
    assert task_size(asked((0.25, 9 * GIB)), "fargate").total == Resources(2, 10 * GIB)
    assert task_size(asked((1, 200 * GIB)), "fargate").total == Resources(32, 244 * GIB)


def test_whole_cpus_on_ec2() -> None:
    size = task_size(asked((4, 16 * GIB), (0.5, 300)), "ec2")
    assert size.total == Resources(5, 16 * GIB + 300 + 2 * TOOLS_MEMORY)
    assert [each.cpus for each in (*size.containers, size.prepare, size.watch)] == [2, 1, 1, 1]
    assert task_size(asked((1, GIB)), "ec2").total.cpus == 3


@pytest.mark.parametrize("resources", [(33, GIB), (1, 244 * GIB)])
def test_larger_than_any_task(resources: tuple[float, int]) -> None:
    with pytest.raises(InputError, match=r"at most 32 and 249856: ask for less, or use platform ec2"):
        task_size(asked(resources), "fargate")
    assert task_size(asked(resources), "ec2").total.cpus >= resources[0]


@given(
    st.lists(st.tuples(st.floats(0.01, 3.9), st.integers(6, 25 * GIB)), min_size=1, max_size=8),
    st.sampled_from(["fargate", "ec2"]),
)
def test_the_sums_are_the_total_and_every_limit_is_kept(resources: list[tuple[float, int]], platform: str) -> None:
    size = task_size(asked(*resources), platform)  # type: ignore[arg-type]
    everything = [*size.containers, size.prepare, size.watch]
    assert sum(each.cpus for each in everything) == size.total.cpus  # exact, because they are quarters
    assert sum(each.memory for each in everything) == size.total.memory
    assert [each.memory for each in size.containers] == [memory for _, memory in resources]
    assert min(each.memory for each in everything[-2:]) >= TOOLS_MEMORY
    assert size.total.cpus >= sum(cpus for cpus, _ in resources)
    step = 0.25 if platform == "fargate" else 1
    assert all(each.cpus >= step and each.cpus % step == 0 for each in everything)
    assert platform == "ec2" or is_fargate_size(size.total)
