"""Which files count: those that the repository tracks, that are source code, and that are no tests."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from calibration.errors import InputError
from calibration.git.repository import Repository

LANGUAGES = {
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
"""By suffix; the names are those of Codacy."""
_LANGUAGE = {suffix: language for language, suffixes in LANGUAGES.items() for suffix in suffixes}
NO_SOURCES = (
    *("**/test", "**/tests", "**/test_*.*", "**/*_test.*", "**/*_tests.*", "**/conftest.py"),
    *("**/setup.py", "**/noxfile.py", "**/docs/conf.py", "**/doc/conf.py"),
)
"""What does not count unless told otherwise, as patterns of git: tests, and what builds and documents."""


def language_of(path: str) -> str | None:
    """The language of a file, by its suffix; None of no source code."""
    return _LANGUAGE.get(PurePosixPath(path).suffix.lower())


@dataclass(frozen=True)
class Sources:
    """The files that count."""

    repository: Repository
    directory: Path
    """Where the tests run."""
    folders: tuple[str, ...]
    """What the user has named, relative to the root; none for the whole repository."""
    tracked: Sequence[str]
    """Every tracked file."""
    counted: Sequence[str]
    """Those that count."""

    def measured(self) -> list[str]:
        """What coverage.py is to measure: folders, and packages, which may be installed elsewhere when they are run."""
        root = self.repository.root
        return [str(root / folder) for folder in self.folders or (".",)] + self._packages()

    def _packages(self) -> list[str]:
        folders = {str(PurePosixPath(path).parent) for path in self.counted if path.endswith("/__init__.py")}
        return sorted(
            PurePosixPath(folder).name for folder in folders if str(PurePosixPath(folder).parent) not in folders
        )


def find_sources(
    repository: Repository, directory: Path, named: Iterable[Path], exclude: Iterable[str] | None
) -> Sources:
    """Find the files that count.

    Args:
        repository: that the directory lies in.
        directory: where the tests run.
        named: folders and files of sources, relative to it.
        exclude: patterns of git for what does not count; None for :data:`NO_SOURCES`.

    Raises:
        InputError: a source is outside of the repository, or nothing of it is tracked and source code.
    """
    folders = []
    for path in named:
        inside = repository.path(directory / path)
        if inside is None:
            raise InputError(f"source: {path}: found a path outside of the repository {repository.root}")
        folders.append(inside)
    # The folders are not left to git: version 2.39 goes wrong where they come together with patterns to exclude.
    candidates = list(filter(language_of, repository.tracked(NO_SOURCES if exclude is None else exclude)))
    for folder in folders or (".",):
        if not any(_lies_in(path, folder) for path in candidates):
            raise InputError(f"source: {folder}: no source file was found there that git tracks and exclude leaves in")
    counted = [path for path in candidates if any(_lies_in(path, folder) for folder in folders or (".",))]
    return Sources(repository, directory, tuple(folders), repository.tracked(), counted)


def _lies_in(path: str, folder: str) -> bool:
    return folder in (".", path) or path.startswith(f"{folder}/")
