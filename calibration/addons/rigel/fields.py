"""Parts of a Rigelfile: the notes of what is not converted, the references in texts, and typed access to fields.

Rigel reads undeclared variables (``{{ vars.x }}``, the older ``{{ x }}``) from the environment, and data
(``{{ data.x }}``) from the matrix at run time. Here a declared variable is replaced by its value; for the others a
mark remains in the text, which :func:`plain`, :func:`shell` and :func:`argument` write as each context requires.

Secrets are not copied: they are replaced by the name of an environment variable.
"""

import enum
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

from calibration.base import InputError, one_line, shorten

MARKED_TEXT = re.compile("\ue000[VSD]([^\ue001]*)\ue001")
"""Mark of a variable or of data in a text that is not written yet: see `substitution`."""


class NoteKind(enum.StrEnum):
    """Outcome for a part of the Rigelfile."""

    LOST = "not carried over"
    CHANGED = "works otherwise here"
    TO_DO = "to do"


@dataclass(frozen=True)
class Note:
    """Note for the user about one part of the Rigelfile."""

    kind: NoteKind
    where: str
    """Position in the Rigelfile: ``jobs.build.with.load``."""
    text: str

    def __str__(self) -> str:
        return f"{self.where}: {self.text}"


@dataclass
class Notes:
    """Notes of a conversion, without duplicates."""

    found: list[Note] = field(default_factory=list)

    def __iter__(self) -> Iterator[Note]:
        return iter(self.found)

    def lost(self, where: str, why: str) -> None:
        """Note a setting that cannot be converted."""
        self._add_note(NoteKind.LOST, where, why)

    def changed(self, where: str, how: str) -> None:
        """Note a setting that is converted with a different meaning."""
        self._add_note(NoteKind.CHANGED, where, how)

    def to_do(self, where: str, what: str) -> None:
        """Note a setting that the user has to add, because the Rigelfile does not contain it."""
        self._add_note(NoteKind.TO_DO, where, what)

    def _add_note(self, kind: NoteKind, where: str, text: str) -> None:
        where, text = (MARKED_TEXT.sub(r"${\1}", part) for part in (where.removeprefix("."), text))
        note = Note(kind, shorten(one_line(where), 160), shorten(one_line(text), 400))
        if note not in self.found:
            self.found.append(note)


_SECRET_NAME = re.compile(
    r"passw(or)?d|passphrase|secret|token|credential|private_?key|access_?key|api_?key|ssh_?key|deploy_?key"
    r"|(^|_)(key|auth|pwd)$",
    re.IGNORECASE,
)
_SECRET_VALUES = (
    re.compile(r"-----BEGIN [A-Z ]*PRIVATE KEY-----.*?(?:-----END [A-Z ]*PRIVATE KEY-----|\Z)", re.DOTALL),
    re.compile(r"\b(?:AKIA|ASIA)[0-9A-Z]{16}\b"),
    re.compile(r"\bgh[pousr]_[A-Za-z0-9]{20,}\b|\bgithub_pat_[A-Za-z0-9_]{20,}\b|\bglpat-[A-Za-z0-9_-]{20,}"),
    re.compile(r"\bdckr_pat_[A-Za-z0-9_-]{20,}|\bxox[abprs]-[A-Za-z0-9-]{10,}"),
    re.compile(r"(?<=://)[^\s/@:]*:[^\s/@{}$]+(?=@)"),  # https://user:password@host
)


def names_a_secret(name: str) -> bool:
    """Return whether a name indicates a secret: ``DOCKER_PASSWORD``, ``aws_secret_access_key``."""
    return _SECRET_NAME.search(name) is not None


def variable_name(text: str) -> str:
    """Return a name for an environment variable: ``docker-password`` gives ``DOCKER_PASSWORD``."""
    name = re.sub(r"[^A-Za-z0-9_]+", "_", text).strip("_")
    if re.fullmatch(r"[A-Za-z_][A-Za-z0-9_]*", name):
        return name if name == text else name.upper()
    return f"SECRET_{name.upper()}".rstrip("_")


MAX_LENGTH = 65536
"""Limit of characters of a text after substitution."""
MAX_NODES, MAX_DEPTH = 100_000, 40
"""Limit for a document: YAML aliases and nested variables can expand a small file."""

