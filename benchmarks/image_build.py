"""``build-image`` as whole processes: a first build, and a second one for which nothing has changed."""

import json
import statistics
import subprocess
import sys
import tempfile
import time
import uuid
from collections.abc import Iterator
from pathlib import Path

from benchmarks import AS_FOUND
from benchmarks.rows import Bar, Row
from benchmarks.shared_data import ROOT
from calibration.ci.docker_engine import connect, engine_available

BASE = "debian:bookworm"
FILES = 2000
"""Of 5 kB, as a workspace has them: all are hashed each time."""


def measure(quick: bool) -> Iterator[Row]:
    """The first build, and the second."""
    first, second = "image_build/first", "image_build/unchanged"
    if reason := missing():
        yield Row(first, skipped=reason)
        yield Row(second, skipped=reason)
        return
    name = f"calibration-bench-{uuid.uuid4().hex[:12]}"
    with tempfile.TemporaryDirectory() as folder:
        try:
            specification = _specification(Path(folder), name)
            seconds, built = _build(specification)
            assert built
            note = f"{FILES} files of 5 kB, one command, on {BASE}"
            yield Row(first, seconds, "s", None, note)
            times = [_build(specification) for _ in range(3 if quick else 7)]
            assert not any(built for _, built in times)
            yield Row(
                second, statistics.median(t for t, _ in times), "s", Bar(high=2), "the whole process; nothing built"
            )
        finally:
            _remove(name)


def missing() -> str:
    """Reason why nothing can be measured; empty if it can."""
    if not engine_available():
        return "needs a Docker Engine"
    client = connect()
    try:
        return "" if client.images.list(BASE) else f"needs the image {BASE} (tests/docker_engine.py makes it)"
    finally:
        client.close()


def _specification(folder: Path, name: str) -> Path:
    sources = folder / "sources"
    for number in range(FILES):
        file = sources / f"package_{number % 50}" / f"{number}.cpp"
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(f"// {number}\n" * 600)
    entry = {"name": name, "base": BASE, "files": [{"from": "sources", "to": "/opt/robot"}], "commands": ["true"]}
    path = folder / "image.yml"
    path.write_text(json.dumps(entry))
    return path


def _build(specification: Path) -> tuple[float, bool]:
    """Build an image; return the time, and whether something was built."""
    output = specification.parent / "output"
    start = time.perf_counter()
    subprocess.run(
        [sys.executable, "-m", "calibration", "build-image", "--spec", specification, "--output", output],
        cwd=ROOT,
        env=AS_FOUND,
        check=True,
        capture_output=True,
    )
    return time.perf_counter() - start, bool(json.loads((output / "results.json").read_text())["built"])


def _remove(name: str) -> None:
    client = connect()
    try:
        for image in client.api.images(name):
            for tag in image["RepoTags"] or ():
                client.images.remove(tag, force=True)
    finally:
        client.close()
