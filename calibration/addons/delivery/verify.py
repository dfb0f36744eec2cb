"""``verify``: check on the robot that a bundle is authentic, its own, and what is in use. Needs no numpy."""

import hashlib
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any

import click

from calibration.addons.delivery.attestation import read_public_keys
from calibration.addons.delivery.checking import (
    SECONDS_OF_DAY,
    CheckedBundle,
    ComparedWithUse,
    Expectations,
    Tolerance,
    check_bundle,
    compare_with_use,
)
from calibration.addons.delivery.destinations import ATTESTATION_IN_FOLDER, FetchedBundle, fetch_bundle
from calibration.addons.delivery.in_use import MAX_FILE_BYTES, read_in_use
from calibration.addons.delivery.manifest import BundledSystem, Manifest, RefusedBundleError, Version, version_order
from calibration.addons.delivery.results import VerifyResults
from calibration.base import ExitCode, InputError, did_you_mean, one_line, read_bytes, write_atomically
from calibration.base.records import Misfit, Place, between, field, read_as, record
from calibration.ci.execution.job import Seconds
from calibration.ci.report import FILES, Lines, Outcome, Report, Table, publish, remove_results, verdict_of
from calibration.ci.workflow import Runner
from calibration.commands.parameters import chosen, record_options

TITLE = "verify"
MAX_VERSION_BYTES = 100


@record(kw_only=True)
class VerifySettings:
    """Inputs of ``verify``."""

    key: tuple[Path, ...] = field(
        "Files with the trusted public keys, Ed25519 in PEM; one of them must have signed.", default=()
    )
    unsigned: bool = field("Check no signature: anyone may have made the bundle.", default=False)
    attestation: Path | None = field("File with its attestation (that beside the bundle).", default=None)
    offline: bool = field("Use no network: a name in a registry is an error.", default=False)
    serial: str | None = field("Serial number of this robot, which the bundle must have.", default=None)
    description: Path | None = field(
        "Description of this robot, with calibrated origins or without, whose hash the bundle must have.", default=None
    )
    max_age: Seconds | None = field("Largest time since it was made: 30d, 12h.", default=None)
    at_least: Version | None = field("Smallest version that is accepted: 1.4.2.", default=None)
    remember: Path | None = field(
        "File with the largest version that was ever accepted here: an older one is refused, a later one written.",
        default=None,
    )
    marked: bool = field("Accept a bundle that is marked: red, undecided or not accepted.", default=False)
    systems: tuple[str, ...] = field("Only these systems are compared with what is in use (all).", default=())
    in_use: tuple[str, ...] = field(
        "What is in use: URDF, launch files, YAML of Autoware, camera_info or messages, bags; CAMERA=FILE for its own.",
        default=(),
    )
    tolerance_mm: Annotated[float, between(0, 1000)] = field(
        "Largest difference of a translation that is in use, mm (0.0001).", default=1e-4
    )
    tolerance_deg: Annotated[float, between(0, 1000)] = field(
        "Largest difference of a rotation that is in use, degrees (0.00001).", default=1e-5
    )
    unpack: Path | None = field("Folder to write the files to if the bundle is accepted; it must be new.", default=None)
    output: Path | None = field("Folder for results.json, junit.xml and summary.md.", default=None)

    def __post_init__(self) -> None:
        """Refuse keys beside ``unsigned``, and neither of them.

        Raises:
            Misfit: names the option.
        """
        if self.key and self.unsigned:
            raise Misfit("found --key too: with it the signature is checked", "unsigned")
        if not self.key and not self.unsigned:
            raise Misfit("expected --key, the public key that is trusted (or --unsigned)")


@click.command(TITLE)
@click.argument("bundle")
@record_options(VerifySettings)
def command(bundle: str, **options: Any) -> ExitCode:
    """Check BUNDLE: a file, an unpacked folder, or a name in a registry. Exit code 1 if it is refused.

    Checked are its digest and signature, its verdict, and as options ask for it its age, version and robot, and that
    what is in use on the robot is what was verified.
    """
    return verify(bundle, chosen(VerifySettings, options), Runner.from_environment())


def verify(bundle: str, settings: VerifySettings, runner: Runner) -> ExitCode:
    """Check a bundle, and report.

    Raises:
        InputError: the bundle cannot be read, or an input is wrong.
        InfrastructureError: a package is not installed, a registry does not answer, or a file cannot be written.
    """
    remove_results(settings.output, FILES)
    if settings.unpack is not None and settings.unpack.exists():
        raise InputError(f"{settings.unpack}: this exists already, expected a new folder to unpack to")
    expected = _expectations(settings)
    fetched: FetchedBundle | None = None
    try:
        fetched = fetch_bundle(bundle, settings.attestation, runner, offline=settings.offline)
        checked = check_bundle(fetched, expected)
    except RefusedBundleError as error:
        checked = CheckedBundle(digest="", reasons=(str(error),))
    compared = ComparedWithUse(0, (), ())
    if checked.manifest is not None:
        compared = _compare(checked.manifest, settings)
    report = _report(bundle, checked, compared, expected)
    if report.verdict == "pass" and fetched is not None and checked.manifest is not None:
        if settings.unpack is not None:
            _unpack(checked, fetched, settings.unpack)
        _remember(checked.manifest.version, settings.remember)
    return publish(report, runner, settings.output)


