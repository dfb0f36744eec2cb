"""The git repository whose coverage it is: which files it tracks, its commits, what a change touched."""

import os
import re
import subprocess
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Self

from calibration.errors import InfrastructureError, InputError
from calibration.workflow.text import one_line, shorten

SECONDS = 120
"""That one command of git may take."""
_SETTINGS = ("core.fsmonitor=false", "core.quotePath=true")
_CONFIGURATION = Path(__file__).with_name("git.config")
_REGULAR = ("100644", "100755")
"""Modes of files; neither links, which may point anywhere, nor submodules."""
_COMMIT = re.compile(r"[0-9a-f]{40}|[0-9a-f]{64}")


def is_commit(text: str) -> bool:
    """Whether it is the whole hash of a commit."""
    return _COMMIT.fullmatch(text) is not None


@dataclass(frozen=True)
class Commit:
    """A commit in a history."""

    hash: str
    date: str
    """YYYY-MM-DD."""
    subject: str

    def __str__(self) -> str:
        return f"{self.date} ({self.hash[:7]})"


@dataclass(frozen=True)
class Repository:
    """A checkout."""

    root: Path
    """Without links in its path."""

    @classmethod
    def around(cls, directory: Path) -> Self:
        """The checkout that a folder lies in.

        Raises:
            InputError: there is none.
        """
        code, output, problem = _git(directory, "rev-parse", "--show-toplevel")
        if code:
            raise InputError(
                f"{directory}: a folder in a git repository was expected (check it out before): {_said(problem)}"
            )
        return cls(Path(output.decode("utf-8", "surrogateescape").rstrip("\n")).resolve())

    def path(self, path: Path) -> str | None:
        """A file's or a folder's path in the repository, with ``/``; None outside of it."""
        whole = Path(os.path.realpath(path))
        return whole.relative_to(self.root).as_posix() if whole.is_relative_to(self.root) else None

    def tracked(self, exclude: Iterable[str] = ()) -> list[str]:
        """The tracked files that are on the disk, relative to the root and with ``/``, in order.

        Args:
            exclude: patterns of files and folders that are left out, as git has them (``**/tests``).

        Raises:
            InfrastructureError: git fails.
        """
        left_out = [f":(exclude,top,glob){pattern}{below}" for pattern in exclude for below in ("", "/**")]
        code, output, problem = _git(self.root, "ls-files", "-s", "-z", "--", ":(top)", *left_out)
        if code:
            raise InfrastructureError(f"git ls-files: {_said(problem)}")
        files = set()
        for entry in output.decode("utf-8", "surrogateescape").split("\0"):
            mode, _, path = entry.partition("\t")
            if path and mode.split(" ")[0] in _REGULAR and (self.root / path).is_file():
                files.add(path)
        return sorted(files)

    def head(self) -> str | None:
        """The commit that is checked out; None where there is none yet."""
        return self.commit("HEAD")

    def commit(self, name: str) -> str | None:
        """The hash of a commit, by any name for it; None where it is not there."""
        code, output, _ = _git(self.root, "rev-parse", "--verify", "--quiet", "--end-of-options", f"{name}^{{commit}}")
        return None if code else output.decode("ascii").strip()

    def parents(self, commit: str) -> list[str]:
        """The hashes of a commit's parents, those too that a shallow checkout does not have."""
        code, output, _ = _git(self.root, "cat-file", "commit", commit)
        header = output.partition(b"\n\n")[0].decode("utf-8", "replace")
        return [] if code else re.findall(r"^parent ([0-9a-f]+)$", header, re.MULTILINE)

    def merge_base(self, one: str, other: str) -> str | None:
        """The last commit that two have in common; None where there is none, or a shallow checkout lacks it."""
        code, output, _ = _git(self.root, "merge-base", one, other)
        return None if code else output.decode("ascii").strip()

    def content(self, commit: str, path: str, most: int) -> bytes | None:
        """What a file holds in a commit; None where it is not there.

        Raises:
            InputError: it is no regular file there, or is larger than ``most`` bytes.
            InfrastructureError: git fails.
        """
        code, output, _ = _git(self.root, "ls-tree", "-l", "-z", "--full-tree", commit, "--", path)
        if code or not output:
            return None
        mode, _, name, size = output.split(b"\t")[0].decode("ascii").split()
        if mode not in _REGULAR:
            raise InputError(f"{commit[:12]}:{path}: expected a regular file, found a link or a folder")
        if int(size) > most:
            raise InputError(f"{commit[:12]}:{path}: found {size} bytes, expected at most {most}")
        code, output, problem = _git(self.root, "cat-file", "blob", name)
        if code:
            raise InfrastructureError(f"git cat-file: {_said(problem)}")
        return output

    def contents(self, commits: Sequence[str], path: str, most: int) -> Iterator[tuple[str, bytes | None]]:
        """What a file held in each of many commits, by one process; None where it is no file, or is too large.

        Raises:
            InfrastructureError: git fails.
        """
        asked = "".join(f"{commit}:{path}\n" for commit in commits).encode("utf-8", "surrogateescape")
        code, output, problem = _git(self.root, "cat-file", "--batch", given=asked)
        if code:
            raise InfrastructureError(f"git cat-file: {_said(problem)}")
        at = 0
        for commit in commits:
            end = output.index(b"\n", at)
            head = output[at:end].split(b" ")
            at = end + 1
            if len(head) != 3 or head[1] not in (b"blob", b"tree", b"commit", b"tag"):
                yield commit, None  # "... missing"
                continue
            size = int(head[2])
            yield commit, output[at : at + size] if head[1] == b"blob" and size <= most else None
            at += size + 1

    def fetched(self, commit: str) -> str:
        """Bring one commit from where a shallow checkout came from, and return its hash.

        Raises:
            InputError: it cannot be brought.
        """
        code, _, problem = _git(self.root, "fetch", "--quiet", "--no-tags", "--depth=1", "origin", commit)
        found = None if code else self.commit(commit)
        if found is None:
            raise InputError(
                f"the commit {shorten(commit, 40)} is not in this checkout (fetch-depth: 2 brings it), and cannot be "
                f"fetched: {_said(problem)}"
            )
        return found

    def changes_of(self, path: str, since: str | None = None, newest: int | None = None) -> list[Commit]:
        """The commits on the way to HEAD that changed a file, the latest first.

        Args:
            path: of the file in the repository.
            since: a date or a commit that they come after.
            newest: at most so many.

        Raises:
            InputError: there is no such commit.
            InfrastructureError: git fails.
        """
        arguments = ["log", "-z", "--format=%H%x09%cs%x09%s", "--first-parent", "--diff-merges=first-parent"]
        if newest is not None:
            arguments.append(f"--max-count={newest}")
        if since is not None:
            found = self.commit(since)
            arguments.append(f"{found}..HEAD" if found else f"--since={since}")
        code, output, problem = _git(self.root, *arguments, "--", path)
        if code:
            if self.head() is None:
                return []
            raise InfrastructureError(f"git log: {_said(problem)}")
        rows = (entry.split("\t", 2) for entry in output.decode("utf-8", "replace").split("\0") if entry)
        return [Commit(*row) for row in rows]

    def difference(self, commit: str) -> bytes:
        """What the files on the disk have and the commit has not, as ``git diff`` without context.

        Raises:
            InfrastructureError: git fails.
        """
        code, output, problem = _git(
            self.root,
            *("diff", "--unified=0", "--no-color", "--no-ext-diff", "--no-textconv", "--find-renames"),
            *("--src-prefix=a/", "--dst-prefix=b/", "--ignore-submodules", commit, "--"),
        )
        if code:
            raise InfrastructureError(f"git diff {commit}: {_said(problem)}")
        return output

    def changed(self, commit: str) -> list[str]:
        """The files that the disk and a commit do not have alike, in order; both names of one that was renamed.

        Raises:
            InfrastructureError: git fails.
        """
        code, output, problem = _git(
            self.root, "diff", "--name-only", "--no-renames", "--no-ext-diff", "-z", "--ignore-submodules", commit, "--"
        )
        if code:
            raise InfrastructureError(f"git diff {commit}: {_said(problem)}")
        return sorted(filter(None, output.decode("utf-8", "surrogateescape").split("\0")))


