"""``manifest.json``: what came of a job, beside its artifacts.

``schema`` (1), ``job``, ``run``, ``verdict`` (pass or fail), ``exit_code`` (1, 2 or 3 for a fail), ``reasons`` (a line
each), ``seconds``; ``containers``: ``name``, ``image`` (its id), ``end`` (a value of
:class:`calibration.execution.outcome.End`), ``exit_code``, ``signal``, ``seconds``, ``log`` (relative to the manifest);
``artifacts``: ``path`` (relative to ``artifacts/``), ``container``, ``size`` (bytes), ``sha256``; ``left_out``: links
among the artifacts. Nothing of a container's environment is in it.
"""

import json

from calibration.execution.outcome import JobOutcome
from calibration.files import write_atomically

FILE_NAME = "manifest.json"


def write_manifest(outcome: JobOutcome, run: str) -> None:
    """Write the manifest of a job into its folder.

    Raises:
        WorldError: it cannot be written.
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
