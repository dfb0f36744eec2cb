"""A parsed Rigelfile of any version: its jobs and the order in which they run."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from calibration.addons.rigel.fields import Notes, Substitution, bounded, list_at, mapping_at, shown, text_at
from calibration.base import InputError, read_yaml, shorten

_REQUESTS_KEY = "createSimulationJobRequests"
_KNOWN_KEYS = ("vars", "application", "applications", "jobs", "sequences", "providers")


@dataclass(frozen=True)
class RigelJob:
    """A use of a plugin."""

    name: str
    plugin: str
    """Dotted path of the plugin's class."""
    fields: Mapping[str, Any]
    where: str
    """Position in the file: ``jobs.build.with``."""

    @property
    def kind(self) -> str:
        """Name of the plugin's class, without its package: ``ComposePlugin``."""
        return self.plugin.rpartition(".")[2]


@dataclass(frozen=True)
class RigelStage:
    """Jobs that run in sequence, and the matrix over which they are repeated."""

    jobs: tuple[RigelJob, ...]
    matrix: Mapping[str, Any]
    where: str


@dataclass(frozen=True)
class Rigelfile:
    """Content of a Rigelfile, with its variables resolved."""

    path: Path
    distro: str | None
    folder: str
    """Folder of the sources, relative to the file."""
    jobs: tuple[RigelJob, ...]
    """Unique jobs; a stage that overrides fields of a job adds a job."""
    stages: tuple[RigelStage, ...]
    providers: Mapping[str, RigelJob]
    notes: Notes = field(default_factory=Notes)
    secrets: Mapping[str, str] = field(default_factory=dict, repr=False)
    """Secrets that must not be copied, and the variables that replace them."""


def read_rigelfile(path: Path) -> Rigelfile:
    """Read a Rigelfile without executing anything or reading environment variables.

    Raises:
        InputError: the file is missing, is not YAML or not a Rigelfile, is too large or too deep, or has a value
            of the wrong type; names file and key.
    """
    document = read_yaml(path, "a Rigelfile")
    with naming(path):
        return _read_document(path, bounded(document, str(path)))


@contextmanager
def naming(path: Path) -> Iterator[None]:
    """Prefix the message of an error with the file, unless it names it already."""
    try:
        yield
    except InputError as error:
        raise InputError(f"{path}: {str(error).removeprefix(f'{path}: ')}") from None


def _read_document(path: Path, document: object) -> Rigelfile:
    if not isinstance(document, dict) or not document:
        raise InputError(f"{path}: a Rigelfile was expected: a mapping with the keys application and jobs")
    if is_simulation(document):
        return _read_simulations(path, document)
    if not any(key in document for key in ("application", "applications", "jobs", "packages")):
        raise InputError(f"{path}: found {shorten(', '.join(document))}, the keys application and jobs were expected")
    return _Reader(path, document).rigelfile()


def is_simulation(document: Mapping[str, Any]) -> bool:
    """Return whether this is a RoboMaker request: ``CreateSimulationJob``, or ``StartSimulationJobBatch``."""
    return any(key in document for key in (_REQUESTS_KEY, "robotApplications", "simulationApplications"))


def _read_simulations(path: Path, document: dict[str, Any]) -> Rigelfile:
    """Convert simulation jobs in the form of Boto3 and the AWS CLI to jobs of the plugin."""
    notes = Notes()
    substitution = Substitution({}, notes)
    if document.pop("clientRequestToken", None):
        notes.lost("clientRequestToken", "a run has a name instead: --run-name")
    requests = [
        mapping_at(each, f"{_REQUESTS_KEY}.{i}") for i, each in enumerate(list_at(document.get(_REQUESTS_KEY), ""))
    ]
    tags = mapping_at(document.get("tags"), "tags")
    common = {key: value for key, value in document.items() if key not in (_REQUESTS_KEY, "tags")}
    if _REQUESTS_KEY in document and requests:  # settings of the batch are assigned to the first job
        requests[0] = {**common, **requests[0]}
        requests = [{**each, "tags": {**tags, **mapping_at(each.get("tags"), "tags")}} for each in requests]
    else:
        requests = [document]
    several = len(requests) > 1
    jobs = []
    for number, request in enumerate(requests):
        where = f"{_REQUESTS_KEY}.{number}" if _REQUESTS_KEY in document else ""
        name = f"simulation-{number + 1}" if several else "simulation"
        jobs.append(RigelJob(name, "RoboMakerPlugin", substitution.resolved(request, where), where))
    return Rigelfile(path, None, ".", tuple(jobs), (), {}, notes, substitution.secrets)


