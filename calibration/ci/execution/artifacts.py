"""Artifacts of a job: their paths with shell patterns, and copying out of its containers: all of them, or none."""

import os
import re
import shutil
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from fnmatch import translate
from functools import cached_property
from pathlib import Path

from calibration.base import InputError, shorten, writing
from calibration.ci.execution.extraction import Budget, Extraction, RefusedError, extract
from calibration.ci.execution.job import Artifact, Container
from calibration.ci.execution.outcome import ArtifactFile

_ANY_WILDCARD = r"[*?\[]"


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
