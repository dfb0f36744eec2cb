from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from calibration.base import InputError
from calibration.robot.simulation.motion import read_motion
from calibration.robot.simulation.scenarios import scenario as module
from calibration.robot.simulation.scenarios.scenario import Scenario, content_hash, parse_id, scenario_id
from calibration.robot.simulation.system import System
from tests.robot.simulation.conftest import DATASETS

SCENARIO = Scenario(1, 17, {"light.ambient": 0.5, "light.intensity": 0.1})


@given(st.integers(0, 2**53 - 1), st.integers(0, 10**8 - 1))
def test_an_id_finds_its_scenario(seed: int, index: int) -> None:
    assert parse_id(scenario_id(seed, index)) == (seed, index)
    assert parse_id(Scenario(seed, index, {}).id) == (seed, index)


def test_ids_look_like_this() -> None:
    assert SCENARIO.id == "s1-00017"


@pytest.mark.parametrize(
    "text",
    [
        "",
        "17",
        "s1",
        "s1-17",
        "s01-00017",
        "s-1-00017",
        "s1-00017 ",
        "s1-000017",
        "S1-00017",
        "s9999999999999999-00000",
    ],
)
def test_what_is_no_id_is_refused(text: str) -> None:
    with pytest.raises(InputError, match=r"expected an id such as s1-00017"):
        parse_id(text)


def test_a_scenario_draws_its_own_numbers() -> None:
    others = [replace(SCENARIO, seed=2), replace(SCENARIO, index=18), replace(SCENARIO, attempt=1)]
    seeds = {scenario.collection_seed for scenario in (SCENARIO, *others)}
    assert len(seeds) == 4
    assert replace(SCENARIO, values={}).collection_seed == SCENARIO.collection_seed


def test_the_hash_is_of_all_that_matters(systems: dict[str, System], monkeypatch: pytest.MonkeyPatch) -> None:
    system = systems["t2rgb"]
    motion = read_motion(DATASETS / "t2rgb" / "motion.json")
    first = content_hash(system, SCENARIO)
    changed = {
        first,
        content_hash(systems["riwbot"], SCENARIO),
        content_hash(replace(system, sources={**system.sources, "robot.urdf": b""}), SCENARIO),
        content_hash(system, replace(SCENARIO, seed=2)),
        content_hash(system, replace(SCENARIO, index=18)),
        content_hash(system, replace(SCENARIO, attempt=1)),
        content_hash(system, replace(SCENARIO, values={**SCENARIO.values, "light.ambient": 0.500001})),
        content_hash(system, replace(SCENARIO, values={"light.ambient": 0.5})),
        content_hash(system, SCENARIO, motion),
        content_hash(system, SCENARIO, motion.take([0, 1])),
    }
    monkeypatch.setattr(module, "__version__", "next")
    changed.add(content_hash(system, SCENARIO))
    assert len(changed) == 11
    assert all(len(each) == 12 and int(each, 16) >= 0 for each in changed)


def test_the_hash_is_of_nothing_else(systems: dict[str, System]) -> None:
    system = systems["t2rgb"]
    turned = dict(reversed(SCENARIO.values.items()))
    motion = read_motion(DATASETS / "t2rgb" / "motion.json")
    assert content_hash(system, replace(SCENARIO, values=turned)) == content_hash(system, SCENARIO)
    assert content_hash(replace(system, name="copy"), SCENARIO) == content_hash(system, SCENARIO)
    assert content_hash(system, SCENARIO, replace(motion, source="elsewhere.json")) == content_hash(
        system, SCENARIO, motion
    )
