"""``world.json``: what came of one world, beside its dataset; its JSON Schema is ``world.schema.json`` here.

It says of a world what the dataset does not: its id and what it is (`ScenarioResult.hash`), the poses that were
lost, and why there is no dataset where there is none.
"""

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

from calibration import __version__
from calibration.errors import InputError
from calibration.files import read_bytes, write_atomically
from calibration.json_file import parse_json
from calibration.json_schema import check_document
from calibration.simulation.scenarios.scenario import ScenarioResult
from calibration.workflow.text import one_line, shorten

SCHEMA = Path(__file__).with_name("world.schema.json")
FILE = "world.json"
MAX_BYTES = 16 * 1024**2
_LONGEST_REASON = 1000


def write_world(result: ScenarioResult, stillness: float | None, folder: Path) -> None:
    """Write the file into the folder of the dataset.

    Args:
        result: what came of the world.
        stillness: how far a pattern was allowed to move while the sensors look, m; None where nobody asked.
        folder: where to.

    Raises:
        WorldError: it cannot be written.
    """
    document = {"schema": 1, "version": __version__, "stillness_m": stillness, "result": asdict(result)}
    write_atomically(folder / FILE, json.dumps(document, indent=1, allow_nan=False) + "\n")


def read_world(folder: Path, expected: ScenarioResult, stillness: float | None) -> ScenarioResult:
    """Read the file of a world; somebody else may have written it.

    Args:
        folder: where it is.
        expected: the world that it should be of, with no result yet.
        stillness: how far a pattern was allowed to move, m.

    Raises:
        InputError: there is no such file, or it is of another world, another version or of no such form.
    """
    path = folder / FILE
    text = read_bytes(path, MAX_BYTES, "what came of a world")
    try:
        document = parse_json(text)
    except (ValueError, RecursionError):
        raise InputError(f"{FILE}: this is no JSON") from None
    check_document(document, json.loads(SCHEMA.read_text()), FILE)
    if document["version"] != __version__:
        raise InputError(
            f"{FILE}: made by calibration-ci {one_line(document['version'])}, this is {__version__}: "
            "another version makes other worlds; have the same in the image"
        )
    found = result_from(document["result"])
    for what, theirs, ours in (
        ("id", found.id, expected.id),
        ("hash", found.hash, expected.hash),
        ("stillness", document["stillness_m"], stillness),
    ):
        if theirs != ours:
            raise InputError(f"{FILE}: it is of another world: {what}: found {theirs}, expected {ours}")
    return found


def result_from(entry: dict[str, Any]) -> ScenarioResult:
    """The result of a world whose fields stand in a document.

    Raises:
        KeyError, TypeError, AttributeError: it is none.
    """
    lost = entry["lost"]
    return ScenarioResult(
        **{
            **entry,
            "lost": None if lost is None else {one_line(pose): _lines(why) for pose, why in lost.items()},
            "reasons": _lines(entry["reasons"]),
        }
    )


def _lines(lines: list[str]) -> tuple[str, ...]:
    return tuple(shorten(one_line(line), _LONGEST_REASON) for line in lines)
