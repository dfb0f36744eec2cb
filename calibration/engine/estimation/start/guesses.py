"""Initial values of a problem from noisy guesses."""

from functools import cached_property
from operator import eq

from calibration.base.latest import Latest
from calibration.engine.estimation.problem.blocks import Values
from calibration.engine.estimation.start.build import Setup
from calibration.engine.estimation.start.initial_values import initial_values
from calibration.engine.estimation.start.linear_start import (
    LinearStart,
    Sight,
    free_patterns,
    linear_start,
    pattern_poses,
    sights_of,
)
from calibration.engine.estimation.start.starting_noise import StartingNoise, perturb


class Guesses:
    """Initial values of a problem from noisy guesses; what does not depend on the noise is computed once."""

    def __init__(self, setup: Setup) -> None:
        """Begin with a problem."""
        self.setup = setup
        self._noisy: Latest[StartingNoise, Values] = Latest(eq)

    def linear(self, noise: StartingNoise) -> LinearStart:
        """Return the linear initial values; those that it does not give are from the noisy guess.

        Raises:
            UndeterminedError: a robot's motion is too small to separate a sensor's mount from the pattern's.
            InputError: no view determines a pattern's pose.
        """
        return linear_start(self.setup, self._perturbed(noise), self._sights)

    def given(self, noise: StartingNoise) -> Values:
        """Return the noisy guess; patterns, as in ATOM, are where the cameras see them from the guess without noise.

        Raises:
            InputError: no camera sees a fixed pattern.
        """
        patterns = free_patterns(self.setup)
        return tuple(self._patterns[i] if i in patterns else T for i, T in enumerate(self._perturbed(noise)))

    def _perturbed(self, noise: StartingNoise) -> Values:
        return self._noisy.of(noise, lambda: perturb(self.setup, self._without_noise, noise))

    @cached_property
    def _without_noise(self) -> Values:
        return initial_values(self.setup, self._sights)

    @cached_property
    def _sights(self) -> tuple[Sight, ...]:
        return sights_of(self.setup.problem)

    @cached_property
    def _patterns(self) -> Values:
        """Values with the patterns' poses in the cameras' views, and all other blocks at the guess without noise."""
        return pattern_poses(self.setup, self._without_noise, self._sights)