def _expectations(settings: VerifySettings) -> Expectations:
    description = None
    if settings.description is not None:
        content = read_bytes(settings.description, MAX_FILE_BYTES, "a robot description")
        description = hashlib.sha256(content).hexdigest()
    versions = [each for each in (settings.at_least, _remembered(settings.remember)) if each]
    return Expectations(
        keys=read_public_keys(settings.key),
        serial=settings.serial,
        description=description,
        max_age=settings.max_age,
        at_least=max(versions, key=version_order, default=None),
        marked=settings.marked,
        now=time.time,
    )


def _remembered(path: Path | None) -> str | None:
    if path is None or not path.exists():
        return None
    text = read_bytes(path, MAX_VERSION_BYTES, "a version").decode("utf-8", "replace").strip()
    return str(read_as(Version, text, Place(str(path))))


def _remember(version: str, path: Path | None) -> None:
    if path is not None:  # what is accepted is not older than what was
        write_atomically(path, f"{version}\n")


def _unpack(checked: CheckedBundle, fetched: FetchedBundle, folder: Path) -> None:
    files = {**checked.files, ATTESTATION_IN_FOLDER: fetched.attestation} if fetched.attestation else checked.files
    for name, content in files.items():
        write_atomically(folder / name, content)


def _compare(manifest: Manifest, settings: VerifySettings) -> ComparedWithUse:
    systems = _chosen_systems(manifest, settings.systems)
    if not settings.in_use:
        return ComparedWithUse(0, (), ("what is in use is not compared: give its files by --in-use",))
    sources = []
    for text in settings.in_use:
        camera, equals, path = text.partition("=")
        named = bool(equals) and not Path(text).exists()
        if named and not any(each.name == camera for system in systems for each in system.cameras):
            known = [each.name for system in systems for each in system.cameras]
            raise InputError(f"--in-use: there is no camera '{camera}'{did_you_mean(camera, known)}")
        sources.append(read_in_use(Path(path), camera) if named else read_in_use(Path(text)))
    return compare_with_use(systems, sources, Tolerance(settings.tolerance_mm, settings.tolerance_deg))


def _chosen_systems(manifest: Manifest, names: tuple[str, ...]) -> list[BundledSystem]:
    known = {system.name: system for system in manifest.systems}
    for name in names:
        if name not in known:
            raise InputError(f"--systems: the bundle has no '{name}'{did_you_mean(name, known)}")
    return [known[name] for name in names or known]


def _report(bundle: str, checked: CheckedBundle, compared: ComparedWithUse, expected: Expectations) -> Report:
    manifest = checked.manifest
    reasons = (*(f"{bundle}: {each}" for each in checked.reasons), *map(str, compared.differences))
    results = VerifyResults(
        bundle=bundle,
        digest=f"sha256:{checked.digest}" if checked.digest else None,
        name=manifest.name if manifest else None,
        version=manifest.version if manifest else None,
        commit=manifest.commit if manifest else None,
        age_days=round((expected.now() - manifest.made) / SECONDS_OF_DAY, 2) if manifest else None,
        signed_by=checked.signed_by,
        compared=compared.compared,
        differences=compared.differences,
        warnings=(*checked.warnings, *compared.warnings),
    )
    refused = f"{'refused' if reasons else 'accepted'}, {results.compared} transforms and cameras compared"
    return Report(
        title="Verification",
        verdict=verdict_of(not reasons),
        sentence=refused if manifest is None else f"{manifest.name} {manifest.version} {refused}",
        reasons=reasons,
        warnings=results.warnings,
        results=results,
        blocks=(Table(("bundle", ""), tuple(_rows(results))), Lines(results.warnings, title="To look at")),
        suites={TITLE: [Outcome(name=bundle, reasons=reasons)]},
        outputs={"digest": results.digest, "version": results.version},
    )


def _rows(results: VerifyResults) -> Iterator[tuple[str, str]]:
    age = None if results.age_days is None else f"{results.age_days} days"
    rows = {"digest": results.digest, "signed by": results.signed_by, "commit": results.commit, "age": age}
    yield from ((name, one_line(value)) for name, value in rows.items() if value is not None)