_VARIABLE_REFERENCE = re.compile(r"\{\{\s*([A-Za-z0-9_!?.\- ]+?)\s*\}\}")
_MARK_WITH_KIND = re.compile("\ue000([VSD])([^\ue001]*)\ue001")
_WITHOUT_MARKS = {"\ue000": "", "\ue001": ""}
_GENERAL_NAMES = ("PASSWORD", "TOKEN", "KEY", "SECRET", "AUTH")
_SHELL_VARIABLE = re.compile(r"\$\{([A-Za-z_][A-Za-z0-9_]*)\}")


def _mark_of(kind: str, name: str) -> str:
    """V: a variable of the environment; S: a secret one; D: data of the matrix."""
    return f"\ue000{kind}{name}\ue001"


def bounded(document: object, where: str) -> Any:
    """Return the document with texts as keys, after checking its size and depth.

    Raises:
        InputError: it is too large or too deep, or two keys are equal as texts.
    """
    left = [MAX_NODES]

    def walk(node: object, depth: int) -> Any:
        left[0] -= 1
        if depth > MAX_DEPTH or left[0] < 0:
            what = f"nested more than {MAX_DEPTH} deep" if depth > MAX_DEPTH else f"more than {MAX_NODES} values"
            raise InputError(f"{where}: found {what} (aliases written out), which no Rigelfile has")
        if isinstance(node, Mapping):
            items = {str(key): walk(value, depth + 1) for key, value in node.items()}
            if len(items) != len(node):
                raise InputError(f"{where}: keys that are the same as texts: {shorten(', '.join(map(repr, node)))}")
            return items
        if isinstance(node, list):
            return [walk(value, depth + 1) for value in node]
        if isinstance(node, bool | int | float | str) or node is None:
            return node
        return str(node)  # a date

    return walk(document, 0)


class Substitution:
    """Substitution of references."""

    def __init__(self, variables: Mapping[str, Any], notes: Notes) -> None:
        """Start with the declared variables, as they are in the file."""
        self._variables = variables
        self._notes = notes
        self._left = MAX_NODES
        self.secrets: dict[str, str] = {}
        """Secrets that were found, and the variables that replace them."""

    def resolved(self, node: Any, where: str, key: str = "", opened: tuple[str, ...] = ()) -> Any:
        """Substitute the references in a part of the document, and mark secrets.

        Args:
            node: the part.
            where: position in the file, for messages.
            key: key of the part: a literal value of a key ``password`` is a secret.
            opened: variables that are being expanded.

        Raises:
            InputError: a variable refers to itself, or the result is too large.
        """
        self._left -= 1
        if self._left < 0:
            raise InputError(f"{where}: its variables make more than {MAX_NODES} values")
        if isinstance(node, dict):
            name = node.get("name")  # {name: TOKEN, value: ...}: the name shows whether the value is a secret
            called = str(name) if set(node) == {"name", "value"} else ""
            inherited = key if names_a_secret(key) else ""
            return {
                self.text(k, f"{where}.{k}", opened): self.resolved(
                    v, f"{where}.{k}", inherited or (called if called and k == "value" else k), opened
                )
                for k, v in node.items()
            }
        if isinstance(node, list):
            return [self.resolved(value, f"{where}.{i}", key, opened) for i, value in enumerate(node)]
        if isinstance(node, str):
            whole = _VARIABLE_REFERENCE.fullmatch(node.strip())
            name = None if whole is None else self._declared_variable(whole[1])
            if name is not None and not names_a_secret(name):
                self._refuse_circle(name, where, opened)
                return self.resolved(self._variables[name], where, key, (*opened, name))
            if names_a_secret(key) and node and "{{" not in node:
                return self._hide_secret(node, key, where)
            return self.text(node, where, opened)
        return node

    def text(self, text: str, where: str, opened: tuple[str, ...] = ()) -> str:
        """Substitute the references in a text.

        Raises:
            InputError: as :meth:`resolved`.
        """
        for sign, nothing in _WITHOUT_MARKS.items():
            text = text.replace(sign, nothing)

        def value(match: re.Match[str]) -> str:
            header, dot, rest = (part.strip() for part in match[1].partition("."))
            if dot and header == "data":
                return _mark_of("D", rest)
            if dot and header != "vars":
                self._notes.lost(where, f"{match[0]} is no reference that Rigel knows (vars, data)")
                return match[0]
            name, declared = rest if dot else header, self._declared_variable(match[1])
            if declared is None:
                return _mark_of("S" if names_a_secret(name) else "V", variable_name(name))
            self._refuse_circle(declared, where, opened)
            self._left -= 1
            found = self.resolved(self._variables[declared], where, declared, (*opened, declared))
            return "" if found is None else str(found)

        text = self._without_secrets(text, where)
        put_in = _VARIABLE_REFERENCE.sub(value, text)
        if len(put_in) > MAX_LENGTH or self._left < 0:
            raise InputError(f"{where}: its variables make a text of more than {MAX_LENGTH} characters")
        return put_in

    def _declared_variable(self, reference: str) -> str | None:
        header, dot, rest = (part.strip() for part in reference.partition("."))
        name = rest if dot and header == "vars" else None if dot else header
        return name if name in self._variables else None

    def _refuse_circle(self, name: str, where: str, opened: tuple[str, ...]) -> None:
        if name in opened:
            raise InputError(f"{where}: the variable {name} refers to itself ({' -> '.join((*opened, name))})")

    def _without_secrets(self, text: str, where: str) -> str:
        spans = [match.span() for pattern in _SECRET_VALUES for match in pattern.finditer(text)]
        for start, end in sorted(spans, reverse=True):
            if "\ue000" not in text[start:end]:
                text = text[:start] + self._hide_secret(text[start:end], "", where) + text[end:]
        return text

    def _hide_secret(self, secret: str, key: str, where: str) -> str:
        """Return the mark of a secret; equal secrets get equal marks."""
        if secret not in self.secrets:
            name = variable_name(key).upper() if key else f"SECRET_{len(self.secrets) + 1}"
            if name in _GENERAL_NAMES:  # the owner: providers.hub.with.password gives HUB_PASSWORD
                name = f"{variable_name(where.split('.')[1]).upper()}_{name}" if "." in where else name
            while name in self.secrets.values():
                name += "_2"
            self.secrets[secret] = name
        name = self.secrets[secret]
        self._notes.to_do(where, f"a secret, which is not copied: put it into the variable {name}")
        return _mark_of("S", name)