class _Reader:
    def __init__(self, path: Path, document: dict[str, Any]) -> None:
        self._path, self._document, self._notes = path, document, Notes()
        self._substitution = Substitution(self._read_variables(), self._notes)
        self._jobs: list[RigelJob] = []

    def rigelfile(self) -> Rigelfile:
        for key in self._document:
            if key not in _KNOWN_KEYS:
                self._notes.lost(key, self._why_lost(key))
        application = self._read_application()
        where = "jobs"
        declared = application.pop("jobs", None) if "jobs" not in self._document else self._document["jobs"]
        self._jobs = [self._read_job(n, job, "jobs", "plugin") for n, job in mapping_at(declared, where).items()]
        stages = self._without_unused(self._read_sequences())
        folder = self._resolved_text(application.pop("dir", "."), "application.dir")
        distro = application.pop("distro", None)
        self._report_unknown_keys((), application, "application")
        providers = mapping_at(self._document.get("providers"), "providers")
        return Rigelfile(
            path=self._path,
            distro=None if distro is None else self._resolved_text(distro, "application.distro"),
            folder=folder,
            jobs=tuple(self._jobs),
            stages=tuple(stages),
            providers={name: self._read_job(name, entry, "providers", "provider") for name, entry in providers.items()},
            notes=self._notes,
            secrets=self._substitution.secrets,
        )

    def _why_lost(self, key: str) -> str:
        if key in ("packages", "deploy", "simulate"):
            return "of Rigel 0.2, which has neither jobs nor sequences: write it as jobs of 0.3 first, or by hand here"
        return "Rigel has no such key"

    def _read_variables(self) -> dict[str, Any]:
        variables = mapping_at(self._document.get("vars"), "vars")
        # {type, with} declares an instance of a class of Rigel; its content is in `with`
        return {n: v["with"] if isinstance(v, dict) and set(v) == {"type", "with"} else v for n, v in variables.items()}

    def _read_application(self) -> dict[str, Any]:
        """Return the application; the first of several, because calibration.yml has one image."""
        if "application" in self._document or "applications" not in self._document:
            return dict(mapping_at(self._document.get("application"), "application"))
        several = mapping_at(self._document["applications"], "applications")
        for name in list(several)[1:]:
            self._notes.lost(f"applications.{name}", "there is one image: put this application into a file of its own")
        first = next(iter(several), None)
        return {} if first is None else dict(mapping_at(several[first], f"applications.{first}"))

    def _report_unknown_keys(self, known: tuple[str, ...], fields: Mapping[str, Any], where: str) -> None:
        for key in [key for key in fields if key not in known]:
            self._notes.lost(f"{where}.{key}", "Rigel has no such key")

    def _resolved_text(self, value: object, where: str) -> str:
        return text_at(self._substitution.resolved(value, where), where)

    def _read_job(self, name: str, entry: object, section: str, key: str) -> RigelJob:
        where = f"{section}.{name}"
        fields = mapping_at(entry, where)
        self._report_unknown_keys((key, "with"), fields, where)
        plugin = self._resolved_text(fields.get(key), f"{where}.{key}")
        inner = self._substitution.resolved(mapping_at(fields.get("with"), f"{where}.with"), f"{where}.with")
        return RigelJob(name, plugin, inner, f"{where}.with")

    def _read_sequences(self) -> list[RigelStage]:
        stages: list[RigelStage] = []
        for name, entry in mapping_at(self._document.get("sequences"), "sequences").items():
            where = f"sequences.{name}"
            if isinstance(entry, list):  # in the older form the sequence is a list of jobs
                stages.append(RigelStage(self._jobs_of_stage(entry, where), {}, where))
                continue
            sequence = mapping_at(entry, where)
            if "matrix" in sequence:
                self._notes.lost(f"{where}.matrix", "Rigel takes it and does not use it: write it in the stage")
            self._report_unknown_keys(("stages", "description", "matrix"), sequence, where)
            for number, stage in enumerate(list_at(sequence.get("stages"), f"{where}.stages")):
                place = f"{where}.stages.{number}"
                if isinstance(stage, str):
                    stages.append(RigelStage(self._jobs_of_stage([stage], place), {}, place))
                else:
                    stages += self._read_stage(mapping_at(stage, place), place, {})
        return stages

    def _read_stage(self, stage: dict[str, Any], where: str, matrix: Mapping[str, Any]) -> list[RigelStage]:
        self._report_unknown_keys(("jobs", "dependencies", "parallel", "matrix", "description"), stage, where)
        own = self._substitution.resolved(mapping_at(stage.get("matrix"), f"{where}.matrix"), f"{where}.matrix")
        matrix = {**matrix, **own}
        dependencies = list_at(stage.get("dependencies"), f"{where}.dependencies")
        jobs = list_at(stage.get("jobs"), f"{where}.jobs")
        found = (
            [RigelStage(self._jobs_of_stage([*dependencies, *jobs], where), matrix, where)]
            if dependencies or jobs
            else []
        )
        for number, inner in enumerate(list_at(stage.get("parallel"), f"{where}.parallel")):
            place = f"{where}.parallel.{number}"
            found += self._read_stage(mapping_at(inner, place), place, matrix)
        return found

    def _jobs_of_stage(self, entries: list[Any], where: str) -> tuple[RigelJob, ...]:
        """Return the jobs that a stage names; overridden fields make a new job."""
        jobs = []
        for entry in entries:
            override: dict[str, Any] = {}
            name = entry
            if isinstance(entry, dict):
                name = entry.get("name")
                place = f"{where}.{name}.with"
                override = self._substitution.resolved(mapping_at(entry.get("with"), place), place)
            job = next((job for job in self._jobs if job.name == name), None)
            if job is None:
                self._notes.lost(where, f"there is no job {shown(name)}")
                continue
            jobs.append(self._override_job(job, override) if override else job)
        return tuple(jobs)

    def _without_unused(self, stages: list[RigelStage]) -> list[RigelStage]:
        """Remove jobs that no stage uses unmodified; the first modified one takes over the name."""
        used = {job.name for stage in stages for job in stage.jobs}
        renamed = {}
        for job in [job for job in self._jobs if job.name not in used]:
            first = next((other for other in self._jobs if other.where == job.where and other.name in used), None)
            if first is not None:
                self._jobs.remove(job)
                renamed[first.name] = replace(first, name=job.name)
        self._jobs = [renamed.get(job.name, job) for job in self._jobs]
        return [replace(stage, jobs=tuple(renamed.get(job.name, job) for job in stage.jobs)) for stage in stages]

    def _override_job(self, job: RigelJob, override: Mapping[str, Any]) -> RigelJob:
        fields = {**job.fields, **override}
        names = {other.name for other in self._jobs}
        number = 2
        while f"{job.name}-{number}" in names:
            number += 1
        other = RigelJob(f"{job.name}-{number}", job.plugin, fields, job.where)
        same = next((j for j in self._jobs if j.where == job.where and j.fields == fields), None)
        if same is None:
            self._jobs.append(other)
        return same or other
