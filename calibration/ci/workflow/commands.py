"""Workflow commands: lines of the log that the runner executes (``::error file=a.csv,line=3::...``)."""

from calibration.base.text import visible


def workflow_command(name: str, message: str = "", **properties: str | int | None) -> str:
    """Format a workflow command; properties that are None are omitted."""
    given = [f"{key}={escape_property(visible(str(value)))}" for key, value in properties.items() if value is not None]
    return f"::{name}{' ' if given else ''}{','.join(given)}::{escape_data(message)}"


def escape_data(text: str) -> str:
    """Escape the message of a workflow command."""
    return text.replace("%", "%25").replace("\r", "%0D").replace("\n", "%0A")


def escape_property(text: str) -> str:
    """Escape the value of a property (file, line, title) of a workflow command."""
    return escape_data(text).replace(":", "%3A").replace(",", "%2C")
