"""A git checkout: tracked files, commits, and changes with the lines that they add."""

import errno
import os
import re
import resource
import subprocess
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import Self

from calibration.base import InfrastructureError, InputError, one_line, shorten

COMMAND_SECONDS = 120
"""Timeout of a git command."""
MAX_MEMORY_BYTES = 2 * 1024**3
"""Limit of its memory, bytes: it takes 40 times the size of a file of line breaks to compare it."""
_SAFE_SETTINGS = (
    "core.fsmonitor=false",
    f"core.hooksPath={os.devnull}",
    "core.bigFileThreshold=10m",  # larger files are compared as binary ones
    "core.alternateRefsCommand=true",  # the program that says nothing: an empty value would run what follows it
    "core.quotePath=true",
    "credential.helper=",
    "fetch.recurseSubmodules=false",  # which have settings of their own
    "gc.auto=0",
    "maintenance.auto=false",
    "safe.bareRepository=explicit",
)
_SAFE_VARIABLES = {
    "GIT_CONFIG_GLOBAL": os.devnull,
    "GIT_CONFIG_NOSYSTEM": "1",
    "GIT_ATTR_NOSYSTEM": "1",
    "GIT_ASKPASS": "",
    "GIT_TERMINAL_PROMPT": "0",
    "GIT_ALLOW_PROTOCOL": "https",
    "LC_ALL": "C",
}
"""Environment of git. Also a command that only reads fetches what a partial clone lacks: by https alone."""
_FETCH_VARIABLES = {"GIT_ALLOW_PROTOCOL": "https:file", "GIT_NO_LAZY_FETCH": "1"}
"""With a file as origin, its own settings count in git-upload-pack, which must not fetch what the origin lacks."""
_PROGRAM_SETTINGS = r"^(filter\..*\.(clean|smudge|process|required)|hook\..*)$"
"""Settings that run a program of any name, as git's regular expression; the fixed names are in `_SAFE_SETTINGS`."""
_REGULAR_FILE_MODES = ("100644", "100755")
"""Modes of regular files, without symbolic links, which may point anywhere, and submodules."""
_BLOB_LINE = re.compile(rb"([0-9a-f]+) blob ([0-9]+)")
_COMMIT_HASH = re.compile(r"[0-9a-f]{40}|[0-9a-f]{64}")


def is_commit(text: str) -> bool:
    """Return whether a text is the full hash of a commit."""
    return _COMMIT_HASH.fullmatch(text) is not None


@dataclass(frozen=True)
class Commit:
    """A commit of the history."""

    hash: str
    date: str
    """YYYY-MM-DD."""
    subject: str

    def __str__(self) -> str:
        return f"{self.date} ({self.hash[:7]})"


