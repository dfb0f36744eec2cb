"""YAML text of the exported files."""

from typing import Any

import yaml


def yaml_text(document: Any) -> str:
    """Return a document as YAML, its keys in their order."""
    return str(yaml.safe_dump(document, sort_keys=False, allow_unicode=True))
