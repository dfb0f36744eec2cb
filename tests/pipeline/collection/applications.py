from collections.abc import Mapping
from pathlib import Path
from typing import Any

from calibration.base.records import Place, read
from calibration.pipeline.containers import Applications, checked_applications


def applications_from(entry: Mapping[str, Any], folder: Path, where: str) -> Applications:
    """Read applications from the keys that an entry of ``simulation`` in calibration.yml has of them."""
    return checked_applications(read(Applications, entry, where, folder), Place(where))
