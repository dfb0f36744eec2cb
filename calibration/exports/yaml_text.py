"""YAML text of the exported files."""

from typing import Any


def yaml_text(document: Any) -> str:
    """Return a document as YAML, its keys in their order."""
    import yaml  # slow to import, and the names of the formats are needed by every run

    return str(yaml.safe_dump(document, sort_keys=False, allow_unicode=True))
