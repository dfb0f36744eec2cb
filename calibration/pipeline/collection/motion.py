"""The motion that a request names: a file, a generated one, or the system's own."""

from pathlib import Path

from calibration.errors import InputError
from calibration.pipeline.collection.request import GENERATE, CollectionRequest, ContainerRequest, pose_count
from calibration.simulation.motion.generation import generate_motion
from calibration.simulation.motion.sequence import Motion, read_motion
from calibration.simulation.system import MOTION_FILE, System


def required_motion(request: CollectionRequest, system: System, seed: int | None = None) -> Motion:
    """The motion that our own simulation plays; one that is generated is of the request's seed unless another is given.

    Raises:
        InputError: it cannot be read or generated, or there is none.
    """
    path = request.system / MOTION_FILE
    if request.motion is None and not path.exists():
        raise InputError(f"{path}: does not exist; give a motion: a file or {GENERATE}N")
    return _motion(request.motion or str(path), system, request.seed if seed is None else seed)


def optional_motion(request: ContainerRequest, system: System | None) -> Motion | None:
    """The motion that the team's applications are given; None where they have their own.

    Raises:
        InputError: it cannot be read or generated.
    """
    given = request.motion
    if given is None and request.system is not None and (request.system / MOTION_FILE).exists():
        given = str(request.system / MOTION_FILE)
    if given is not None and given.startswith(GENERATE) and system is None:
        raise InputError(f"{request.name}: motion: found '{given}', but a motion is only generated for a system")
    return None if given is None else _motion(given, system, request.seed)


def _motion(given: str, system: System | None, seed: int) -> Motion:
    if system is None or not given.startswith(GENERATE):
        return read_motion(Path(given))
    return generate_motion(system, pose_count(given), seed)
