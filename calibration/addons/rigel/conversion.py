"""``import-rigelfile``: convert a Rigelfile to ``calibration.yml``, with comments that name the source of each part."""

import os
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import click
import yaml

from calibration.addons.rigel.batch_section import merged
from calibration.addons.rigel.containers import Surroundings
from calibration.addons.rigel.document import Rigelfile, RigelJob, RigelStage, naming, read_rigelfile
from calibration.addons.rigel.fields import Fields, NoteKind, Notes, list_at, plain, text_at
from calibration.addons.rigel.image import BUILD_PLUGIN, DOCKERFILE_PLUGIN, image_section
from calibration.addons.rigel.robomaker import ROBOMAKER_PLUGIN, robomaker_job
from calibration.addons.rigel.systems import (
    ConvertedEntry,
    collection_of,
    is_compose,
    is_introspection,
    judged_by,
    named_system,
    system_of,
)
from calibration.base import ExitCode, InputError, count_of, one_line, parse_number, shorten, write_atomically
from calibration.ci.execution.backends import SECTIONS
from calibration.ci.workflow import Annotation, Level, Runner, annotate, stop_commands
from calibration.commands.parameters import boolean_option, path

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
    requirements: dict[str, Any] = field(default_factory=dict)
    """Requirements over messages."""
    requirements_origin: str = ""

    @property
    def is_empty(self) -> bool:
        """Whether nothing could be converted."""
        return not (self.image or self.noise or self.systems or self.simulations or self.requirements)


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
    conversion.requirements, origins = requirements_section(rigelfile.jobs, notes)
    conversion.requirements_origin = _list_names("job", origins)
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
    if job.kind in (DOCKERFILE_PLUGIN, BUILD_PLUGIN) or is_introspection(job) or is_test_of_messages(job):
        return
    if job.kind == ROBOMAKER_PLUGIN:
        simulated = robomaker_job(job, around, _region_of_provider(rigelfile))
        if simulated is not None:
            entry, section = simulated
            conversion.simulations.append(ConvertedEntry(named_system(job.name), entry, f"job {job.name}"))
            conversion.batch = merged(conversion.batch, section, job.where or job.name, conversion.notes)
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


COMMENT_WIDTH = 110
"""Line width of comments."""
MIN_SECRET_LENGTH = 6
"""Minimum length of a secret in characters; a shorter one may be a word of any text."""
MAX_LIST_LENGTH = 90
"""Maximum length of a list on one line, in characters."""
_HEADING_OF_KIND = {
    NoteKind.TO_DO: "To do:",
    NoteKind.CHANGED: "What works otherwise here:",
    NoteKind.LOST: "What was not carried over:",
}


class _Dumper(yaml.SafeDumper):
    """YAML dumper with block style for multi-line texts and without aliases."""

    def ignore_aliases(self, data: object) -> bool:
        return True

    def increase_indent(self, flow: bool = False, indentless: bool = False) -> None:
        super().increase_indent(flow, indentless=False)


def _represent_text(dumper: yaml.SafeDumper, text: str) -> yaml.ScalarNode:
    # A block style text cannot contain trailing blanks or non-printable characters.
    block = "\n" in text and not any(line != line.rstrip() for line in text.split("\n")) and text.strip("\n") == text
    printable = text.replace("\n", "").isprintable()
    style = ("|" if block else None) if printable else '"'
    return dumper.represent_scalar("tag:yaml.org,2002:str", text, style=style)


def _represent_list(dumper: yaml.SafeDumper, items: list[Any]) -> yaml.SequenceNode:
    node = dumper.represent_sequence("tag:yaml.org,2002:seq", items)
    if sum(len(str(item)) + 2 for item in items) > MAX_LIST_LENGTH:
        node.flow_style = False
    return node


_Dumper.add_representer(str, _represent_text)
_Dumper.add_representer(list, _represent_list)


