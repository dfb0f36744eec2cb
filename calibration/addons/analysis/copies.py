"""Copies of a repository's files in a folder, and comparison of the findings in two of them.

Copies have regular files only, so that no link leads out of them. Findings of two states are matched by rule and
content, never by line number.
"""

import re
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath

from calibration.addons.analysis.results import CodeFinding
from calibration.base import InputError, read_bytes
from calibration.ci.git import Repository

MAX_BYTES = 1_000_000
"""Limit of a file's size in bytes; larger ones are generated."""
MAX_FILES = 50_000
_DATA_SUFFIXES = (
    *(".dae", ".gif", ".jpeg", ".jpg", ".obj", ".pdf", ".png", ".stl", ".svg"),
    *(".bag", ".db3", ".gz", ".mcap", ".npy", ".npz", ".pcd", ".ply", ".zip"),
)
"""Suffixes of data files, which are skipped without a report."""
_ANALYSED_SUFFIXES = (
    *(".bash", ".launch", ".py", ".pyi", ".sdf", ".sh", ".srdf", ".test", ".urdf", ".xacro", ".xml"),
    *(".c", ".cc", ".cpp", ".cxx", ".h", ".hh", ".hpp", ".hxx", ".yaml", ".yml", ".action", ".msg", ".srv"),
)
"""Suffixes of files that an analyser may look at; with those without a suffix, and `_ANALYSED_NAMES`, they count."""
_ANALYSED_NAMES = ("CMakeLists.txt", "dataset.json", "setup.cfg")
_MESH_SUFFIX = ".stl"
"""Suffix of data files that are copied, for checks of the files that name them."""
MAX_MESH_BYTES = 20_000_000
_MAX_PATH_LENGTH = 4000
"""Limit of a path's length in characters."""


@dataclass(frozen=True)
class Copy:
    """Folder with the files of one state of the repository."""

    root: Path
    files: tuple[str, ...]
    """Analysed files, with ``/``, sorted."""
    left_out: Mapping[str, str] = field(default_factory=dict)
    """Reason why a file is not analysed, by path; without data files."""
    present: tuple[str, ...] = ()
    """All tracked files, also those that are not copied."""
    opaque: tuple[str, ...] = ()
    """Symbolic links and submodules."""
    meshes: tuple[str, ...] = ()
    """Meshes that are copied too, and not analysed themselves."""

    def text(self, path: str) -> str:
        """Return the text of a file; invalid UTF-8 is replaced."""
        return (self.root / path).read_bytes().decode("utf-8", "replace")

    def first_line(self, path: str) -> str:
        """Return the first line of a file, at most 200 characters."""
        with (self.root / path).open("rb") as stream:
            return stream.readline(200).decode("utf-8", "replace").strip()

    def is_utf8(self, path: str) -> bool:
        """Whether a file is UTF-8."""
        try:
            (self.root / path).read_bytes().decode("utf-8")
        except UnicodeDecodeError:
            return False
        return True

    def lines(self, path: str) -> list[str]:
        r"""Return the lines of a file, as all analysers count them: they end in ``\n``."""
        return self.text(path).split("\n")


def chosen_files(paths: Sequence[str], asked: Sequence[str], settings: Collection[str]) -> list[str]:
    """Return the files to copy: all, which are read beside the requested ones too, or in a large repository fewer.

    Args:
        paths: the tracked files.
        asked: the requested ones of them.
        settings: names of files with settings of analysers, which are always copied.
    """
    if sum(map(may_be_analysed, paths)) <= MAX_FILES:
        return list(paths)
    requested = set(asked)
    return [path for path in paths if path in requested or PurePosixPath(path).name in settings]


def may_be_analysed(path: str) -> bool:
    """Whether a file may be one that an analyser looks at, by its name."""
    name = PurePosixPath(path)
    return name.suffix.lower() in ("", *_ANALYSED_SUFFIXES) or name.name in _ANALYSED_NAMES


def copied(repository: Repository, folder: Path, paths: Iterable[str]) -> Copy:
    """Copy the files of the working tree.

    Raises:
        InputError: there are too many.
        InfrastructureError: one cannot be read or written.
    """
    left_out: dict[str, str] = {}
    kept: list[str] = []
    meshes: list[str] = []
    analysed = 0
    for path in paths:
        suffix = PurePosixPath(path).suffix.lower()
        if suffix == _MESH_SUFFIX and _why_name_is_unfit(path) is None and _copied_mesh(repository, folder, path):
            meshes.append(path)
        if suffix in _DATA_SUFFIXES:
            continue
        analysed += may_be_analysed(path)
        if analysed > MAX_FILES:
            raise InputError(f"{repository.root}: more than {MAX_FILES} files are to be analysed: name folders (paths)")
        if why := _why_name_is_unfit(path):
            left_out[path] = why
            continue
        try:
            data = read_bytes(repository.root / path, MAX_BYTES, "a file")
        except InputError as error:
            left_out[path] = str(error).removeprefix(f"{repository.root / path}: ")
            continue
        if _is_binary(data):
            left_out[path] = "this is no text"
            continue
        _write_file(folder / path, data)
        kept.append(path)
    return Copy(folder, tuple(kept), left_out, tuple(repository.tracked()), tuple(repository.links()), tuple(meshes))


def _copied_mesh(repository: Repository, folder: Path, path: str) -> bool:
    """Copy a mesh; False if it is too large."""
    try:
        data = read_bytes(repository.root / path, MAX_MESH_BYTES, "a mesh")
    except InputError:
        return False
    _write_file(folder / path, data)
    return True