@dataclass(frozen=True)
class Repository:
    """A checkout of a git repository."""

    root: Path
    """Resolved path, without symbolic links."""
    disabled: tuple[str, ...] = ()
    """Settings of git that disable programs which the repository's own settings name."""

    @classmethod
    def around(cls, directory: Path) -> Self:
        """Return the checkout that contains a folder: the nearest folder above with ``.git``, which nobody can commit.

        Git itself would take any folder for a repository that has ``HEAD``, ``objects`` and ``refs``, with the
        programs that its ``config`` names; these are files that anyone can commit.

        Raises:
            InputError: the folder is not in a checkout.
            InfrastructureError: git fails.
        """
        if not directory.is_dir():
            raise InputError(f"{directory}: there is no such folder")
        if not os.access(directory, os.X_OK):
            raise InputError(f"{directory}: this folder cannot be entered: {os.strerror(errno.EACCES)}")
        folder = directory.resolve()
        root = next((each for each in (folder, *folder.parents) if os.path.lexists(each / ".git")), None)
        expected = f"{directory}: a folder in a git repository was expected (check it out before)"
        if root is None:
            raise InputError(f"{expected}: no folder above has .git")
        repository = cls(root)
        code, _, problem = repository._run_git("rev-parse", "--git-dir")
        if code:
            raise InputError(f"{expected}: {_quote_problem(problem)}")
        return replace(repository, disabled=tuple(repository._disabling_settings()))

    def _disabling_settings(self) -> Iterator[str]:
        """Yield settings that disable the programs of the repository's own settings, in any file that these include.

        Raises:
            InputError: the name of such a setting cannot be given to git.
            InfrastructureError: git fails.
        """
        code, output, problem = self._run_git("config", "--null", "--name-only", "--get-regexp", _PROGRAM_SETTINGS)
        if code not in (0, 1):  # 1: there is none
            raise InfrastructureError(f"git config: {_quote_problem(problem)}")
        for name in sorted(set(output.decode("utf-8", "surrogateescape").split("\0")) - {""}):
            if "=" in name:
                raise InputError(f"{self.root}: the setting '{one_line(name)}' of git has a = in its name: rename it")
            section, _, key = name.rpartition(".")
            if section.startswith("hook."):
                yield f"{section}.enabled=false"
            else:
                yield f"{name}={'false' if key == 'required' else ''}"

    def path(self, path: Path) -> str | None:
        """Return the path of a file or folder relative to the root, with ``/``; None outside of the repository."""
        whole = Path(os.path.realpath(path))
        return whole.relative_to(self.root).as_posix() if whole.is_relative_to(self.root) else None

    def tracked(self, exclude: Iterable[str] = ()) -> list[str]:
        """Return the tracked files that exist on disk, sorted, relative to the root with ``/``.

        Args:
            exclude: patterns of files and folders to omit, in git's syntax (``**/tests``).

        Raises:
            InfrastructureError: git fails.
        """
        left_out = [f":(exclude,top,glob){pattern}{below}" for pattern in exclude for below in ("", "/**")]
        entries = self._tracked_entries(*left_out)
        return sorted({path for path, mode in entries if mode in _REGULAR_FILE_MODES and (self.root / path).is_file()})

    def links(self) -> list[str]:
        """Return the tracked symbolic links and submodules, sorted, relative to the root with ``/``.

        Raises:
            InfrastructureError: git fails.
        """
        return sorted({path for path, mode in self._tracked_entries() if mode not in _REGULAR_FILE_MODES})

    def _tracked_entries(self, *patterns: str) -> Iterator[tuple[str, str]]:
        """Yield path and mode of everything that is tracked."""
        output = self._git_output("ls-files", "-s", "-z", "--", ":(top)", *patterns)
        for entry in output.decode("utf-8", "surrogateescape").split("\0"):
            mode, _, path = entry.partition("\t")
            if path:
                yield path, mode.split(" ")[0]

    def head(self) -> str | None:
        """Return the hash of the checked-out commit; None if the repository has no commit."""
        return self.commit("HEAD")

    def commit(self, name: str) -> str | None:
        """Return the hash of a commit given by any name; None if it does not exist."""
        code, output, _ = self._run_git("rev-parse", "--verify", "--quiet", "--end-of-options", f"{name}^{{commit}}")
        return None if code else output.decode("ascii").strip()

    def newest(self) -> Commit | None:
        """Return the checked-out commit; None if the repository has none."""
        code, output, _ = self._run_git("log", "--format=%H%x09%cs%x09%s", "--max-count=1", "--no-show-signature")
        return None if code else Commit(*output.decode("utf-8", "replace").rstrip("\n").split("\t", 2))

    def commit_time(self, commit: str) -> int | None:
        """Return when a commit was made, seconds since 1970; None if this checkout does not have it."""
        code, output, _ = self._run_git("log", "--format=%ct", "--max-count=1", "--no-show-signature", commit, "--")
        return None if code else int(output)

    def parents(self, commit: str) -> list[str]:
        """Return the hashes of a commit's parents, including those missing in a shallow checkout."""
        code, output, _ = self._run_git("cat-file", "commit", commit)
        header = output.partition(b"\n\n")[0].decode("utf-8", "replace")
        return [] if code else re.findall(r"^parent ([0-9a-f]+)$", header, re.MULTILINE)

    def merge_base(self, one: str, other: str) -> str | None:
        """Return the merge base of two commits; None if there is none, or a shallow checkout lacks it."""
        code, output, _ = self._run_git("merge-base", one, other)
        return None if code else output.decode("ascii").strip()

    def content(self, commit: str, path: str, most: int) -> bytes | None:
        """Return the content of a file in a commit; None if it does not exist there.

        Raises:
            InputError: it is not a regular file, or larger than ``most`` bytes.
            InfrastructureError: git fails.
        """
        code, output, _ = self._run_git("ls-tree", "-l", "-z", "--full-tree", commit, "--", path)
        if code or not output:
            return None
        mode, _, name, size = output.split(b"\t")[0].decode("ascii").split()
        if mode not in _REGULAR_FILE_MODES:
            raise InputError(f"{commit[:12]}:{path}: expected a regular file, found a link or a folder")
        if int(size) > most:
            raise InputError(f"{commit[:12]}:{path}: found {size} bytes, expected at most {most}")
        return self._git_output("cat-file", "blob", name)

    def contents(self, commits: Sequence[str], path: str, most: int) -> Iterator[tuple[str, bytes | None]]:
        """Yield a file's content in each commit; None if it is not a file or is larger than ``most`` bytes.

        The sizes are asked for first, and ``most`` bytes are read at once.

        Raises:
            InputError: the path has a line break.
            InfrastructureError: git fails.
        """
        if "\n" in path:
            raise InputError(f"{one_line(path)}: a path without line breaks was expected: rename it")
        facts = self._cat_files("--batch-check", [f"{commit}:{path}" for commit in commits]).split(b"\n")
        batch: list[tuple[str, str, int]] = []
        for commit, line in zip(commits, facts, strict=False):
            blob = _BLOB_LINE.fullmatch(line)
            name, size = (blob[1].decode(), int(blob[2])) if blob and int(blob[2]) <= most else ("", 0)
            if sum(each[2] for each in batch) + size > most:
                yield from self._read_blobs(batch)
                batch = []
            batch.append((commit, name, size))
        yield from self._read_blobs(batch)

    def _read_blobs(self, batch: Sequence[tuple[str, str, int]]) -> Iterator[tuple[str, bytes | None]]:
        """Yield the content for each commit, from the name and the size of its blob; None without a name."""
        output, at = self._cat_files("--batch", [name for _, name, _ in batch if name]), 0
        for commit, name, size in batch:
            if not name:
                yield commit, None
                continue
            begin = output.index(b"\n", at) + 1
            at = begin + size + 1
            yield commit, output[begin : begin + size]

    def _cat_files(self, option: str, names: Sequence[str]) -> bytes:
        """Return what ``git cat-file`` writes about objects."""
        given = "".join(f"{name}\n" for name in names).encode("utf-8", "surrogateescape")
        return self._git_output("cat-file", option, given=given)

    def origin(self) -> str | None:
        """Return the URL of the origin; None if there is none."""
        code, output, _ = self._run_git("config", "--get", "remote.origin.url")
        return None if code else one_line(output.decode("utf-8", "replace")) or None

    def fetched(self, commit: str) -> str:
        """Fetch one commit from the origin of a shallow checkout, by https or from a folder, and return its hash.

        Raises:
            InputError: it cannot be fetched.
        """
        missing = f"the commit {shorten(commit, 40)} is not in this checkout (fetch-depth: 2, GIT_DEPTH: 2 on GitLab)"
        missing += ", and cannot be"
        if self.origin() is None:  # git would take a folder of this name
            raise InputError(f"{missing} fetched: there is no remote 'origin'")
        options = ("--quiet", "--no-tags", "--no-recurse-submodules", "--upload-pack=git-upload-pack", "--depth=1")
        code, _, problem = self._run_git("fetch", *options, "origin", commit, variables=_FETCH_VARIABLES)
        found = None if code else self.commit(commit)
        if found is None:
            raise InputError(f"{missing} fetched: {_quote_problem(problem)}")
        return found

    def changes_of(self, path: str, since: str | None = None, newest: int | None = None) -> list[Commit]:
        """Return the first-parent commits up to HEAD that changed a file, the latest first.

        Args:
            path: file in the repository.
            since: date or commit after which the history starts.
            newest: maximum number of commits.

        Raises:
            InputError: there is no such commit.
            InfrastructureError: git fails.
        """
        arguments = ["log", "-z", "--format=%H%x09%cs%x09%s", "--first-parent", "--diff-merges=first-parent"]
        arguments.append("--no-show-signature")  # by a program that the settings name
        if newest is not None:
            arguments.append(f"--max-count={newest}")
        if since is not None:
            found = self.commit(since)
            arguments.append(f"{found}..HEAD" if found else f"--since={since}")
        code, output, problem = self._run_git(*arguments, "--", path)
        if code:
            if self.head() is None:
                return []
            raise InfrastructureError(f"git log: {_quote_problem(problem)}")
        rows = (entry.split("\t", 2) for entry in output.decode("utf-8", "replace").split("\0") if entry)
        return [Commit(*row) for row in rows]

    def difference(self, commit: str) -> bytes:
        """Return the changes of the working tree since a commit, as ``git diff`` without context.

        Raises:
            InfrastructureError: git fails.
        """
        return self._diff(commit, "--unified=0", "--no-color", "--find-renames", "--src-prefix=a/", "--dst-prefix=b/")

    def changed(self, commit: str) -> list[str]:
        """Return the files that differ between the working tree and a commit, sorted; both names of a renamed file.

        Raises:
            InfrastructureError: git fails.
        """
        output = self._diff(commit, "--name-only", "--no-renames", "-z")
        return sorted(filter(None, output.decode("utf-8", "surrogateescape").split("\0")))

    def _diff(self, commit: str, *options: str) -> bytes:
        """Return what ``git diff`` writes about the working tree and a commit; see `_run_git` for its fixed options."""
        return self._git_output("diff", *options, "--no-ext-diff", "--no-textconv", "--ignore-submodules", commit, "--")

    def _git_output(self, *arguments: str, given: bytes = b"") -> bytes:
        """Run git as `_run_git`, and return its output.

        Raises:
            InfrastructureError: git fails.
        """
        code, output, problem = self._run_git(*arguments, given=given)
        if code:
            raise InfrastructureError(f"git {arguments[0]}: {_quote_problem(problem)}")
        return output

    def _run_git(
        self, *arguments: str, given: bytes = b"", variables: Mapping[str, str] = MappingProxyType({})
    ) -> tuple[int, bytes, bytes]:
        """Run git in this checkout, and return exit code, output and errors: the only place where we run it.

        No program runs but git's own, whatever the repository's settings, hooks, attributes and submodules name; the
        user's and the machine's settings are not read. Two kinds are refused by the options of a command: ``diff``
        needs ``--no-ext-diff --no-textconv``, ``log`` needs ``--no-show-signature``. The network is used by https
        only, ``fetch`` also reads a folder.

        Args:
            arguments: command and its arguments.
            given: standard input.
            variables: environment in addition to `_SAFE_VARIABLES`.

        Raises:
            InfrastructureError: git cannot be started, or takes too long.
        """
        settings = [part for setting in (*_SAFE_SETTINGS, *self.disabled) for part in ("-c", setting)]
        place = [f"--git-dir={self.root / '.git'}", f"--work-tree={self.root}"]
        inherited = {name: value for name, value in os.environ.items() if not name.startswith("GIT_")}
        try:
            with subprocess.Popen(
                ["git", "--no-pager", "--no-optional-locks", *place, *settings, *arguments],
                cwd=self.root,
                env={**inherited, **_SAFE_VARIABLES, **variables},
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
            ) as process:
                _limit_memory(process.pid)
                try:
                    output, problem = process.communicate(given, COMMAND_SECONDS)
                except BaseException:
                    process.kill()
                    raise
        except subprocess.TimeoutExpired:
            raise InfrastructureError(f"git {arguments[0]} took longer than {COMMAND_SECONDS} s") from None
        except OSError as error:
            raise InfrastructureError(f"git cannot be started: {error.strerror}") from None
        return process.returncode, output, problem


