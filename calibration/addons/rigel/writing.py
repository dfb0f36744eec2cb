"""Writer of a conversion as a ``calibration.yml``, with comments that name the source of each part."""

import textwrap
from collections.abc import Mapping
from typing import Any

import yaml

from calibration.addons.rigel.conversion import Conversion
from calibration.addons.rigel.fields import NoteKind
from calibration.addons.rigel.systems import ConvertedEntry
from calibration.base.text import one_line

COMMENT_WIDTH = 110
"""Line width of comments."""
MIN_SECRET_LENGTH = 6
"""Minimum length of a secret in characters; a shorter one may be a word of any text."""
MAX_LIST_LENGTH = 90
"""Maximum length of a list on one line, in characters."""
_HEADING_OF_KIND = {
    NoteKind.TO_DO: "To do:",
    NoteKind.CHANGED: "What works otherwise here:",
    NoteKind.LOST: "What was not carried over:",
}


class _Dumper(yaml.SafeDumper):
    """YAML dumper with block style for multi-line texts and without aliases."""

    def ignore_aliases(self, data: object) -> bool:
        return True

    def increase_indent(self, flow: bool = False, indentless: bool = False) -> None:
        super().increase_indent(flow, indentless=False)


def _represent_text(dumper: yaml.SafeDumper, text: str) -> yaml.ScalarNode:
    # A block style text cannot contain trailing blanks or non-printable characters.
    block = "\n" in text and not any(line != line.rstrip() for line in text.split("\n")) and text.strip("\n") == text
    printable = text.replace("\n", "").isprintable()
    style = ("|" if block else None) if printable else '"'
    return dumper.represent_scalar("tag:yaml.org,2002:str", text, style=style)


def _represent_list(dumper: yaml.SafeDumper, items: list[Any]) -> yaml.SequenceNode:
    node = dumper.represent_sequence("tag:yaml.org,2002:seq", items)
    if sum(len(str(item)) + 2 for item in items) > MAX_LIST_LENGTH:
        node.flow_style = False
    return node


_Dumper.add_representer(str, _represent_text)
_Dumper.add_representer(list, _represent_list)


def written(conversion: Conversion, source: str) -> str:
    """Return the text of ``calibration.yml``; ``source`` is the name of the converted file."""
    parts = [
        _comment_text(f"Made from {source} by `calibration import-rigelfile`; from now on it is yours to edit."),
        _notes_text(conversion, NoteKind.TO_DO),
    ]
    if conversion.image:
        parts.append(_comment_text(f"from the {conversion.image_origin}") + _dump_yaml({"image": conversion.image}))
    if conversion.noise:
        parts.append(
            _comment_text(f"from {conversion.noise_origin}; m and rad") + _dump_yaml({"noise": conversion.noise})
        )
    parts += [_section_text("systems", conversion.systems), _section_text("simulation", conversion.simulations)]
    if conversion.batch:
        parts.append(
            _comment_text(f"from the {conversion.batch_origin}")
            + _dump_yaml({"aws-batch": conversion.batch}, flow=False)
        )
    if conversion.requirements:
        parts.append(
            _comment_text(f"from the {conversion.requirements_origin}")
            + _dump_yaml({"requirements": conversion.requirements}, flow=False)
        )
    parts += [_notes_text(conversion, NoteKind.CHANGED), _notes_text(conversion, NoteKind.LOST)]
    return _without_secrets(conversion.secrets, "\n".join(part for part in parts if part))


def _without_secrets(secrets: Mapping[str, str], text: str) -> str:
    """Remove secrets from the text that also occur where no key marks them."""
    for secret in sorted(secrets, key=len, reverse=True):
        if len(secret) >= MIN_SECRET_LENGTH:
            text = text.replace(secret, f"${{{secrets[secret]}}}")
    return text


def _section_text(name: str, entries: list[ConvertedEntry]) -> str:
    if not entries:
        return ""
    blocks = [
        textwrap.indent(_comment_text(f"from the {entry.origin}") + _dump_yaml({entry.name: entry.entry}), "  ")
        for entry in entries
    ]
    return f"{name}:\n" + "\n".join(blocks)


def _notes_text(conversion: Conversion, kind: NoteKind) -> str:
    notes = [note for note in conversion.notes if note.kind is kind]
    return _comment_text("\n".join([_HEADING_OF_KIND[kind], *(f"- {note}" for note in notes)])) if notes else ""


def _comment_text(text: str) -> str:
    lines: list[str] = []
    for line in text.split("\n"):
        lines += textwrap.wrap(one_line(line), COMMENT_WIDTH, subsequent_indent="  ", break_on_hyphens=False)
    return "".join(f"# {line}\n" for line in lines)


def _dump_yaml(document: dict[str, Any], flow: bool | None = None) -> str:
    return yaml.dump(
        document, Dumper=_Dumper, sort_keys=False, allow_unicode=True, width=2**20, default_flow_style=flow
    )
