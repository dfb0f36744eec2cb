"""Build context as a tar archive, whose bytes depend only on the content of the files; hash of all input of a build."""

import hashlib
import json
import os
import stat
import tarfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from io import BufferedReader, BytesIO
from pathlib import Path, PurePosixPath
from typing import IO
from urllib.parse import urlsplit, urlunsplit

from docker.utils.build import Pattern

from calibration.base import CalibrationError, InfrastructureError, InputError, read_bytes, write_atomically, writing
from calibration.ci.git import Repository
from calibration.ci.services import service_of

MAX_BYTES = 2 * 1024**3
"""Limit of the size, because the context is hashed on every push and sent to the engine for every build."""
MAX_FILES = 100_000
FILE_TIME = 315_619_200
"""1980-01-02: modification time of every file, for reproducible bytes. Zip files, such as wheels, allow no earlier."""
NO_SOURCES = ("**/.git", "**/.hg", "**/.svn", "**/__pycache__")
"""Excluded from sources by default."""
_MAX_IGNORE_BYTES = 1024 * 1024


@dataclass(frozen=True)
class Entry:
    """A file, folder or symbolic link of the context."""

    mode: int
    """644 or 755, as in git."""
    size: int = 0
    source: Path | None = None
    """Path of the file with the content; None if `content` has it."""
    content: bytes | None = None
    """Content of a generated file."""
    link: str | None = None
    """Target of a symbolic link."""

    @property
    def is_folder(self) -> bool:
        """Whether it is a folder."""
        return self.source is None and self.content is None and self.link is None


class Ignored:
    """Set of paths that are excluded by patterns of a ``.dockerignore``."""

    def __init__(self, patterns: Iterable[str] = ()) -> None:
        self._rules = [rule for rule in map(Pattern, patterns) if rule.dirs]
        self.has_exceptions = any(rule.exclusion for rule in self._rules)
        """Whether an excluded folder may contain included files."""

    def __contains__(self, path: str) -> bool:
        """Whether a path is excluded, by the last rule that matches it or one of its parents."""
        parts = path.split("/")
        paths = ["/".join(parts[:count]) for count in range(1, len(parts) + 1)]
        for rule in reversed(self._rules):
            if any(rule.match(part) for part in paths):
                return not rule.exclusion
        return False


