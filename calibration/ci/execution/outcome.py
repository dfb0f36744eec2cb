"""Outcome of a job, its artifacts, and its folder with the results, the same for all backends.

Artifacts are copied out of a container, all of them or none.

The folder has ``artifacts/``, ``logs/``, and ``manifest.json`` with the outcome: ``schema`` (1), ``job``, ``run``,
``verdict`` (pass or fail), ``exit_code`` (1, 2 or 3 for a fail), ``reasons`` (a line each), ``seconds``;
``containers``: ``name``, ``image`` (its id), ``end`` (a value of :class:`End`),
``exit_code``, ``signal``, ``seconds``, ``log`` (relative to the manifest); ``artifacts``: ``path`` (relative to
``artifacts/``), ``container``, ``size`` (bytes), ``sha256``; ``left_out``: links among the artifacts. It contains
nothing of a container's environment.
"""

import enum
import json
import os
import re
import shutil
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from fnmatch import translate
from functools import cached_property
from pathlib import Path
from typing import Annotated, Literal

from calibration.base import ExitCode, InputError, shorten, write_atomically, writing
from calibration.base.records import Converted, between, field, length, matching, record
from calibration.ci.execution.extraction import Budget, Extraction, RefusedError, extract
from calibration.ci.execution.job import Artifact, Container

_ANY_WILDCARD = r"[*?\[]"


class End(enum.StrEnum):
    """Way in which a container ended."""

    EXITED = "exited"
    """Exited by itself."""
    SIGNALLED = "killed by a signal"
    """Killed by a signal, not by us."""
    OUT_OF_MEMORY = "out of memory"
    """Exceeded its memory, itself or one of its processes, whatever the exit code."""
    TIMED_OUT = "timed out"
    """Stopped at its time limit, or that of the job."""
    NOT_READY = "not ready"
    """Not ready in time, or ended before it was ready."""
    STOPPED = "stopped"
    """Stopped because the job was over."""
    NOT_STARTED = "not started"
    LOST = "lost"
    """Unknown, because the connection to the engine was lost."""


@record(case="snake", nulls=True)
class ContainerOutcome:
    """Outcome of one container: its end, exit code, duration and log."""

    name: Annotated[str, length(most=4096)] = field("Name of the container.")
    end: Annotated[End, Converted(Literal[tuple(map(str, End))], lambda end, _: End(end))] = field("How it ended.")
    exit_code: Annotated[int, between(0, 255)] | None = field("Its exit code, if it exited.", default=None)
    signal: Annotated[str, matching("SIG[A-Z0-9+]{1,20}", "a signal's name")] | None = field(
        "Signal that killed it, such as SIGKILL.", default=None
    )
    seconds: Annotated[float, between(0, 1e9)] = field("Duration.", default=0.0)
    log: Path | None = None
    """File with its output."""
    image: str = ""
    """Id of its image, if the backend knows it."""


@record(case="snake")
class ArtifactFile:
    """A file copied out of a container."""

    path: Annotated[str, length(most=64 * 1024)] = field("Path relative to the job's artifacts.")
    container: Annotated[str, length(most=4096)] = field("Name of the container.")
    size: Annotated[int, between(0, 2**63 - 1)] = field("Size in bytes.")
    sha256: Annotated[str, matching("[0-9a-f]{64}", "64 hexadecimal digits")] = field("Digest of its content.")


@dataclass(frozen=True)
class JobOutcome:
    """Outcome of a job."""

    job: str
    folder: Path
    """Contains ``artifacts/``, ``logs/<container>.log`` and ``manifest.json``."""
    containers: tuple[ContainerOutcome, ...] = ()
    artifacts: tuple[ArtifactFile, ...] = ()
    left_out: tuple[str, ...] = ()
    """Notes on artifacts that were not copied, a line each: links to other artifacts."""
    reasons: tuple[str, ...] = ()
    """Reasons of the failure, a line each, the cause first; empty if it succeeded."""
    exit_code: ExitCode = ExitCode.PASS
    """1 if the software in the containers failed (also: not ready, missing or unsafe artifacts), 2 if the
    job is wrong (unknown image or user), 3 for a failed infrastructure: engine, or time limit."""
    seconds: float = 0.0

    @property
    def verdict(self) -> Literal["pass", "fail"]:
        """Pass if the exit code is 0."""
        return "pass" if self.exit_code == ExitCode.PASS else "fail"


ARTIFACTS_FOLDER, LOGS_FOLDER = "artifacts", "logs"
"""Subfolders of a job's folder."""
FILE_NAME = "manifest.json"