def plain(text: str, notes: Notes, where: str) -> str:
    """Write a text for a field without placeholders: ``${NAME}`` for the environment."""
    if found := _SHELL_VARIABLE.search(text):
        notes.changed(where, f"{found[0]} is now read from the environment when calibration.yml is read")
    return _MARK_WITH_KIND.sub(lambda m: f"{{{{ data.{m[2]} }}}}" if m[1] == "D" else f"${{{m[2]}}}", text)


def shell(text: str, secret: Callable[[str], str]) -> str:
    """Write shell code: its own ``${NAME}`` remains; ``secret`` writes the variable of a secret."""
    text = _SHELL_VARIABLE.sub(
        r"${\1-}", text
    )  # equivalent for the shell, and not expanded by the reader of calibration.yml
    return _MARK_WITH_KIND.sub(
        lambda m: {"V": f"${{{m[2]}}}", "D": f"{{{{ data.{m[2]} }}}}"}.get(m[1]) or secret(m[2]), text
    )


def argument(text: str, names: Mapping[str, str], notes: Notes, where: str) -> str:
    """Write an argument of a container's command, where ``{name}`` is substituted, and ``$NAME`` by a shell.

    Args:
        text: with marks.
        names: our placeholders, by the names of the matrix.
        notes: receives data that is not in the matrix.
        where: position in the file.
    """

    def written(match: re.Match[str]) -> str:
        kind, name = match[1], match[2]
        if kind == "V":
            return f"${{{name}}}"
        if kind == "S":
            return f"${name}"
        if name in names:
            return f"{{{names[name]}}}"
        notes.lost(where, f"data.{name} is none of the noise matrix: replace it by hand where it says data.{name}")
        return f"data.{name}"

    return _MARK_WITH_KIND.sub(written, text.replace("{", "{{").replace("}", "}}"))


def secret_names(text: str) -> list[str]:
    """Return the names of the variables of the secrets in a text."""
    return [match[2] for match in _MARK_WITH_KIND.finditer(text) if match[1] == "S"]


def sole_variable(text: str) -> str | None:
    """Return the variable that makes up the whole text; None if there is anything else."""
    match = _MARK_WITH_KIND.fullmatch(text)
    return match[2] if match and match[1] in "VS" else None


def mapping_at(value: object, where: str) -> dict[str, Any]:
    """Return a mapping; an empty one for None.

    Raises:
        InputError: it is of another type.
    """
    if value is None:
        return {}
    if not isinstance(value, dict):
        raise InputError(f"{where}: found {shown(value)}, a mapping was expected")
    return value


