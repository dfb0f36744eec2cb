"""Result file of one scenario, ``scenario.json``, beside its dataset.

It has what the dataset lacks: the scenario's id and hash (`ScenarioResult.hash`), the rejected
poses, and the reason if there is no dataset.
"""

import json
from pathlib import Path
from typing import Annotated, Literal

from calibration import __version__
from calibration.base.errors import InputError
from calibration.base.files import read_bytes, write_atomically
from calibration.base.json_file import parse_json
from calibration.base.records import document_of, field, length, read, record
from calibration.base.text import one_line
from calibration.robot.simulation.scenarios.scenario import Amount, ScenarioResult

FILE = "scenario.json"
MAX_BYTES = 16 * 1024**2


@record(case="snake", nulls=True)
class ScenarioFile:
    """Result of one scenario, beside its dataset."""

    schema: Literal[1] = field("Of this form.")
    version: Annotated[str, length(most=100)] = field("Version of the package that made it.")
    stillness_m: Amount | None = field(
        "How far the pattern may have moved while the sensors looked; null where the team's applications collected."
    )
    result: ScenarioResult = field("Result of the scenario.")


def write_scenario(result: ScenarioResult, stillness: float | None, folder: Path) -> None:
    """Write the file into the folder of the dataset.

    Args:
        result: result of the scenario.
        stillness: limit of a pattern's motion while the sensors measure, m; None if unknown.
        folder: the target folder.

    Raises:
        InfrastructureError: it cannot be written.
    """
    document = document_of(ScenarioFile(1, __version__, stillness, result))
    write_atomically(folder / FILE, json.dumps(document, indent=1, allow_nan=False) + "\n")


def read_scenario(folder: Path, expected: ScenarioResult, stillness: float | None) -> ScenarioResult:
    """Read the file of a scenario; its content is not trusted.

    Args:
        folder: the scenario's folder.
        expected: the expected scenario, without a result.
        stillness: limit of a pattern's motion, m.

    Raises:
        InputError: there is no such file, or it is of another scenario, another version or invalid.
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