def make_job_folder(folder: Path) -> None:
    """Create a job's folder, without results of an earlier run.

    Raises:
        InfrastructureError: it cannot be written.
    """
    with writing(folder):
        for name in (ARTIFACTS_FOLDER, LOGS_FOLDER, FILE_NAME):
            place = folder / name
            if place.is_dir() and not place.is_symlink():
                shutil.rmtree(place)
            else:
                place.unlink(missing_ok=True)
        (folder / LOGS_FOLDER).mkdir(parents=True)


def write_manifest(outcome: JobOutcome, run: str) -> None:
    """Write the manifest of a job into its folder.

    Raises:
        InfrastructureError: it cannot be written.
    """
    document = {
        "schema": 1,
        "job": outcome.job,
        "run": run,
        "verdict": outcome.verdict,
        "exit_code": int(outcome.exit_code),
        "reasons": outcome.reasons,
        "seconds": round(outcome.seconds, 3),
        "containers": [
            {
                "name": container.name,
                "image": container.image,
                "end": container.end.value,
                "exit_code": container.exit_code,
                "signal": container.signal,
                "seconds": round(container.seconds, 3),
                "log": None if container.log is None else container.log.relative_to(outcome.folder).as_posix(),
            }
            for container in outcome.containers
        ],
        "artifacts": [
            {"path": file.path, "container": file.container, "size": file.size, "sha256": file.sha256}
            for file in outcome.artifacts
        ],
        "left_out": outcome.left_out,
    }
    write_atomically(outcome.folder / FILE_NAME, json.dumps(document, indent=1, allow_nan=False) + "\n")


@dataclass(frozen=True)
class Glob:
    """A path in a container that may contain wildcards."""

    path: str
    """Absolute, without ``.`` and ``..``."""

    @cached_property
    def source(self) -> str:
        """Path to read: the path itself, or its last folder without a wildcard."""
        return "/" + "/".join(self._path_parts[: self._parts_before_wildcard])

    def landing(self, inside: Sequence[str]) -> tuple[str, ...] | None:
        """Return the target of a path below :attr:`source`, relative to the last folder without a wildcard.

        Args:
            inside: parts of the path relative to `source`; empty for `source` itself.

        Returns:
            None if the pattern does not match. A folder matches with all its content.
        """
        if self._parts_before_wildcard == len(self._path_parts):
            return (*self._path_parts[-1:], *inside)
        return tuple(inside) if self._matches_inside(inside) else None

    @cached_property
    def _path_parts(self) -> tuple[str, ...]:
        return tuple(part for part in self.path.split("/") if part)

    @cached_property
    def _parts_before_wildcard(self) -> int:
        """Number of parts before the first wildcard."""
        return next(
            (i for i, part in enumerate(self._path_parts) if re.search(_ANY_WILDCARD, part)), len(self._path_parts)
        )

    @cached_property
    def _part_patterns(self) -> tuple[re.Pattern[str] | None, ...]:
        """A pattern for each part from the first wildcard; None for ``**``."""
        parts = self._path_parts[self._parts_before_wildcard :]
        parts += ("*",) if parts[-1] == "**" else ()  # at the end it matches files too
        return tuple(None if part == "**" else _pattern_of_part(part) for part in parts)

    def _matches_inside(self, inside: Sequence[str]) -> bool:
        """Return whether the pattern matches the path, or a folder that contains it."""
        # Simulates the states of a nondeterministic automaton: linear in the length, for any number of **.
        states = self._past_stars({0})
        for part in inside:
            if len(self._part_patterns) in states:
                return True
            states = self._past_stars({after for state in states for after in self._next_states(state, part)})
        return len(self._part_patterns) in states

    def _next_states(self, state: int, part: str) -> Iterator[int]:
        pattern = self._part_patterns[state]
        if pattern is None:
            if not part.startswith("."):
                yield state  # ** also matches this folder
        elif pattern.match(part):
            yield state + 1

    def _past_stars(self, states: set[int]) -> set[int]:
        for state in sorted(states):
            following = state
            while following < len(self._part_patterns) and self._part_patterns[following] is None:
                following += 1
                states.add(following)
        return states


def _pattern_of_part(part: str) -> re.Pattern[str]:
    # as in a shell, a leading wildcard does not match the dot of a hidden file
    hidden = "" if part.startswith(".") else r"(?!\.)"
    return re.compile(hidden + translate(part))


class NothingThereError(Exception):
    """The file or folder does not exist in the container."""


