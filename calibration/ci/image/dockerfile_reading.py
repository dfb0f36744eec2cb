"""Analysis of a user's Dockerfile: its base images, and whether it needs BuildKit."""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

_ESCAPE_DIRECTIVE = re.compile(r"#\s*escape\s*=\s*(\S)\s*$", re.IGNORECASE)
_HERE_DOCUMENT = re.compile(r"""<<-?(["']?)([A-Za-z_][A-Za-z0-9_]*)\1""")
_VARIABLE_USE = re.compile(r"\$(?:(\w+)|\{(\w+)(?::?-([^}]*))?\})")
_NEEDS_BUILDKIT = re.compile(
    r"^\s*#\s*syntax\s*=|^\s*RUN\s+--(mount|network|security)=|^\s*(COPY|ADD)\s.*--(link|chmod|checksum|exclude|parents)\b"
    r"|^\s*(RUN|COPY|ADD)\s.*<<-?[\"']?[A-Za-z_]",
    re.IGNORECASE | re.MULTILINE,
)


@dataclass(frozen=True)
class Bases:
    """Images of a Dockerfile's FROM and COPY --from."""

    images: tuple[str, ...]
    unresolved: tuple[str, ...] = ()
    """Names with variables that only the builder knows."""


def needs_buildkit(dockerfile: str) -> bool:
    """Return whether a Dockerfile needs BuildKit, as opposed to the classic builder."""
    return _NEEDS_BUILDKIT.search(dockerfile) is not None


def bases_of(dockerfile: str, arguments: Mapping[str, str]) -> Bases:
    """Return the images of ``FROM`` and ``COPY --from``, with values of ``ARG`` substituted."""
    values: dict[str, str] = {}
    stages: list[str] = []
    images: list[str] = []
    for word, rest in _read_instructions(dockerfile):
        if word == "ARG" and not stages:
            for item in rest.split():
                name, _, default = item.partition("=")
                values[name] = arguments.get(name, _fill_variables(default.strip("\"'"), values))
        elif word == "FROM":
            words = [item for item in rest.split() if not item.startswith("--")]
            image = _fill_variables(words[0], values) if words else ""
            if image.lower() not in (*stages, "scratch", ""):
                images.append(image)
            stages.append(words[2].lower() if len(words) == 3 and words[1].lower() == "as" else "")
        elif found := re.search(r"(?:--from=|--mount=\S*\bfrom=)([^\s,]+)", rest):
            image = _fill_variables(found[1], values)
            if not image.isdecimal() and image.lower() not in stages:
                images.append(image)
    known = dict.fromkeys(images)
    return Bases(tuple(i for i in known if "$" not in i), tuple(i for i in known if "$" in i))


def _read_instructions(dockerfile: str) -> Iterator[tuple[str, str]]:
    """Yield instructions and their arguments on one line, without comments and here-documents."""
    lines = iter(dockerfile.lstrip("\ufeff").split("\n"))
    escape = "\\"
    part = ""
    for number, line in enumerate(lines):
        if number < 2 and (found := _ESCAPE_DIRECTIVE.match(line)):
            escape = found[1]
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        part += line.strip()
        if part.endswith(escape):
            part = part[:-1] + " "
            continue
        word, _, rest = part.partition(" ")
        yield word.upper(), rest.strip()
        if word.upper() in ("RUN", "COPY", "ADD"):
            for _, end in _HERE_DOCUMENT.findall(part):
                for inside in lines:
                    if inside.strip() == end:
                        break
        part = ""


def _fill_variables(text: str, values: Mapping[str, str]) -> str:
    def value(match: re.Match[str]) -> str:
        name, default = match[1] or match[2], match[3]
        return values.get(name) or (match[0] if default is None else default)

    return _VARIABLE_USE.sub(value, text)
