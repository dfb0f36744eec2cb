"""Result folder of a job, the same for all backends.

``artifacts/``, ``logs/``, and ``manifest.json`` with the outcome of the job: ``schema`` (1), ``job``, ``run``,
``verdict`` (pass or fail), ``exit_code`` (1, 2 or 3 for a fail), ``reasons`` (a line each), ``seconds``;
``containers``: ``name``, ``image`` (its id), ``end`` (a value of :class:`calibration.ci.execution.outcome.End`),
``exit_code``, ``signal``, ``seconds``, ``log`` (relative to the manifest); ``artifacts``: ``path`` (relative to
``artifacts/``), ``container``, ``size`` (bytes), ``sha256``; ``left_out``: links among the artifacts. It contains
nothing of a container's environment.
"""

import json
import shutil
from pathlib import Path

from calibration.base.errors import InfrastructureError
from calibration.base.files import write_atomically
from calibration.ci.execution.outcome import JobOutcome

ARTIFACTS_FOLDER, LOGS_FOLDER = "artifacts", "logs"
"""Subfolders of a job's folder."""
FILE_NAME = "manifest.json"


def make_job_folder(folder: Path) -> None:
    """Create a job's folder, without results of an earlier run.

    Raises:
        InfrastructureError: it cannot be written.
    """
    try:
        for name in (ARTIFACTS_FOLDER, LOGS_FOLDER, FILE_NAME):
            place = folder / name
            if place.is_dir() and not place.is_symlink():
                shutil.rmtree(place)
            else:
                place.unlink(missing_ok=True)
        (folder / LOGS_FOLDER).mkdir(parents=True)
    except OSError as error:
        raise InfrastructureError(f"{folder}: cannot be written: {error.strerror or error}") from error


def write_manifest(outcome: JobOutcome, run: str) -> None:
    """Write the manifest of a job into its folder.

    Raises:
        InfrastructureError: it cannot be written.
    """
    document = {
        "schema": 1,
        "job": outcome.job,
        "run": run,
        "verdict": outcome.verdict,
        "exit_code": int(outcome.exit_code),
        "reasons": outcome.reasons,
        "seconds": round(outcome.seconds, 3),
        "containers": [
            {
                "name": container.name,
                "image": container.image,
                "end": container.end.value,
                "exit_code": container.exit_code,
                "signal": container.signal,
                "seconds": round(container.seconds, 3),
                "log": None if container.log is None else container.log.relative_to(outcome.folder).as_posix(),
            }
            for container in outcome.containers
        ],
        "artifacts": [
            {"path": file.path, "container": file.container, "size": file.size, "sha256": file.sha256}
            for file in outcome.artifacts
        ],
        "left_out": outcome.left_out,
    }
    write_atomically(outcome.folder / FILE_NAME, json.dumps(document, indent=1, allow_nan=False) + "\n")
