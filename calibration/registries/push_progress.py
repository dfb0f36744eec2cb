"""How far a push is: a step for each layer, and lines in between for large ones."""

from collections.abc import Mapping
from typing import Any

from calibration.workflow.progress import Advance
from calibration.workflow.text import one_line, shorten

LARGE = 50_000_000
"""Bytes; a larger layer says how far it is at each quarter."""
_DONE = {"Pushed": "pushed", "Layer already exists": "is there already"}


class PushProgress:
    """Turns the engine's events into steps."""

    def __init__(self, advance: Advance | None) -> None:
        self._advance = advance
        self._layers: dict[str, bool] = {}
        self._sizes: dict[str, int] = {}
        self._quarters: dict[str, int] = {}

    def event(self, event: Mapping[str, Any]) -> None:
        """Take in what the engine says; what is of another form is passed over."""
        layer, status = str(event.get("id", "")), str(event.get("status", ""))
        if self._advance is None or not layer:
            return
        known = self._layers.setdefault(layer, False)
        done = next((word for start, word in _DONE.items() if status.startswith(start)), None)
        if status.startswith("Mounted from"):
            done = "is there already"
        if done is not None and not known:
            self._layers[layer] = True
            size = f" ({megabytes(self._sizes[layer])})" if layer in self._sizes else ""
            self._say(f"layer {layer} {done}{size}", important=False)
        elif status == "Pushing":
            self._pushing(layer, event.get("progressDetail"))
        elif status.startswith("Retrying in 1 second"):
            self._say(f"layer {layer} is sent again", important=True)

    def _pushing(self, layer: str, detail: object) -> None:
        if not isinstance(detail, Mapping):
            return
        current, total = detail.get("current"), detail.get("total")
        if not (isinstance(current, int) and isinstance(total, int) and 0 <= current <= total):
            return
        self._sizes[layer] = total
        quarter = 4 * current // total if total else 0
        if total >= LARGE and self._quarters.get(layer, 0) < quarter < 4:
            self._quarters[layer] = quarter
            self._say(f"layer {layer}: {megabytes(current)} of {megabytes(total)}", important=True)

    def _say(self, line: str, *, important: bool) -> None:
        if self._advance is not None:
            total = len(self._layers)
            self._advance(sum(self._layers.values()), total, shorten(one_line(line)), important=important)


def megabytes(size: int) -> str:
    """A size for people: ``12.3 MB``."""
    return f"{size / 1e6:.1f} MB"
