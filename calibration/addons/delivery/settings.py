"""Section ``delivery`` of calibration.yml, and the inputs of the command ``bundle``."""

from pathlib import Path
from typing import Annotated

from calibration.addons.delivery.manifest import Version
from calibration.base.records import UNIQUE, field, length, matching, record

KEY_VARIABLE = "CALIBRATION_SIGNING_KEY"
"""Environment variable with the private key."""
FileName = Annotated[str, matching("[A-Za-z0-9][A-Za-z0-9_.-]{0,63}", "letters, digits and _ . -, at most 64 of them")]


@record(kw_only=True)
class DeliverySettings:
    """Bundle of what systems that passed and are accepted leave for their robot, a stage of run."""

    name: FileName | None = field("Name of the robot (that of its system; with several systems: robot).", default=None)
    serial: Annotated[str, length(1, 200)] | None = field("Serial number of the robot.", default=None)
    version: Version | None = field(
        "Version of the bundle, such as 1.4.2: a later one must be larger (date and time of the commit: "
        "20261127.204413).",
        default=None,
    )
    systems: Annotated[tuple[str, ...], UNIQUE] = field(
        "Only these systems, all of which must have passed and be accepted (those that are).", default=()
    )
    signing_key_file: Path | None = field(
        f"File with the private key that signs, Ed25519 in PEM (the variable {KEY_VARIABLE}).", default=None
    )
