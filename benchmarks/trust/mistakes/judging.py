"""What a newcomer is told of a recording: ``init``, then ``run``, as on a terminal."""

import json
import os
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from io import StringIO
from pathlib import Path

from benchmarks.trust.mistakes.recordings import Document
from calibration.__main__ import main
from calibration.base import temporary_folder

FAILS = ": fails: "
"""What ``init`` says before each reason for which a recording does not pass."""


@dataclass(frozen=True)
class Told:
    """Verdict and first reason."""

    verdict: str
    """green, or red with the exit code."""
    reason: str
    """The first one; of a green recording what init says."""


def told(document: Document) -> Told:
    """Run ``init`` and, if it leaves a calibration.yml, ``run`` on a dataset; red if one of them is."""
    here = Path.cwd()
    with temporary_folder() as folder:
        (folder / "data" / "robot").mkdir(parents=True)
        (folder / "data" / "robot" / "dataset.json").write_text(json.dumps(document))
        os.chdir(folder)
        try:
            code, said = _said("init", "--dataset", "data/robot")
            if not Path("calibration.yml").is_file():
                lines = said.strip().splitlines()
                return Told(f"red ({code})", next((each for each in lines if FAILS in each), lines[0]))
            after, _ = _said("run")
            results = json.loads(Path("output/results.json").read_text())
            reasons = [reason for cell in results["cells"] for reason in cell["reasons"]]
            red = max(code, after)
            return Told(f"red ({red})" if red else "green", reasons[0] if reasons else said.strip().splitlines()[0])
        finally:
            os.chdir(here)


def _said(*arguments: str) -> tuple[int, str]:
    out, err = StringIO(), StringIO()
    with redirect_stdout(out), redirect_stderr(err):
        code = main(arguments)
    return code, err.getvalue() or out.getvalue()