def written(conversion: Conversion, source: str) -> str:
    """Return the text of ``calibration.yml``; ``source`` is the name of the converted file."""
    parts = [
        _comment_text(f"Made from {source} by `calibration import-rigelfile`; from now on it is yours to edit."),
        _notes_text(conversion, NoteKind.TO_DO),
        _section_text("image", conversion.image, f"the {conversion.image_origin}"),
        _section_text("noise", conversion.noise, f"{conversion.noise_origin}; m and rad"),
        _entries_text("systems", conversion.systems),
        _entries_text("simulation", conversion.simulations),
        _section_text("aws-batch", conversion.batch, f"the {conversion.batch_origin}", flow=False),
        _section_text("requirements", conversion.requirements, f"the {conversion.requirements_origin}", flow=False),
        _notes_text(conversion, NoteKind.CHANGED),
        _notes_text(conversion, NoteKind.LOST),
    ]
    return _without_secrets(conversion.secrets, "\n".join(part for part in parts if part))


def _without_secrets(secrets: Mapping[str, str], text: str) -> str:
    """Remove secrets from the text that also occur where no key marks them."""
    for secret in sorted(secrets, key=len, reverse=True):
        if len(secret) >= MIN_SECRET_LENGTH:
            text = text.replace(secret, f"${{{secrets[secret]}}}")
    return text


def _section_text(name: str, content: Mapping[str, Any], origin: str, flow: bool | None = None) -> str:
    return _comment_text(f"from {origin}") + _dump_yaml({name: content}, flow) if content else ""


def _entries_text(name: str, entries: list[ConvertedEntry]) -> str:
    if not entries:
        return ""
    blocks = [
        textwrap.indent(_comment_text(f"from the {entry.origin}") + _dump_yaml({entry.name: entry.entry}), "  ")
        for entry in entries
    ]
    return f"{name}:\n" + "\n".join(blocks)


def _notes_text(conversion: Conversion, kind: NoteKind) -> str:
    notes = [note for note in conversion.notes if note.kind is kind]
    return _comment_text("\n".join([_HEADING_OF_KIND[kind], *(f"- {note}" for note in notes)])) if notes else ""


def _comment_text(text: str) -> str:
    lines: list[str] = []
    for line in text.split("\n"):
        lines += textwrap.wrap(one_line(line), COMMENT_WIDTH, subsequent_indent="  ", break_on_hyphens=False)
    return "".join(f"# {line}\n" for line in lines)


def _dump_yaml(document: dict[str, Any], flow: bool | None = None) -> str:
    return yaml.dump(
        document, Dumper=_Dumper, sort_keys=False, allow_unicode=True, width=2**20, default_flow_style=flow
    )


TEST_PLUGIN = "TestPlugin"
SECTION = "requirements"
NO_BAG = "TODO.bag"
"""Placeholder for the bag."""


def requirements_section(jobs: Sequence[RigelJob], notes: Notes) -> tuple[dict[str, Any], list[str]]:
    """Return the section, and the names of the jobs that it is made of; empty without any.

    Raises:
        InputError: a field has the wrong type.
    """
    properties: dict[str, None] = {}
    origins = []
    for job in jobs:
        found = _properties_of_job(job, notes)
        if found and SECTION not in SECTIONS:
            notes.lost(job.where.removesuffix(".with"), "requirements on ROS messages are not checked here")
        elif found:
            properties |= dict.fromkeys(found)
            origins.append(job.name)
    if not properties:
        return {}, []
    notes.to_do(f"{SECTION}.bag", "name the bag with the robot's messages: a file of ROS 1, or a folder of ROS 2")
    return {"bag": NO_BAG, "hpl": list(properties)}, origins


def is_test_of_messages(job: RigelJob) -> bool:
    """Return whether a job judges messages, and runs no containers, as it does in older Rigelfiles."""
    return job.kind == TEST_PLUGIN and "components" not in job.fields