def before(now: Copy, repository: Repository, commit: str, folder: Path, changed: Iterable[str]) -> Copy:
    """Copy the changed files as of a commit, with the current version of all others.

    The others are read by analysers too: the team's settings, and headers. So a change of the settings
    alone makes no finding new.

    Args:
        now: the copy of the working tree.
        repository: the checkout.
        commit: the earlier commit.
        folder: folder of the new copy.
        changed: the files that differ between the working tree and the commit, without settings.

    Raises:
        InfrastructureError: git fails, or a file cannot be written.
    """
    for path in (*now.files, *now.meshes):
        target = folder / path
        target.parent.mkdir(parents=True, exist_ok=True)
        target.hardlink_to(now.root / path)
    kept = []
    present = dict.fromkeys(now.present)
    for path in changed:
        (folder / path).unlink(missing_ok=True)
        present.pop(path, None)
        try:
            data = None if _why_name_is_unfit(path) else repository.content(commit, path, MAX_BYTES)
        except InputError:
            present[path] = None
            continue  # a link, a folder, or too large
        if data is not None:
            present[path] = None
        if data is not None and not _is_binary(data):
            _write_file(folder / path, data)
            kept.append(path)
    meshes = tuple(path for path in now.meshes if (folder / path).exists())
    return Copy(folder, tuple(kept), present=tuple(present), opaque=now.opaque, meshes=meshes)


def _is_binary(data: bytes) -> bool:
    return b"\0" in data[:8000]


def _why_name_is_unfit(path: str) -> str | None:
    if "\n" in path or "\t" in path or "\r" in path or len(path) > _MAX_PATH_LENGTH or not path.isprintable():
        return "its name has characters that do not print"
    return None


def _write_file(path: Path, data: bytes) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(data)


_FORMATTING_CHARACTERS = re.compile(r"[\s,;()'\"\\]+")
"""Characters that formatters move, add and remove."""


@dataclass(frozen=True)
class Located:
    """Finding with the content of its line, to match it after the line has moved."""

    finding: CodeFinding
    content: str
    """The line, without what formatters change; the message if the line is empty."""


def plain_content(text: str) -> str:
    """Return a text without spaces, line ends, quotes, commas and parentheses."""
    return _FORMATTING_CHARACTERS.sub("", text)


def located(finding: CodeFinding, lines: Sequence[str]) -> Located:
    """Return a finding with the content of its line; ``lines`` are those of its file."""
    text = lines[finding.line - 1] if 1 <= finding.line <= len(lines) else ""
    return Located(finding, plain_content(text) or finding.message)


@dataclass(frozen=True)
class Compared:
    """New, known and fixed findings of two states of a repository."""

    new: tuple[CodeFinding, ...]
    unchanged: tuple[CodeFinding, ...]
    fixed: tuple[CodeFinding, ...]
    """Fixed findings, at their lines in the earlier state."""


def with_content(findings: Sequence[CodeFinding], copy: Copy) -> list[Located]:
    """Return findings with the content of their lines."""
    lines = {path: copy.lines(path) for path in {finding.path for finding in findings}}
    return [located(finding, lines[finding.path]) for finding in findings]


def compare(
    now: Sequence[CodeFinding],
    copy: Copy,
    earlier: Sequence[CodeFinding],
    base: Copy,
    changed: Collection[str],
    whole: Collection[str] = (),
) -> Compared:
    """Compare findings with those of an earlier state, in which only the changed files were analysed.

    The analysers that ``whole`` names were run on all files of the earlier state.

    A finding is known if the earlier state has one of its rule on a line of the same content, in any file; or one of
    its rule and message in a file that has the content anywhere, as when a formatter has broken the line. Each earlier
    finding matches at most one.
    """
    touched = set(changed)

    def is_open(finding: CodeFinding) -> bool:
        return finding.path in touched or finding.rule.partition("/")[0] in whole

    unchanged = [finding for finding in now if not is_open(finding)]
    open_now = with_content([finding for finding in now if is_open(finding)], copy)
    open_before = with_content(earlier, base)
    open_now, open_before, matched = _match_by_key(
        open_now, open_before, lambda each: (each.finding.rule, each.content)
    )
    unchanged += matched
    texts: dict[str, str] = {}

    def was_there(new: Located, old: Located) -> bool:
        path = old.finding.path
        texts.setdefault(path, plain_content(base.text(path)))
        return new.content in texts[path]

    new = []
    for each in open_now:
        same = (
            old
            for old in open_before
            if (old.finding.rule, old.finding.message) == (each.finding.rule, each.finding.message)
            and was_there(each, old)
        )
        if (known := next(same, None)) is None:
            new.append(each.finding)
        else:
            open_before.remove(known)
            unchanged.append(each.finding)
    return Compared(tuple(new), tuple(unchanged), tuple(each.finding for each in open_before))


def _match_by_key(
    now: Sequence[Located], earlier: Sequence[Located], key: Callable[[Located], tuple[str, str]]
) -> tuple[list[Located], list[Located], list[CodeFinding]]:
    """Return the current and earlier findings without a partner, and the current ones with a partner.

    Partners in the same file are matched first, so that the remaining ones are at the expected file.
    """
    matched: list[CodeFinding] = []
    for full in (lambda each: (each.finding.path, *key(each)), key):
        counts = Counter(map(full, earlier))
        rest = []
        for each in now:
            if counts[full(each)] > 0:
                counts[full(each)] -= 1
                matched.append(each.finding)
            else:
                rest.append(each)
        left = []
        for each in reversed(earlier):
            if counts[full(each)] > 0:
                counts[full(each)] -= 1
                left.append(each)
        now, earlier = rest, left[::-1]
    return list(now), list(earlier), matched
