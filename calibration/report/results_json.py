"""Text of results.json, the same for every command."""

import json
from collections.abc import Mapping
from typing import Any


def results_json(document: Mapping[str, Any]) -> str:
    """Return a document as JSON; raises ``ValueError`` for a number that is not finite."""
    return json.dumps(document, indent=1, allow_nan=False) + "\n"