def _git(directory: Path, *arguments: str, given: bytes = b"") -> tuple[int, bytes, bytes]:
    """Run git; its exit code, output and errors. Nothing is started that a configuration may ask it to start."""
    settings = [part for setting in _SETTINGS for part in ("-c", setting)]
    variables = {name: value for name, value in os.environ.items() if not name.startswith("GIT_")}
    variables |= {"GIT_CONFIG_GLOBAL": str(_CONFIGURATION), "GIT_CONFIG_NOSYSTEM": "1", "LC_ALL": "C"}
    try:
        done = subprocess.run(
            ["git", "--no-optional-locks", *settings, *arguments],
            cwd=directory,
            env=variables,
            input=given,
            capture_output=True,
            timeout=SECONDS,
            check=False,
        )
    except subprocess.TimeoutExpired:
        raise InfrastructureError(f"git {arguments[0]} took longer than {SECONDS} s") from None
    except OSError as error:
        if not directory.is_dir():
            raise InputError(f"{directory}: there is no such folder") from None
        if not os.access(directory, os.X_OK):
            raise InputError(f"{directory}: this folder cannot be entered: {error.strerror}") from None
        raise InfrastructureError(f"git cannot be started: {error.strerror}") from None
    return done.returncode, done.stdout, done.stderr


def _said(problem: bytes) -> str:
    return shorten(one_line(problem.decode("utf-8", "replace")).removeprefix("fatal: ") or "no reason given", 200)