class Context:
    """Files by their path in the context, which the Dockerfile copies."""

    def __init__(self, leave_out: Iterable[Path] = (), max_bytes: int = MAX_BYTES, max_files: int = MAX_FILES) -> None:
        """Create an empty context.

        Args:
            leave_out: folders that are always excluded, such as the folder for results.
            max_bytes: limit of the size of all files.
            max_files: limit of the number of files, folders and links.
        """
        self.entries: dict[str, Entry] = {}
        self._leave_out = frozenset(folder.resolve() for folder in leave_out)
        self._max_bytes = max_bytes
        self._max_files = max_files
        self._bytes = 0

    def add_bytes(self, path: str, content: bytes, *, executable: bool = False) -> None:
        """Add a generated file."""
        self._put_entry(path, Entry(0o755 if executable else 0o644, len(content), content=content))

    def add_file(self, path: str, source: Path, what: str) -> None:
        """Add a file; ``what`` describes its purpose in messages ("files: robot.yml").

        Raises:
            InputError: the file does not exist, or the context gets too large.
        """
        status = _status_of(source, what)
        if not stat.S_ISREG(status.st_mode):
            raise InputError(f"{what}: {source} is no regular file")
        self._put_entry(path, _file_entry(source, status))

    def add_folder(
        self, path: str, source: Path, what: str, ignored: Ignored, only: frozenset[str] | None = None
    ) -> None:
        """Add a folder with its content, except for ignored paths.

        Args:
            path: path in the context; empty for the root of the context.
            source: the folder.
            what: its purpose, for messages.
            ignored: excluded paths of the folder.
            only: names of the files to add; None for all.

        Raises:
            InputError: the folder does not exist; a link points out of it; it contains something that is neither
                file, folder nor link, or is not readable; or the context gets too large.
        """
        if not stat.S_ISDIR(_status_of(source, what).st_mode):
            raise InputError(f"{what}: {source} is no folder")
        if path:
            self._put_entry(path, Entry(0o755))
        for name, found in _walk_folder(source.resolve(), ignored, self._leave_out, what):
            status = _status_of(found, what, follow=False)
            if only is not None and not (stat.S_ISREG(status.st_mode) and found.name in only):
                continue
            place = f"{path}/{name}" if path else name
            if stat.S_ISLNK(status.st_mode):
                self._put_entry(place, Entry(0o777, link=_read_link(found, name, what)))
            elif stat.S_ISDIR(status.st_mode):
                self._put_entry(place, Entry(0o755))
            elif stat.S_ISREG(status.st_mode):
                self._put_entry(place, _file_entry(found, status))
            else:
                raise InputError(f"{what}: {found} is neither file, folder nor link: leave it out with a .dockerignore")

    def digests(self) -> Iterator[tuple[str, int, str]]:
        """Yield path, mode and a digest of the content of every entry, sorted by path.

        Raises:
            InfrastructureError: a file cannot be read.
        """
        for path, entry in sorted(self.entries.items()):
            if entry.link is not None:
                yield path, entry.mode, f"link:{entry.link}"
            elif entry.is_folder:
                yield path, entry.mode, "folder"
            else:
                with _open_content(path, entry) as file:
                    yield path, entry.mode, hashlib.file_digest(file, "sha256").hexdigest()

    def write_tar(self, target: IO[bytes]) -> None:
        """Write the context as a tar archive.

        Raises:
            InfrastructureError: a file cannot be read, or has changed meanwhile.
        """
        with tarfile.open(fileobj=target, mode="w", format=tarfile.GNU_FORMAT, errors="surrogateescape") as archive:
            for path, entry in sorted(self.entries.items()):
                info = tarfile.TarInfo(path)
                info.mode, info.mtime = entry.mode, FILE_TIME
                if entry.link is not None:
                    info.type, info.linkname = tarfile.SYMTYPE, entry.link
                    archive.addfile(info)
                elif entry.is_folder:
                    info.type = tarfile.DIRTYPE
                    archive.addfile(info)
                else:
                    info.size = entry.size
                    with _open_content(path, entry) as file:
                        _add_to_archive(archive, info, file)

    def write_folder(self, folder: Path) -> None:
        """Write the context as a folder for ``docker build``.

        Raises:
            InputError: the folder is not empty.
            InfrastructureError: it cannot be written.
        """
        if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
            raise InputError(f"{folder}: an empty folder was expected: existing files would be mixed with the context")
        with writing(folder, "the context"):
            folder.mkdir(parents=True, exist_ok=True)
            for path, entry in sorted(self.entries.items()):
                target = folder / path
                target.parent.mkdir(parents=True, exist_ok=True)
                if entry.link is not None:
                    target.symlink_to(entry.link)
                elif entry.is_folder:
                    target.mkdir(exist_ok=True)
                else:
                    with _open_content(path, entry) as file:
                        write_atomically(target, file.read())
                    target.chmod(entry.mode)

    def _put_entry(self, path: str, entry: Entry) -> None:
        self.entries[path] = entry
        self._bytes += entry.size
        if self._bytes > self._max_bytes:
            raise InputError(
                f"the build context is larger than {self._max_bytes / 1e6:.0f} MB; the largest: "
                f"{self._describe_largest()}: leave out what the image does not need, with a .dockerignore"
            )
        if len(self.entries) > self._max_files:
            raise InputError(
                f"the build context has more than {self._max_files} files (the last is {path}): "
                "leave out what the image does not need, with a .dockerignore"
            )

    def _describe_largest(self) -> str:
        largest = sorted(self.entries.items(), key=lambda item: -item[1].size)[:3]
        return ", ".join(f"{entry.source or path} ({entry.size / 1e6:.0f} MB)" for path, entry in largest)


def read_ignore_file(path: Path) -> list[str]:
    """Read the patterns of a ``.dockerignore``; empty if the file does not exist.

    Raises:
        InputError: it cannot be read, or is not a text.
    """
    if not path.exists():
        return []
    try:
        lines = read_bytes(path, _MAX_IGNORE_BYTES, "a .dockerignore").decode("utf-8-sig").splitlines()
    except UnicodeDecodeError:
        raise InputError(f"{path}: this is no text in UTF-8") from None
    return [line.strip() for line in lines if line.strip() and not line.startswith("#")]


def _walk_folder(root: Path, ignored: Ignored, leave_out: frozenset[Path], what: str) -> Iterator[tuple[str, Path]]:
    """Yield the relative and full paths of a folder's content that is not ignored; links are not followed."""
    folders = [""]
    while folders:
        folder = folders.pop()
        try:
            with os.scandir(root / folder) as found:
                inside = sorted(found, key=lambda item: item.name)
        except OSError as error:
            raise InputError(f"{what}: {root / folder} cannot be read: {error.strerror}") from None
        for item in inside:
            name = f"{folder}/{item.name}" if folder else item.name
            if root / name in leave_out:
                continue
            left_out = name in ignored
            if not left_out:
                yield name, Path(item.path)
            if item.is_dir(follow_symlinks=False) and (not left_out or ignored.has_exceptions):
                folders.append(name)


