"""What coverage is of: a commit, and the files that count, which are tracked source files and no tests."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from calibration.base.errors import InputError
from calibration.base.text import one_line, shorten
from calibration.ci.git import Repository, is_commit
from calibration.ci.workflow.runner import Event

SUFFIXES_OF_LANGUAGE = {
    "c": (".c",),
    "cpp": (".cc", ".cpp", ".cxx", ".h", ".hh", ".hpp", ".hxx", ".ipp", ".tpp"),
    "csharp": (".cs",),
    "go": (".go",),
    "java": (".java",),
    "javascript": (".js", ".jsx", ".mjs", ".cjs"),
    "kotlin": (".kt",),
    "php": (".php",),
    "python": (".py", ".pyw"),
    "ruby": (".rb",),
    "rust": (".rs",),
    "scala": (".scala",),
    "shell": (".sh", ".bash"),
    "swift": (".swift",),
    "typescript": (".ts", ".tsx"),
}
"""Suffixes by language, in Codacy's names."""
PYTHON_LANGUAGE = "python"
_LANGUAGE_OF_SUFFIX = {suffix: language for language, suffixes in SUFFIXES_OF_LANGUAGE.items() for suffix in suffixes}
NO_SOURCES = (
    *("**/test", "**/tests", "**/test_*.*", "**/*_test.*", "**/*_tests.*", "**/conftest.py"),
    *("**/setup.py", "**/noxfile.py", "**/docs/conf.py", "**/doc/conf.py"),
)
"""Default of ``exclude``, as git patterns: tests, build scripts and configuration of documentation."""


def language_of(path: str) -> str | None:
    """Return the language of a file by its suffix; None if it is not source code."""
    return _LANGUAGE_OF_SUFFIX.get(PurePosixPath(path).suffix.lower())


@dataclass(frozen=True)
class Sources:
    """Files that count for coverage."""

    repository: Repository
    directory: Path
    """Working directory of the tests."""
    folders: tuple[str, ...]
    """Folders and files that the user named, relative to the root; none for the whole repository."""
    tracked: Sequence[str]
    """Every tracked file."""
    counted: Sequence[str]
    """Every file that counts."""

    def measured(self) -> list[str]:
        """Return the sources for coverage.py: folders, and packages, which may be imported from an installed copy."""
        root = self.repository.root
        named = [root / folder for folder in self.folders or (".",)]
        # Of a file its folder, since coverage.py takes files for names of packages; what counts is chosen later.
        folders = dict.fromkeys(str(path if path.is_dir() else path.parent) for path in named)
        return [*folders, *self._top_packages()]

    def _top_packages(self) -> list[str]:
        folders = {str(PurePosixPath(path).parent) for path in self.counted if path.endswith("/__init__.py")}
        return sorted(
            PurePosixPath(folder).name for folder in folders if str(PurePosixPath(folder).parent) not in folders
        )


def find_sources(
    repository: Repository, directory: Path, named: Iterable[Path], exclude: Iterable[str] | None
) -> Sources:
    """Find the files that count.

    Args:
        repository: the repository of the directory.
        directory: working directory of the tests.
        named: folders and files of sources, relative to it.
        exclude: git patterns of files that do not count; None for :data:`NO_SOURCES`.

    Raises:
        InputError: a source is outside of the repository, or contains no tracked source file.
    """
    folders = []
    for path in named:
        inside = repository.path(directory / path)
        if inside is None:
            raise InputError(f"source: {path}: found a path outside of the repository {repository.root}")
        folders.append(inside)
    # Folders are filtered here: git 2.39 fails if they are combined with patterns to exclude.
    candidates = list(filter(language_of, repository.tracked(NO_SOURCES if exclude is None else exclude)))
    for folder in folders or (".",):
        if not any(_lies_in(path, folder) for path in candidates):
            raise InputError(f"source: {folder}: no source file was found there that git tracks and exclude leaves in")
    counted = [path for path in candidates if any(_lies_in(path, folder) for folder in folders or (".",))]
    return Sources(repository, directory, tuple(folders), repository.tracked(), counted)


def find_commit(given: str | None, event: Event, repository: Repository) -> tuple[str, str]:
    """Return the commit to report coverage for, and the source of that information.

    For a pull request it is the head commit, not the merge commit that GitHub creates for testing. For
    ``pull_request_target`` it is the commit that is checked out, by default the base.

    Raises:
        InputError: the given commit is not a full hash, or no commit is known.
    """
    if given is not None:
        if not is_commit(given.lower()):
            raise InputError(f"commit: found {shorten(one_line(given))!r}, expected a hash of 40 hexadecimal digits")
        return given.lower(), "as given"
    head = repository.head()
    pull_request = event.pull_request_commit
    candidates = [
        (None if event.checks_out_base else pull_request, "the pull request's last"),
        (event.followed_commit, "that of the workflow that this one follows"),
    ]
    if event.checks_out_base and head is not None:
        merged = pull_request is not None and pull_request in repository.parents(head)
        candidates.append((pull_request if merged else head, "the one that is checked out"))
    candidates += [(event.commit, "GITHUB_SHA"), (head, "the one that is checked out")]
    for sha, source in candidates:
        if sha is not None and is_commit(sha):
            return sha, source
    raise InputError("commit is not given, and there is no checkout: set commit, or check out the repository")


def _lies_in(path: str, folder: str) -> bool:
    return folder in (".", path) or path.startswith(f"{folder}/")