def _properties_of_job(job: RigelJob, notes: Notes) -> list[str]:
    if is_test_of_messages(job):
        fields = Fields(job.fields, job.where, notes)
        found = fields.plains("requirements")
        _note_differences(fields, notes)
        if not found:
            notes.lost(job.where.removesuffix(".with"), "it has no requirements")
    else:
        where = f"{job.where}.components"
        components = list_at(job.fields.get("components"), where)
        judged = [each["introspection"] for each in components if isinstance(each, dict) and "introspection" in each]
        found = [
            text
            for each in judged
            if isinstance(each, dict)
            for text in Fields(each, f"{where}.introspection", notes).plains("requirements")
        ]
    return [" ".join(text.split()) for text in found]


def _note_differences(fields: Fields, notes: Notes) -> None:
    for key in ("hostname", "port"):
        if fields.take(key) is not None:
            notes.lost(fields.at(key), "nothing is connected to: a bag is judged")
    if fields.take("timeout") is not None:
        notes.changed(fields.at("timeout"), "a bag is judged to its end: record for so long")
    if fields.take("ignore"):
        notes.lost(fields.at("ignore"), "every message of a bag counts: begin to record later")
    notes.changed(fields.where, "a requirement that is not met makes the verdict fail, where Rigel only prints it")
    fields.rest()


@click.command("import-rigelfile")
@click.option(
    "--file", type=path, default="Rigelfile", show_default=True, help="Rigelfile to read, or RoboMaker's request."
)
@click.option("--output", type=path, default="calibration.yml", show_default=True, help="File to write.")
@boolean_option("--overwrite", help="Replace an existing output file.")
def command(file: Path, output: Path, overwrite: bool) -> ExitCode:
    """Write a calibration.yml from a Rigelfile, and list what could not be converted.

    A request of RoboMaker's CreateSimulationJob or StartSimulationJobBatch, as JSON or YAML, is converted too.
    Nothing in the file is executed. Secrets are replaced by variables.
    """
    runner = Runner.from_environment(os.environ)
    if output.exists() and (not overwrite or output.samefile(file)):
        hint = "name another file" if overwrite else "name another file, or add --overwrite"
        raise InputError(f"{output}: there is such a file already: {hint}")
    conversion = convert(read_rigelfile(file))
    if output.absolute().parent.resolve() != file.absolute().parent.resolve():
        conversion.notes.to_do("paths", f"they are relative to calibration.yml here: move it beside {file.name}")
    if conversion.is_empty:
        reasons = "; ".join(map(str, conversion.notes)) or "it has no jobs"
        raise InputError(f"{file}: nothing in it can be converted to calibration.yml: {reasons}")
    write_atomically(output, written(conversion, file.name))
    levels = {NoteKind.LOST: Level.WARNING, NoteKind.TO_DO: Level.WARNING, NoteKind.CHANGED: Level.NOTICE}
    annotate(runner, [Annotation(f"{n.kind}: {n}", levels[n.kind], file=file) for n in conversion.notes])
    count = {kind: sum(note.kind is kind for note in conversion.notes) for kind in NoteKind}
    with stop_commands(runner):
        runner.log(
            f"{one_line(str(output))}: {count_of(len(conversion.systems), 'system')}, "
            f"{count_of(len(conversion.simulations), 'simulation')}, {'an' if conversion.image else 'no'} image; "
            f"{count[NoteKind.TO_DO]} to do, "
            f"{count[NoteKind.CHANGED]} work otherwise here, {count[NoteKind.LOST]} not carried over"
        )
        complaint = _complaint_of_reader(output)
        if complaint:
            runner.log(one_line(f"before `calibration run --config {output}`: {complaint}"))
    return ExitCode.PASS


def _complaint_of_reader(output: Path) -> str:
    """Return the error of our own reader for the new file; empty if there is none."""
    try:
        from calibration.pipeline.configuration import read_configuration  # needs the extra calibrate

        read_configuration(output)
    except ModuleNotFoundError:  # installed without the engine
        return ""
    except InputError as error:
        return str(error)
    return ""
