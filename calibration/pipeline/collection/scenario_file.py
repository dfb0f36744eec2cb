"""``scenario.json``: what came of one scenario, beside its dataset.

It says of a scenario what the dataset does not: its id and what it is (`ScenarioResult.hash`), the poses that were
lost, and why there is no dataset where there is none.
"""

import json
from pathlib import Path
from typing import Annotated, Literal

from calibration import __version__
from calibration.errors import InputError
from calibration.files import read_bytes, write_atomically
from calibration.json_file import parse_json
from calibration.records import document_of, field, length, read, record
from calibration.simulation.scenarios.scenario import Amount, ScenarioResult
from calibration.workflow.text import one_line

FILE = "scenario.json"
MAX_BYTES = 16 * 1024**2


@record(case="snake", nulls=True)
class ScenarioFile:
    """What came of one scenario, beside its dataset."""

    schema: Literal[1] = field("Of this form.")
    version: Annotated[str, length(most=100)] = field("Of the package that made it.")
    stillness_m: Amount | None = field(
        "How far the pattern may have moved while the sensors looked; null where the team's applications collected."
    )
    result: ScenarioResult = field("What came of it.")


def write_scenario(result: ScenarioResult, stillness: float | None, folder: Path) -> None:
    """Write the file into the folder of the dataset.

    Args:
        result: what came of the scenario.
        stillness: how far a pattern was allowed to move while the sensors look, m; None where nobody asked.
        folder: where to.

    Raises:
        InfrastructureError: it cannot be written.
    """
    document = document_of(ScenarioFile(1, __version__, stillness, result))
    write_atomically(folder / FILE, json.dumps(document, indent=1, allow_nan=False) + "\n")


def read_scenario(folder: Path, expected: ScenarioResult, stillness: float | None) -> ScenarioResult:
    """Read the file of a scenario; somebody else may have written it.

    Args:
        folder: where it is.
        expected: the scenario that it should be of, with no result yet.
        stillness: how far a pattern was allowed to move, m.

    Raises:
        InputError: there is no such file, or it is of another scenario, another version or of no such form.
    """
    path = folder / FILE
    text = read_bytes(path, MAX_BYTES, "what came of a scenario")
    try:
        document = parse_json(text)
    except (ValueError, RecursionError):
        raise InputError(f"{FILE}: this is no JSON") from None
    found = read(ScenarioFile, document, FILE)
    if found.version != __version__:
        raise InputError(
            f"{FILE}: made by calibration-ci {one_line(found.version)}, this is {__version__}: "
            "another version makes other scenarios; have the same in the image"
        )
    for what, theirs, ours in (
        ("id", found.result.id, expected.id),
        ("hash", found.result.hash, expected.hash),
        ("stillness", found.stillness_m, stillness),
    ):
        if theirs != ours:
            raise InputError(f"{FILE}: it is of another scenario: {what}: found {theirs}, expected {ours}")
    return found.result
