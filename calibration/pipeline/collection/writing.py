"""The files that a collection leaves beside its dataset."""

import json
from pathlib import Path

from calibration.files import write_atomically
from calibration.pipeline.collection.results import (
    FILE,
    POSES_FILE,
    SUMMARY_FILE,
    CollectionResults,
    collection_document,
    junit,
    poses_csv,
)
from calibration.pipeline.collection.summary import markdown


def write_collection_results(results: CollectionResults, output: Path) -> None:
    """Write ``results.json``, ``poses.csv``, ``junit.xml`` and ``summary.md`` into a folder.

    Raises:
        WorldError: a file cannot be written.
    """
    text = json.dumps(collection_document(results), indent=1, allow_nan=False) + "\n"
    write_atomically(output / FILE, text)
    write_atomically(output / POSES_FILE, poses_csv(results))
    write_atomically(output / SUMMARY_FILE, markdown(results))
    write_atomically(output / "junit.xml", junit(results))
