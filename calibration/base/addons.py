"""Registry of add-ons: what the folders of ``calibration/addons`` bring to the other floors.

An add-on is found by its folder: its ``__init__`` declares ``ADDON``, an `Addon`. The rest of the package asks this
registry and never imports an add-on by name, so that a folder can be deleted with all that it brings. Code is named
as ``module:attribute``, and imported when it is used.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cache
from importlib import import_module
from importlib.util import find_spec
from pkgutil import iter_modules
from typing import Any, NamedTuple, TypeVar

_Entry = TypeVar("_Entry")
_FOLDER = "calibration.addons"


class LazyCommand(NamedTuple):
    """A command, or an option of one, whose module is imported when it is called."""

    target: str
    """``module:attribute`` of the click command, or of the function."""
    help: str
    """One-line description, kept here so that ``--help`` imports no command."""


class DocumentSection(NamedTuple):
    """A key of a document whose value is a record of an add-on."""

    record: str
    """``module:class`` of the record; its module must import nothing heavy, as every reader of the document does."""
    help: str
    """Description of the key."""


class AddonStage(NamedTuple):
    """A stage of the pipeline, which runs if its section is in calibration.yml."""

    target: str
    """``module:function`` from `Run` to `Run` (`calibration.pipeline.running`)."""
    section: str
    """Its section of calibration.yml, and the key of its result in results.json."""
    result: DocumentSection
    """Its result, a `StageResult` (`calibration.ci.report.report`)."""
    needs_image: bool = False
    """Whether it runs in the image of the run, which is built for it."""
    job: str = ""
    """The job of the reusable workflow that runs this stage alone; empty for none."""
    last: bool = False
    """Whether it runs after the stages of other add-ons, as it needs their results."""


class BackendKind(NamedTuple):
    """A backend for jobs of containers, whose settings are the section of calibration.yml of its name, if any."""

    target: str
    """``module:callable``, which creates the backend, a context manager, for an `ExecutionTarget`."""
    leftovers: str
    """``module:callable``, which creates its `Leftovers`."""
    resumes: bool = False
    """Whether results outlive the command, so that a run of the same name reuses them and runs only missing jobs."""


class SchemaFile(NamedTuple):
    """A JSON Schema in the package, and the record that generates it (`make actions`)."""

    package: str
    file: str
    record: str
    """``module:class``; the module is relative to the package."""
    command: str = ""
    """Command whose results.json it describes."""


@dataclass(frozen=True, kw_only=True)
class Addon:
    """What an add-on brings, by name."""

    commands: Mapping[str, LazyCommand] = field(default_factory=dict)
    sections: Mapping[str, DocumentSection] = field(default_factory=dict)
    """Sections of calibration.yml."""
    stages: Mapping[str, AddonStage] = field(default_factory=dict)
    backends: Mapping[str, BackendKind] = field(default_factory=dict)
    registry_logins: Mapping[str, str] = field(default_factory=dict)
    """``module:function`` that gets the credentials of a kind of registry (``registry: {kind: ...}``)."""
    schemas: Mapping[str, SchemaFile] = field(default_factory=dict)
    keeps: Mapping[str, LazyCommand] = field(default_factory=dict)
    """Options of ``accept`` that are given several times, by name: a function of their values and the `AcceptedSystems`
    (`calibration.pipeline.baselines`), which returns the content of files to be kept with the baseline, by path."""
    watches: Mapping[str, str] = field(default_factory=dict)
    """``module:function`` that returns the watch of a collection's containers (`calibration.ci.execution.supervision`),
    by the section of calibration.yml that it is given, with the name of the collection and the port of rosbridge."""


@cache
def installed_addons() -> tuple[Addon, ...]:
    """Import the page of each folder of ``calibration/addons``, and return what they bring, in the folders' order."""
    if find_spec(_FOLDER) is None:
        return ()
    folders = sorted(each.name for each in iter_modules(import_module(_FOLDER).__path__) if each.ispkg)
    return tuple(import_attribute(f"{_FOLDER}.{name}:ADDON") for name in folders)


def of_addons(entries_of: Callable[[Addon], Mapping[str, _Entry]]) -> dict[str, _Entry]:
    """Return the entries of one kind of all add-ons, by name, such as ``of_addons(lambda addon: addon.commands)``."""
    return {name: entry for addon in installed_addons() for name, entry in entries_of(addon).items()}


def import_attribute(target: str) -> Any:
    """Import ``module:attribute``."""
    module, _, attribute = target.partition(":")
    return getattr(import_module(module), attribute)