def _read_link(path: Path, name: str, what: str) -> str:
    target = os.readlink(path)  # noqa: PTH115 (a Path would tidy what stands there)
    place = os.path.normpath(PurePosixPath(name).parent / target)
    if target.startswith("/") or place == ".." or place.startswith("../"):
        raise InputError(f"{what}: the link {path} points to {target}, which is outside: leave it out (.dockerignore)")
    return target


def _file_entry(source: Path, status: os.stat_result) -> Entry:
    return Entry(0o755 if status.st_mode & 0o111 else 0o644, status.st_size, source=source)


def _status_of(path: Path, what: str, *, follow: bool = True) -> os.stat_result:
    try:
        return path.stat(follow_symlinks=follow)
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) and error.strerror else error
        raise InputError(f"{what}: {path} cannot be read: {reason}") from None


def _open_content(path: str, entry: Entry) -> BytesIO | BufferedReader:
    if entry.source is None:
        return BytesIO(entry.content or b"")
    try:
        return entry.source.open("rb")
    except OSError as error:
        raise InfrastructureError(f"{entry.source}: cannot be read for the build ({path}): {error.strerror}") from error


def _add_to_archive(archive: tarfile.TarFile, info: tarfile.TarInfo, file: IO[bytes]) -> None:
    with writing(info.name, "the build context"):  # also raised by tarfile for a file that was truncated meanwhile
        archive.addfile(info, file)


KEY_VERSION = 1
"""Version of the hashed format; images of older versions are not found."""
TAG_DIGITS = 24
"""Number of hexadecimal digits of the key in a tag: 96 bits."""
KEY_LABEL = "ci.calibration.key"
SPECIFICATION_LABEL = "ci.calibration.specification"


def content_key(
    context: Context,
    dockerfile: str,
    bases: Mapping[str, str],
    platforms: Sequence[str],
    build_arguments: Mapping[str, str],
    target: str | None,
    labels: Mapping[str, str],
    *,
    attested: bool = False,
) -> str:
    """Return the hash of all input of an image, without times, tags and the commit.

    Args:
        context: files of the build, hashed by path, mode and content, including the Dockerfile.
        dockerfile: path of the Dockerfile in the context.
        bases: current digest or id of each base, by name.
        platforms: platforms to build for.
        build_arguments: values of ARG.
        target: stage to build; None for the last one.
        labels: labels of the user.
        attested: whether it is attested: one that is not is another image.

    Raises:
        InfrastructureError: a file cannot be read.
    """
    parts = {
        "form": KEY_VERSION,
        "dockerfile": dockerfile,
        "bases": dict(bases),
        "platforms": list(platforms),
        "arguments": dict(build_arguments),
        "target": target,
        "labels": dict(labels),
        "files": list(context.digests()),
        **({"attested": True} if attested else {}),
    }
    return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()


def key_tag(key: str) -> str:
    """Return the tag that identifies the image of a key."""
    return f"key-{key[:TAG_DIGITS]}"


SOURCE_LABEL = "org.opencontainers.image.source"
REVISION_LABEL = "org.opencontainers.image.revision"


def build_labels(
    key: str, specification: str, user: Mapping[str, str], folder: Path, environment: Mapping[str, str] | None = None
) -> dict[str, str]:
    """Return the labels of an image that is built now: the user's, the keys, and the commit if it is known.

    An image that is found later, unchanged, keeps the commit of its build. There is no date, because
    images have a date of creation.
    """
    variables = os.environ if environment is None else environment
    source, revision = service_of(variables).origin(variables)
    if not (source and revision):
        with suppress(CalibrationError):  # no git, or no checkout
            checkout = Repository.around(folder)
            source = source or checkout.origin() or ""
            revision = revision or checkout.head() or ""
    found = {SOURCE_LABEL: _without_login(source), REVISION_LABEL: revision}
    ours = {KEY_LABEL: key, SPECIFICATION_LABEL: specification}
    return {name: value for name, value in found.items() if value} | dict(user) | ours


def _without_login(url: str) -> str:
    """Remove user and password from a URL."""
    try:
        parts = urlsplit(url)
        if "@" not in parts.netloc:
            return url
        return urlunsplit(parts._replace(netloc=parts.netloc.rpartition("@")[2]))
    except ValueError:
        return ""