def _limit_memory(process: int) -> None:
    """Limit the memory of a process to `MAX_MEMORY_BYTES`, on Linux; files that it maps do not count."""
    if sys.platform == "linux":
        with suppress(ProcessLookupError):
            resource.prlimit(process, resource.RLIMIT_DATA, (MAX_MEMORY_BYTES, MAX_MEMORY_BYTES))


def _quote_problem(problem: bytes) -> str:
    return shorten(one_line(problem.decode("utf-8", "replace")).removeprefix("fatal: ") or "no reason given", 200)


_HUNK_HEADER = re.compile(rb"@@ -[0-9]{1,12}(?:,([0-9]{1,12}))? \+([0-9]{1,12})(?:,([0-9]{1,12}))? @@")
_BINARY_FILES = re.compile(rb'Binary files .* and ("?b/.*) differ')
_ESCAPED_CHARACTER = re.compile(rb"\\([0-7]{3}|.)")
_CHARACTER_OF_LETTER = {b"a": b"\a", b"b": b"\b", b"f": b"\f", b"n": b"\n", b"r": b"\r", b"t": b"\t", b"v": b"\v"}


def changed_lines(difference: bytes) -> dict[str, set[int]]:
    """Return the numbers of the added or altered lines of each file, by its path.

    Args:
        difference: output of git without context, with the prefixes ``a/`` and ``b/``.
    """
    found: dict[str, set[int]] = {}
    file: str | None = None
    skip = number = 0  # remaining lines of a hunk, whose content must not be parsed as headers; the next line's number
    for line in difference.split(b"\n"):
        if skip and not line.startswith(b"\\"):  # "\ No newline at end of file" is not a line
            skip -= 1
            if line.startswith(b"+") and file is not None:  # counted, as a hunk may claim any number
                found[file].add(number)
                number += 1
        elif line.startswith(b"+++ "):
            file = _new_path(line[4:])
        elif (hunk := _HUNK_HEADER.match(line)) is not None:
            number = int(hunk[2])
            skip = int(hunk[1] or 1) + int(hunk[3] or 1)
            if file is not None:
                found.setdefault(file, set())
    return found


