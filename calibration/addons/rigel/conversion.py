"""Conversion of a Rigelfile to the content of ``calibration.yml``."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from calibration.addons.rigel.batch_section import merged
from calibration.addons.rigel.containers import Surroundings
from calibration.addons.rigel.document import Rigelfile, RigelJob, RigelStage, naming
from calibration.addons.rigel.fields import text_at
from calibration.addons.rigel.image import BUILD_PLUGIN, DOCKERFILE_PLUGIN, image_section
from calibration.addons.rigel.notes import Notes
from calibration.addons.rigel.robomaker import ROBOMAKER_PLUGIN, robomaker_job
from calibration.addons.rigel.substitution import plain
from calibration.addons.rigel.systems import (
    ConvertedEntry,
    collection_of,
    is_compose,
    is_introspection,
    judged_by,
    named_system,
    system_of,
)
from calibration.base.errors import InputError
from calibration.base.tables.numbers import parse_number
from calibration.base.text import shorten

MAX_NOISE = 1000.0


def placeholder(name: str) -> str | None:
    """Return our placeholder for a matrix name: ``trans_noise`` gives ``translation_noise``; None if unknown."""
    lower = name.lower()
    for part, ours in (("trans", "translation_noise"), ("rot", "rotation_noise"), ("seed", "seed")):
        if part in lower:
            return ours
    return None


def noise_section(stages: Sequence[RigelStage], notes: Notes) -> tuple[dict[str, list[float]], list[str]]:
    """Return the section ``noise``, and its source.

    All systems share one noise: if stages differ, the union of their values is used.
    """
    found: dict[str, dict[str, dict[float, None]]] = {}
    for stage in stages:
        own = _of_stage(stage.matrix, f"{stage.where}.matrix", notes)
        if own:
            found[stage.where] = own
    together: dict[str, dict[float, None]] = {}
    for own in found.values():
        for key, values in own.items():
            together.setdefault(key, {}).update(values)
    different = [where for where, own in found.items() if any(own.get(key, {}) != together[key] for key in together)]
    if different:
        notes.changed(f"{different[0]}.matrix", "there is one noise for all systems: the values of all stages together")
    return {
        key: [int(v) if v.is_integer() else v for v in values] for key, values in sorted(together.items(), reverse=True)
    }, list(found)


def _of_stage(matrix: Mapping[str, Any], where: str, notes: Notes) -> dict[str, dict[float, None]]:
    own: dict[str, dict[float, None]] = {}
    for name, values in matrix.items():
        ours = placeholder(name)
        key = {"translation_noise": "translation", "rotation_noise": "rotation"}.get(ours or "")
        if key is None:
            notes.lost(
                f"{where}.{name}", "a matrix is of translation and rotation noise here (and of seeds: noise.seeds)"
            )
            continue
        for value in values if isinstance(values, list) else [values]:
            number = None if isinstance(value, bool) else parse_number(str(value).strip())
            if number is None or not 0 <= number <= MAX_NOISE:
                notes.lost(f"{where}.{name}", f"{shorten(str(value))!r} is no noise (a number from 0 to {MAX_NOISE:g})")
            else:
                own.setdefault(key, {})[number] = None
    return own


_ADVICE_OF_PLUGIN = {
    "TestPlugin": "requirements on ROS messages are not checked here: write a table, and judge it by rules",
    "WorldForgePlugin": "worlds come from a scenario set here: calibration schema scenario-set",
    "UnitTestPlugin": "unit tests are a job of the workflow",
}


@dataclass
class Conversion:
    """Sections of ``calibration.yml`` with the source of each; empty ones are omitted."""

    notes: Notes
    secrets: Mapping[str, str] = field(default_factory=dict, repr=False)
    """Secrets that must not be written, and the variables that replace them."""
    image: dict[str, Any] = field(default_factory=dict)
    image_origin: str = ""
    noise: dict[str, list[float]] = field(default_factory=dict)
    noise_origin: str = ""
    systems: list[ConvertedEntry] = field(default_factory=list)
    simulations: list[ConvertedEntry] = field(default_factory=list)
    batch: dict[str, Any] = field(default_factory=dict)
    """AWS region of the simulations."""
    batch_origin: str = ""

    @property
    def is_empty(self) -> bool:
        """Whether nothing could be converted."""
        return not (self.image or self.noise or self.systems or self.simulations)


def convert(rigelfile: Rigelfile) -> Conversion:
    """Convert a Rigelfile; everything that cannot be converted is in the notes.

    Raises:
        InputError: a value has the wrong type; names file and key.
    """
    with naming(rigelfile.path):
        return _convert_rigelfile(rigelfile)


def _convert_rigelfile(rigelfile: Rigelfile) -> Conversion:
    notes = rigelfile.notes
    conversion = Conversion(notes, rigelfile.secrets)
    conversion.image, origins = image_section(rigelfile)
    conversion.image_origin = _list_names("job", origins)
    conversion.noise, places = noise_section(rigelfile.stages, notes)
    conversion.noise_origin = f"the matrix of {', '.join(places)}"
    around = Surroundings(notes, conversion.image.get("name"), _placeholders_of_data(rigelfile))
    judges = judged_by(rigelfile)
    for job in rigelfile.jobs:
        _add_job(conversion, job, judges.get(job.name, []), rigelfile, around)
    _refuse_repeated(conversion.systems)
    _refuse_repeated(conversion.simulations)
    if conversion.systems and not conversion.image:
        for system in conversion.systems:
            if "image" not in system.entry["software"]:
                notes.to_do(system.origin, "no image is named, and none is built: write software.image")
    return conversion


def _add_job(
    conversion: Conversion, job: RigelJob, judges: list[RigelJob], rigelfile: Rigelfile, around: Surroundings
) -> None:
    """Add a job to the section for its plugin."""
    if job.kind in (DOCKERFILE_PLUGIN, BUILD_PLUGIN) or is_introspection(job):
        return
    if job.kind == ROBOMAKER_PLUGIN:
        simulated = robomaker_job(job, around, _region_of_provider(rigelfile))
        if simulated is not None:
            conversion.simulations.append(ConvertedEntry(named_system(job.name), simulated.entry, f"job {job.name}"))
            notes, section = conversion.notes, simulated.section
            conversion.batch = merged(conversion.batch, section, job.where or job.name, notes)
            conversion.batch_origin = conversion.batch_origin or f"job {job.name}"
    elif is_compose(job):
        system = system_of(job, judges, rigelfile.distro, around, str(rigelfile.path))
        collection = None if system else collection_of(job, rigelfile.distro, around)
        if system is not None:
            conversion.systems.append(system)
        elif collection is not None:
            conversion.simulations.append(collection)
        else:
            why = "its containers bring out neither a table nor a dataset, so nothing would be judged"
            conversion.notes.lost(job.where, why)
    else:
        why = _ADVICE_OF_PLUGIN.get(job.kind, f"there is nothing like {job.plugin} here")
        conversion.notes.lost(job.where.removesuffix(".with"), why)


def _region_of_provider(rigelfile: Rigelfile) -> str:
    """Return the AWS region of the provider; empty without one."""
    given = [p.fields["region_name"] for p in rigelfile.providers.values() if p.fields.get("region_name")]
    return plain(text_at(given[0], "providers"), rigelfile.notes, "providers") if given else ""


def _placeholders_of_data(rigelfile: Rigelfile) -> dict[str, str]:
    """Return our names of the data of all matrices."""
    names = {name for stage in rigelfile.stages for name in stage.matrix}
    return {name: ours for name in names if (ours := placeholder(name)) is not None}


def _refuse_repeated(entries: list[ConvertedEntry]) -> None:
    names = [entry.name for entry in entries]
    for name in names:
        if names.count(name) > 1:
            raise InputError(f"jobs: two are called {name!r} once only letters, digits and _ . - are kept: rename one")


def _list_names(what: str, names: list[str]) -> str:
    return f"{what}{'s' if len(names) > 1 else ''} {' and '.join(names)}" if names else ""
