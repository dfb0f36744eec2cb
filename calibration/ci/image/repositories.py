"""Reading of ``.repos`` and ``.rosinstall`` files, which list git repositories; checks and quotes of users' texts."""

import json
import re
import unicodedata
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any
from urllib.parse import urlsplit

from calibration.base import InputError, read_yaml, shorten

_PACKAGE_NAME = re.compile(r"[a-z0-9][a-z0-9+.-]*(:[a-z0-9]+)?(=[A-Za-z0-9.+~:-]+)?(/[a-z0-9-]+)?")


def check_text(text: str, where: str) -> str:
    """Return a text if it is safe for a shell: lines without control characters.

    Raises:
        InputError: it has control characters or lone surrogates.
    """
    for character in text:
        if unicodedata.category(character) in ("Cc", "Cs") and character not in "\n\t":
            name = f"U+{ord(character):04X}"
            raise InputError(f"{where}: found the control character {name} in {shorten(text)!r}: leave it out")
    return text


def check_line(text: str, where: str) -> str:
    """Return a text if it is a single line.

    Raises:
        InputError: it has several lines, or control characters.
    """
    if "\n" in text:
        raise InputError(f"{where}: found more than one line in {shorten(text)!r}, one was expected")
    return check_text(text, where)


def package_name(text: str, where: str) -> str:
    """Return the name of a Debian package, optionally with a version, if it is valid.

    Raises:
        InputError: it is invalid.
    """
    if not _PACKAGE_NAME.fullmatch(text):
        raise InputError(
            f"{where}: found {shorten(text)!r}, the name of a Debian package was expected (name, name=1.2)"
        )
    return text


def quoted(text: str) -> str:
    """Quote a value of ENV or LABEL so that the builder reads it literally."""
    return '"' + re.sub(r'(["\\$])', r"\\\1", text) + '"'


def json_words(*words: str) -> str:
    """Return words in the JSON form of an instruction, on one line.

    ``<`` is escaped, because newer builders take ``<<`` for a here-document.
    """
    return json.dumps(list(words), ensure_ascii=False).replace("<", "\\u003c")


def path_words(*paths: str) -> str:
    """Return paths of COPY and WORKDIR in JSON form, escaped against the builder's variables and quotes."""
    return json_words(*(re.sub(r"""(["'\\$])""", r"\\\1", path) for path in paths))


_SCP_FORM = re.compile(r"[A-Za-z0-9_.-]+@[A-Za-z0-9.-]+:(?!:).+")
"""git@github.com:team/robot.git"""
_VERSION_NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_./+@-]*")


@dataclass(frozen=True)
class Repository:
    """A git repository to clone."""

    path: str
    """Path relative to the workspace's sources."""
    url: str
    version: str | None = None
    """Commit, tag or branch; None for the default branch."""

    @property
    def by_ssh(self) -> bool:
        """Whether it is cloned over SSH."""
        return urlsplit(self.url).scheme == "ssh" if "://" in self.url else True

    @property
    def pinned(self) -> bool:
        """Whether the version is the hash of a commit."""
        return re.fullmatch(r"[0-9a-f]{40}", self.version or "") is not None


def read_repositories(path: Path) -> tuple[Repository, ...]:
    """Read a file in the format of vcs (``repositories: {path: {type, url, version}}``) or rosinstall.

    Raises:
        InputError: the file does not exist, has another format, or a repository is not of git, has a
            password in its URL, or would be cloned outside of the workspace; the message names it.
    """
    document = read_yaml(path, "a .repos or .rosinstall file")
    if isinstance(document, Mapping) and isinstance(document.get("repositories"), Mapping):
        entries = _of_repos(document["repositories"], path)
    elif isinstance(document, list):
        entries = _of_rosinstall(document, path)
    else:
        raise InputError(f"{path}: found neither the key 'repositories' (.repos) nor a list (.rosinstall)")
    repositories = tuple(_check_repository(*entry, where=str(path)) for entry in entries)
    paths = [repository.path for repository in repositories]
    for name in paths:
        if paths.count(name) > 1:
            raise InputError(f"{path}: two repositories are cloned to {name}")
    return repositories


def _of_repos(entries: Mapping[Any, Any], path: Path) -> Iterator[tuple[object, object, object, object]]:
    for name, entry in entries.items():
        if not isinstance(entry, Mapping):
            raise InputError(f"{path}: {name}: found {shorten(repr(entry))}, expected type, url and version")
        yield name, entry.get("type"), entry.get("url"), entry.get("version")


def _of_rosinstall(entries: list[Any], path: Path) -> Iterator[tuple[object, object, object, object]]:
    for number, item in enumerate(entries, start=1):
        if not isinstance(item, Mapping) or len(item) != 1 or not isinstance(next(iter(item.values())), Mapping):
            raise InputError(f"{path}: entry {number}: found {shorten(repr(item))}, expected git: {{local-name, uri}}")
        ((kind, entry),) = item.items()
        yield entry.get("local-name"), kind, entry.get("uri"), entry.get("version")


def _check_repository(name: object, kind: object, url: object, version: object, *, where: str) -> Repository:
    where = f"{where}: {name}"
    if kind != "git":
        raise InputError(f"{where}: found the type {kind!r}, only git is cloned: get the others with commands")
    if not isinstance(name, str) or not _stays_inside(name):
        raise InputError(f"{where}: found the folder {name!r}, a path inside the workspace was expected")
    if not isinstance(url, str) or not _is_address(url):
        raise InputError(
            f"{where}: found the address {_without_password(url)!r}, expected https://, ssh:// or git@host:"
        )
    if "://" in url and urlsplit(url).password is not None:
        raise InputError(f"{where}: the address has a password in it: use secrets with a host, or ssh")
    if version is not None and (type(version) not in (str, int) or not _VERSION_NAME.fullmatch(str(version))):
        raise InputError(f"{where}: found the version {version!r}, a commit, tag or branch was expected, as a text")
    path = str(PurePosixPath(check_line(name, where)))
    return Repository(path, check_line(url, where), None if version is None else str(version))


def _stays_inside(name: str) -> bool:
    path = PurePosixPath(name)
    return not path.is_absolute() and ".." not in path.parts and bool(path.parts)


def _is_address(url: str) -> bool:
    try:
        parts = urlsplit(url)
        host, _ = parts.hostname, parts.port
    except ValueError:
        return False
    return bool(host) if parts.scheme in ("https", "http", "ssh") else _SCP_FORM.fullmatch(url) is not None


def _without_password(url: object) -> str:
    return re.sub(r"//[^@/]*@", "//***@", shorten(str(url)))
