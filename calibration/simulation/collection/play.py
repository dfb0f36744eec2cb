"""A motion played by a system: where everything stands at each pose, as it is and as it was designed."""

from dataclasses import dataclass, replace

from calibration.errors import InputError
from calibration.simulation.motion.sequence import Motion
from calibration.simulation.placement import Placement, place
from calibration.simulation.system import System


@dataclass(frozen=True, eq=False)
class Play:
    """What a collection at any of N poses depends on."""

    system: System
    motion: Motion
    seed: int
    true: Placement
    """Where everything is."""
    nominal: Placement
    """Where it would be if the robot were as it was designed."""

    def __len__(self) -> int:
        return len(self.motion)


def play(system: System, motion: Motion, seed: int) -> Play:
    """Place a system at the poses of a motion.

    Raises:
        InputError: the motion does not fit the system (see `place`), or brings a sensor into a box
            or under the ground.
    """
    true = place(system, motion)
    free = true.sensors_are_free(system.scene)
    if not free.all():
        raise InputError(f"{motion.source}: a sensor is in a box or under the ground in pose {free.argmin() + 1}")
    nominal = true if system.nominal is system.robot else place(replace(system, robot=system.nominal), motion)
    return Play(system, motion, seed, true, nominal)