def files_without_lines(difference: bytes) -> set[str]:
    """Return the changed files of which git tells no lines: those that .gitattributes calls binary, or large ones.

    Args:
        difference: output of git, with the prefixes ``a/`` and ``b/``.
    """
    names = (each[1] for line in difference.split(b"\n") if (each := _BINARY_FILES.fullmatch(line)) is not None)
    return {path for path in map(_new_path, names) if path is not None}


def find_base(repository: Repository, named: str | None, candidates: Iterable[str]) -> str:
    """Return the merge base of HEAD and the target of a change.

    Args:
        repository: the checkout.
        named: commit given by the user; None to use the first existing candidate.
        candidates: commits suggested by the event, in order of preference.

    Raises:
        InputError: there is nothing to compare with, or this checkout lacks it.
    """
    names = [named] if named is not None else list(candidates)
    if not names:
        raise InputError("there is no base to compare with: set base, for example to origin/main")
    # after a forced push the best candidate may no longer exist
    commit = next(filter(None, map(repository.commit, names)), None)
    base = None if commit is None else repository.merge_base(commit, "HEAD")
    if base is None:
        found = "no such commit is" if commit is None else "no common ancestor with HEAD is"
        history = "check out the history too (fetch-depth: 0, GIT_DEPTH: 0 on GitLab)"
        raise InputError(f"base {names[0]}: {found} in this checkout: {history}")
    return base


def _new_path(text: bytes) -> str | None:
    """Return the path in a ``+++`` line; None for a deleted file."""
    text = text.removesuffix(b"\t")  # git appends a tab to a path with a space
    if text.startswith(b'"') and text.endswith(b'"'):
        text = _ESCAPED_CHARACTER.sub(_unescape_match, text[1:-1])
    return text[2:].decode("utf-8", "surrogateescape") if text.startswith(b"b/") else None


def _unescape_match(match: re.Match[bytes]) -> bytes:
    escaped = match[1]
    return bytes([int(escaped, 8)]) if len(escaped) == 3 else _CHARACTER_OF_LETTER.get(escaped, escaped)