def list_at(value: object, where: str) -> list[Any]:
    """Return a list; empty for None, and of one item for a single mapping, as in old Rigelfiles.

    Raises:
        InputError: it is of another type.
    """
    if value is None:
        return []
    if isinstance(value, dict):
        return [value]
    if not isinstance(value, list):
        raise InputError(f"{where}: found {shown(value)}, a list was expected")
    return value


def text_at(value: object, where: str) -> str:
    """Return a text; a number or a boolean is converted.

    Raises:
        InputError: it is a list, a mapping or None.
    """
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str | int | float):
        return str(value)
    raise InputError(f"{where}: found {shown(value)}, a text was expected")


def truth_at(value: object, where: str) -> bool:
    """Return a boolean.

    Raises:
        InputError: it is of another type.
    """
    if isinstance(value, bool):
        return value
    if isinstance(value, str) and value.lower() in ("true", "false"):
        return value.lower() == "true"
    raise InputError(f"{where}: found {shown(value)}, true or false was expected")


def shown(value: object) -> str:
    """Format a value for a message."""
    return shorten(re.sub(r"\\ue000[VSD](.*?)\\ue001", r"${\1}", repr(value)))


class Fields:
    """Fields of a mapping, each taken at most once; :meth:`rest` notes those that were not taken."""

    def __init__(self, value: object, where: str, notes: Notes, spelling: Callable[[str], str] = str) -> None:
        """Wrap a mapping or None.

        Args:
            value: the parsed value.
            where: its position, for messages.
            notes: receives the fields that cannot be converted.
            spelling: normalises a key to the spelling used here.

        Raises:
            InputError: it is of another type. The other methods raise it too, for a field of the wrong type.
        """
        self.where, self.notes, self.spelling = where, notes, spelling
        self._left = {spelling(key): (key, entry) for key, entry in mapping_at(value, where).items()}
        self._written = {taken: key for taken, (key, _) in self._left.items()}

    def __bool__(self) -> bool:
        return bool(self._left)

    def __contains__(self, key: str) -> bool:
        return key in self._left

    def at(self, key: str) -> str:
        """Return the position of a field, in its original spelling."""
        return f"{self.where}.{self._written.get(key, key)}".removeprefix(".")

    def names(self) -> list[str]:
        """Return the keys of the fields that were not taken."""
        return list(self._left)

    def take(self, key: str, default: Any = None) -> Any:
        """Take a field, unconverted."""
        return self._left.pop(key, (key, default))[1]

    def fields(self, key: str) -> "Fields":
        """Take a mapping, or the single mapping of a list."""
        value, where = self.take(key), self.at(key)
        if isinstance(value, list) and len(value) == 1:
            value, where = value[0], f"{where}.0"
        return Fields(value, where, self.notes, self.spelling)

    def items(self, key: str, default: Any = None) -> list[Any]:
        """Take a list; empty for None."""
        return list_at(self.take(key, default), self.at(key))

    def several(self, key: str) -> list["Fields"]:
        """Take a list of mappings."""
        where = self.at(key)
        return [Fields(entry, f"{where}.{i}", self.notes, self.spelling) for i, entry in enumerate(self.items(key))]

    def mapping(self, key: str) -> Mapping[str, Any]:
        """Take a mapping with arbitrary keys."""
        return mapping_at(self.take(key), self.at(key))

    def text(self, key: str, default: str = "") -> str:
        """Take a text."""
        value = self.take(key)
        return default if value is None else text_at(value, self.at(key))

    def texts(self, key: str, default: Any = None) -> list[str]:
        """Take a list of texts."""
        return [text_at(item, self.at(key)) for item in self.items(key, default)]

    def plain(self, key: str, default: str = "") -> str:
        """Take a text for a field that supports no placeholders."""
        return plain(self.text(key, default), self.notes, self.at(key))

    def plains(self, key: str, default: Any = None) -> list[str]:
        """Take a list of texts for a field that supports no placeholders."""
        return [plain(text, self.notes, self.at(key)) for text in self.texts(key, default)]

    def truth(self, key: str, default: bool | None = None) -> bool | None:
        """Take a boolean."""
        value = self.take(key)
        return default if value is None else truth_at(value, self.at(key))

    def refuse(self, reasons: Mapping[str, str]) -> None:
        """Note fields as not converted, each with the reason."""
        for key, why in reasons.items():
            if self.take(key):
                self.notes.lost(self.at(key), why)

    def rest(self, why: str = "there is no such setting here") -> None:
        """Note the fields that were not taken."""
        for key in list(self._left):
            self.notes.lost(self.at(key), why)
        self._left.clear()