@dataclass(frozen=True)
class Archive:
    """A file or folder of a container as a tar stream."""

    chunks: Iterator[bytes]
    link: str
    """Target if it is a link, else empty."""


Opener = Callable[[str], AbstractContextManager[Archive]]
"""Opens an absolute path in a container; raises `NothingThereError` or InfrastructureError."""


class ArtifactCopier:
    """Copies artifacts of one container after the other."""

    def __init__(self, folder: Path, budget: Budget, go_on: Callable[[], None]) -> None:
        """Use an existing empty folder; ``go_on`` is called regularly, and may raise to abort."""
        self.files: list[ArtifactFile] = []
        self.left_out: list[str] = []
        self.missing: list[str] = []
        """A message for each missing required artifact."""
        self._folder = folder
        self._budget = budget
        self._go_on = go_on

    def copy(self, container: Container, opener: Opener) -> None:
        """Copy the artifacts of a container.

        Raises:
            RefusedError: an artifact is unsafe or too large.
            InputError: two artifacts have the same target.
            InfrastructureError: it cannot be read, or a file cannot be written.
        """
        for artifact in container.artifacts:
            try:
                found = self._extract_glob(container, opener, Glob(artifact.path))
            except RefusedError as error:
                raise RefusedError(f"container '{container.name}': {error}") from None
            self.left_out += [f"container '{container.name}': {note}" for note in found.left_out]
            self._add_files(container, found)
            if artifact.required and not found.files:
                self.missing.append(_describe_missing(container, artifact, found))

    def _extract_glob(self, container: Container, opener: Opener, glob: Glob) -> Extraction:
        # Extracted to a separate folder first, because equal files of other artifacts are no conflict.
        with _fresh_folder(self._folder) as fresh:
            try:
                found = self._read_archive(opener, glob, fresh)
            except NothingThereError:
                return Extraction()
            self._move_to_artifacts(fresh, found, container)
            return found

    def _read_archive(self, opener: Opener, glob: Glob, fresh: Path) -> Extraction:
        with opener(glob.source) as archive:
            if not archive.link:
                return extract(self._until_stopped(archive.chunks), glob.landing, glob.source, fresh, self._budget)
            link = archive.link
        # the artifact itself may be a link, such as one to the latest folder
        with opener(link) as archive:
            return extract(self._until_stopped(archive.chunks), glob.landing, link, fresh, self._budget)

    def _until_stopped(self, chunks: Iterator[bytes]) -> Iterator[bytes]:
        for chunk in chunks:
            self._go_on()
            yield chunk

    def _move_to_artifacts(self, fresh: Path, found: Extraction, container: Container) -> None:
        """Move extracted files to the artifacts."""
        there = {file.path: file for file in self.files}
        for file in found.files:
            before = there.get(file.path)
            target = self._folder / file.path
            if before is not None and before.sha256 == file.sha256:
                continue
            if before is not None or target.exists():
                raise InputError(
                    f"container '{container.name}': two artifacts of the job have the same target '{file.path}', with "
                    "different content"
                )
            try:
                target.parent.mkdir(parents=True, exist_ok=True)
            except (FileExistsError, NotADirectoryError):
                raise InputError(
                    f"container '{container.name}': the artifact '{file.path}' is inside of a path that is a file of "
                    "another artifact"
                ) from None
            (fresh / file.path).rename(target)

    def _add_files(self, container: Container, found: Extraction) -> None:
        known = {file.path for file in self.files}
        self.files += [
            ArtifactFile(file.path, container.name, file.size, file.sha256)
            for file in found.files
            if file.path not in known
        ]


@contextmanager
def complete_or_not_at_all(folder: Path) -> Iterator[Path]:
    """Yield a temporary folder, which becomes ``folder`` if the block succeeds, and is removed otherwise.

    Raises:
        InfrastructureError: it cannot be created.
    """
    with _fresh_folder(folder) as fresh:
        yield fresh
        fresh.rename(folder)


@contextmanager
def _fresh_folder(folder: Path) -> Iterator[Path]:
    """Yield a temporary folder beside ``folder``, which is removed at the end of the block."""
    fresh = folder.with_name(f".{folder.name}-{os.urandom(6).hex()}")
    try:
        with writing(folder):
            fresh.mkdir(parents=True)
            yield fresh
    finally:
        shutil.rmtree(fresh, ignore_errors=True)


def _describe_missing(container: Container, artifact: Artifact, found: Extraction) -> str:
    there = f"; beside it are {', '.join(found.seen)}" if found.seen else ""
    return shorten(f"container '{container.name}' left no file for the artifact '{artifact.path}'{there}", 400)
