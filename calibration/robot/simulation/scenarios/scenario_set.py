"""Scenario sets: distributions of the parameters that vary between scenarios, and constraints on them.

A scenario set is YAML, such as::

    light: {elevation_deg: {uniform: [20, 80]}, azimuth_deg: {uniform: [-180, 180]}}
    cameras: {noise_levels: {log_uniform: [0.5, 4]}, k1: {normal: [0, 0.05]}}
    sensors: {left_camera: {exposure: 1.5}}
    assembly: {translation_mm: {normal: [0, 3]}, rotation_deg: {normal: [0, 0.5]}}
    occluders: {count: {integer: [0, 3]}, size_m: {uniform: [0.05, 0.2]}}
    constraints:
      - {parameter: scene.clearance_m, min: 0.1}

The parameters are in `calibration.robot.simulation.scenarios.parameters`, the distributions are in
`calibration.robot.simulation.scenarios.distributions`, the constraints in
`calibration.robot.simulation.scenarios.constraints`.

Scenario i of seed s is addressed directly: each of its values depends on s, i and the parameter's
name alone, so any subset of the scenarios has the same values, in any order and on any machine, and
adding a parameter to the set does not change the values of the others.
"""

from collections import Counter
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from calibration.base.documents import read_yaml
from calibration.base.errors import InputError
from calibration.base.records import Place, read
from calibration.base.text import shorten
from calibration.robot.simulation.scenarios.constraints import CLEARANCE_KEY, Constraint, ConstraintEntry, broken
from calibration.robot.simulation.scenarios.parameters import Parameters, ScenarioSetFile, parameters_of
from calibration.robot.simulation.scenarios.scenario import Scenario
from calibration.robot.simulation.scenarios.world import build_world, clearance
from calibration.robot.simulation.system import System

MAX_ATTEMPTS = 100
"""Limit of the draws of one scenario until it satisfies all constraints."""


@dataclass(frozen=True, eq=False)
class ScenarioSet:
    """Scenarios of one system."""

    path: Path
    """File that it was read from."""
    system: System
    """System as described, which the scenarios vary."""
    parameters: Parameters
    constraints: tuple[Constraint, ...]

    def scenario(self, seed: int, index: int) -> Scenario:
        """Draw scenario ``index`` of a seed.

        Raises:
            InputError: `MAX_ATTEMPTS` draws in a row broke a constraint; names the one that was broken most often.
        """
        failures: Counter[int] = Counter()
        for attempt in range(MAX_ATTEMPTS):
            scenario = self._draw_scenario(seed, index, attempt)
            fault = broken(self.constraints, scenario.values, partial(self._clearance_of, scenario))
            if fault < 0:
                return scenario
            failures[fault] += 1
        worst, count = failures.most_common(1)[0]
        raise InputError(
            f"{self.path}: constraints.{worst}: '{self.constraints[worst].text}' is broken by {count} of "
            f"{MAX_ATTEMPTS} draws of scenario {scenario.id}, and another by the rest; "
            "loosen it, or narrow the distributions"
        )

    def _clearance_of(self, scenario: Scenario) -> float:
        return clearance(build_world(self.system, scenario))

    def _draw_scenario(self, seed: int, index: int, attempt: int) -> Scenario:
        empty = Scenario(seed, index, {}, attempt)
        values = {
            name: distribution.value(empty.random("value", name).random())
            for name, distribution in self.parameters.distributions.items()
        }
        return Scenario(seed, index, values, attempt)


def read_scenario_set(path: Path, system: System) -> ScenarioSet:
    """Read a scenario set for a system.

    Raises:
        InputError: in one line, with file and key: not YAML, an unknown key, a
            invalid distribution, a constraint on a parameter that does not vary.
    """
    place = Place(str(path))
    file = read(ScenarioSetFile, read_yaml(path, "a scenario set"), str(path))
    parameters = parameters_of(file, system, place)

    def constraint(index: int, entry: ConstraintEntry) -> Constraint:
        def named(name: str) -> tuple[str, ...]:
            names = (name,) if name == CLEARANCE_KEY else parameters.named(name)
            if not names:
                known = ", ".join((*parameters.groups, CLEARANCE_KEY))
                where = place.below("constraints").below(index)
                raise where.fault(f"found '{shorten(name)}', which this scenario set does not draw (it draws {known})")
            return names

        return entry.constraint(named)

    constraints = tuple(constraint(index, entry) for index, entry in enumerate(file.constraints))
    return ScenarioSet(path, system, parameters, constraints)
