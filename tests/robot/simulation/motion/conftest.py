import pytest

from calibration.robot.simulation.motion.generation import generate_motion
from calibration.robot.simulation.motion.sequence import Motion
from calibration.robot.simulation.system import System


@pytest.fixture(scope="session")
def motions(systems: dict[str, System]) -> dict[str, Motion]:
    """A motion of 24 poses of each system."""
    return {name: generate_motion(system, 24, seed=3) for name, system in systems.items()}
