"""``manifest.json`` of a bundle: what it holds, of which robot, made from what, and how it was judged."""

import re
from collections.abc import Mapping
from itertools import dropwhile
from typing import Annotated, Literal

from calibration.base.documents import parse_json
from calibration.base.errors import InputError
from calibration.base.records import field, length, matching, read, result, text_of
from calibration.base.verdict import Verdict

MANIFEST_FILE = "manifest.json"
MANIFEST_VERSION: Literal[1] = 1
Sha256 = Annotated[str, matching("[0-9a-f]{64}", "64 hexadecimal digits")]
Name = Annotated[str, length(1, 500)]
VERSION_PATTERN = r"[0-9]{1,18}(\.[0-9]{1,18}){0,3}"
Version = Annotated[str, matching(VERSION_PATTERN, "one to four numbers such as 1.4.2")]


BUNDLE_ENDING = ".calibration.tar"
"""End of the name of a bundle's file."""


def is_version(text: str) -> bool:
    """Return whether a text is a version of a bundle."""
    return re.fullmatch(VERSION_PATTERN, text, re.ASCII) is not None


def version_order(version: str) -> tuple[int, ...]:
    """Return the key by which versions are ordered: 1.10 is after 1.9, and 1.0 is 1."""
    numbers = [int(part) for part in version.split(".")]
    return tuple(reversed(list(dropwhile(lambda number: number == 0, reversed(numbers)))))


@result(kw_only=True)
class BundledTransform:
    """Calibrated transform, as it must be in use."""

    parent: Name = field("The parent frame.")
    child: Name = field("The child frame.")
    trans: Annotated[tuple[float, ...], length(3, 3)] = field("Translation.", unit="m")
    quat: Annotated[tuple[float, ...], length(4, 4)] = field("Rotation, a quaternion xyzw.")
    joint: bool = field("Whether it is a joint that moves, at position 0: only a URDF has its origin.", default=False)


@result(kw_only=True)
class BundledCamera:
    """Camera, as it must be in use; its rectification is none, and its projection matrix has K."""

    name: Name = field("The camera.")
    frame: Name = field("Frame of its images.")
    width: int = field("Of its images.", unit="px")
    height: int = field("Of its images.", unit="px")
    distortion_model: Name = field("Lens model, by its name in ROS.")
    K: Annotated[tuple[float, ...], length(9, 9)] = field("Camera matrix, row by row.", key="K")
    D: tuple[float, ...] = field("Coefficients of the lens.", key="D")


@result
class JudgedStart:
    """One calibration of the system, from one initial guess."""

    name: Name = field("The system, and the noise of the guess.")
    verdict: Verdict = field("Pass; undecided; or fail.")


@result(kw_only=True)
class BundledSystem:
    """Calibrated system in a bundle; its files are in the folder of its name."""

    name: Name = field("The system.")
    verdict: Verdict = field("The worst of its starts.")
    reasons: tuple[str, ...] = field("Why the verdict is not pass.", default=())
    marks: tuple[str, ...] = field(
        "Why it would not be bundled unless asked for: it is red, undecided or not accepted.", default=()
    )
    starts: tuple[JudgedStart, ...] = field("Its calibrations from all initial guesses.")
    labels: Sha256 | None = field("SHA-256 of its labels.", default=None)
    inputs: Mapping[str, str] = field("Hashes of its other inputs, as in the baseline.", default_factory=dict)
    description: Sha256 | None = field("SHA-256 of the robot's description that was calibrated.", default=None)
    accepted_although: str | None = field("Reason for accepting it although it had failed.", default=None)
    transforms: tuple[BundledTransform, ...] = field("Its calibrated transforms.", default=())
    cameras: tuple[BundledCamera, ...] = field("Its cameras.", default=())


@result
class SystemLeftOut:
    """System that is not in the bundle."""

    name: Name = field("The system.")
    why: str = field("Why it is not in it.")


@result
class BundledFile:
    """File of a bundle."""

    path: Name = field("Its path in the bundle.")
    size: int = field("Its size, bytes.")
    sha256: Sha256 = field("Its SHA-256.")


@result(kw_only=True)
class Manifest:
    """Manifest of a bundle: calibrations for one robot, and where they come from."""

    bundle: Literal[1] = field("Version of this format.")
    name: Name = field("The robot.")
    version: Version = field("Its version: one to four numbers; a later bundle has a larger one.")
    made: int = field("Time of the commit, or SOURCE_DATE_EPOCH; seconds since 1970, UTC.")
    serial: str | None = field("Serial number of the robot.", default=None)
    engine: Name = field("Version of Calibration CI that calibrated.")
    commit: str | None = field("The commit that was tested.", default=None)
    uncommitted: bool = field(
        "Whether files differed from that commit, or the accepted calibrations were in none.", default=False
    )
    configuration: Sha256 = field("SHA-256 of calibration.yml.")
    although: str | None = field("Why it was bundled although systems are marked.", default=None)
    systems: tuple[BundledSystem, ...] = field("The systems.")
    left_out: tuple[SystemLeftOut, ...] = field("Systems of calibration.yml that are not in it.", default=())
    files: tuple[BundledFile, ...] = field("All files but this one.")

    @property
    def marks(self) -> tuple[str, ...]:
        """Why systems would not be bundled unless asked for."""
        return tuple(f"{system.name}: {mark}" for system in self.systems for mark in system.marks)

    @property
    def file_name(self) -> str:
        """Name of the bundle's file."""
        return f"{self.name}{BUNDLE_ENDING}"

    @property
    def text(self) -> str:
        """The content of its file."""
        return text_of(self)


def parse_manifest(content: bytes, where: str) -> Manifest:
    """Parse a manifest.

    Raises:
        InputError: it is not valid; the message begins with ``where``.
    """
    try:
        document = parse_json(content)
    except (ValueError, RecursionError) as error:
        raise InputError(f"{where}: this is not a manifest: {error}") from None
    return read(Manifest, document, where)
