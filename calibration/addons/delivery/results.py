"""Section ``delivery`` of calibration.yml; results of ``bundle``, of the stage deliver and of ``verify``."""

from pathlib import Path
from typing import Annotated

from calibration.addons.delivery.manifest import SystemLeftOut, Version
from calibration.base import count_of
from calibration.base.records import UNIQUE, field, length, matching, record, result
from calibration.ci.report.report import StageResult

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


@result(kw_only=True)
class BundleResults:
    """Results of bundle."""

    name: str = field("The robot.")
    version: str = field("Version of the bundle.")
    file: str = field("The bundle, relative to the output folder.")
    digest: str = field("Its digest, sha256:...")
    attestation: str | None = field("Its signed statement, relative to the output folder; null without a key.")
    predicate: str = field("Its test results, relative to the output folder, for actions/attest or cosign.")
    systems: tuple[str, ...] = field("The systems in it.")
    left_out: tuple[SystemLeftOut, ...] = field("The systems that are not in it, with why.", default=())
    marks: tuple[str, ...] = field("Why systems in it are marked: red, undecided or not accepted.", default=())
    uncommitted: bool = field("Whether files differed from the commit.", default=False)

    @property
    def warnings(self) -> tuple[str, ...]:
        """What speaks against it, one line each."""
        return (
            *(f"{mark}: bundled and marked, verify refuses it" for mark in self.marks),
            *(f"{each.name}: left out: {each.why}" for each in self.left_out),
            *(["files differ from the commit that was tested: commit them, and run again"] if self.uncommitted else []),
            *(["it is not signed: there is no key"] if self.attestation is None else []),
        )

    @property
    def sentence(self) -> str:
        """Return the result in a few words."""
        signed = "signed" if self.attestation else "not signed"
        marked = ", marked" if self.marks else ""
        return f"{count_of(len(self.systems), 'system')} bundled as {self.name} {self.version}, {signed}{marked}"


@result(kw_only=True)
class Delivered(StageResult):
    """Bundle for the robot."""

    heading = "Bundle"

    bundle: BundleResults | None = field("The bundle; null if no system has passed and is accepted.", default=None)
    why_not: str | None = field("Why there is none.", default=None)

    @property
    def sentence(self) -> str:
        """Return the result in a few words, for the line of the verdict."""
        return self.bundle.sentence if self.bundle else "no bundle"

    def line(self, output: Path) -> str:
        """Return the path of the bundle and what speaks against it, for the report."""
        if self.bundle is None:
            return f"No bundle: {self.why_not}"
        return "; ".join([f"Bundle: {output / self.bundle.file}, {self.bundle.digest}", *self.bundle.warnings])


@result(kw_only=True)
class DifferenceInUse:
    """Difference of what is in use from what was verified."""

    place: str = field("File, bag or topic in which it was found.")
    of: str = field("The frame, or the camera.")
    text: str = field("What was found, and what was expected.")
    mm: float | None = field("Distance of the translations.", unit="mm", default=None)
    deg: float | None = field("Difference of the rotations.", unit="degrees", default=None)

    def __str__(self) -> str:
        return f"{self.place}: {self.of}: {self.text}"


@result(kw_only=True)
class VerifyResults:
    """Results of verify."""

    bundle: str = field("What was verified: a path, or a name in a registry.")
    digest: str | None = field("Digest of the bundle, sha256:...; null if it could not be read.", default=None)
    name: str | None = field("The robot, as the bundle says.", default=None)
    version: str | None = field("Version of the bundle.", default=None)
    commit: str | None = field("The commit that was tested.", default=None)
    age_days: float | None = field("Time since it was made.", unit="days", default=None)
    signed_by: str | None = field("Id of the key that signed it; null where that was not checked.", default=None)
    compared: int = field("Number of transforms and cameras that were compared with what is in use.", default=0)
    differences: tuple[DifferenceInUse, ...] = field("Differences of what is in use.", default=())
    warnings: tuple[str, ...] = field("What was not checked, and what the bundle says of itself.", default=())
