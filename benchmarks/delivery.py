"""Bundles for robots: changed ones that are accepted, and the time to verify one."""

import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from benchmarks.rows import Bar, Row
from benchmarks.shared_data import ROOT
from tests.addons.delivery.bundles import NAME, SYSTEM, messages, write_bundle_files, write_yaml
from tests.addons.delivery.changed import GOOD, changed_bundle, check


def measure(quick: bool) -> Iterator[Row]:
    """Check changed bundles, and verify the untouched one in processes of its own."""
    count = 200 if quick else 1000
    cases = [(case := changed_bundle(seed), check(case).reasons) for seed in range(count)]
    note = f"of {count} bundles that were changed in {len({case.kind for case, _ in cases})} ways"
    yield Row("delivery/accepted", sum(not reasons for _, reasons in cases), "bundles", Bar(high=0), note)
    other = sum(not any(case.reason in reason for reason in reasons) for case, reasons in cases)
    yield Row("delivery/other reason", other, "bundles", Bar(high=0), "refused for another reason than the change")
    with tempfile.TemporaryDirectory() as folder:
        write_bundle_files(Path(folder), GOOD)
        write_yaml(Path(folder) / "tf.yaml", messages(*SYSTEM.transforms[:2]))
        command = [sys.executable, "-m", "calibration", "verify", NAME, "--key", "key.pub", "--offline"]
        seconds = []
        for _ in range(5):
            begin = time.perf_counter()
            subprocess.run(
                [*command, "--in-use", "tf.yaml"],
                cwd=folder,
                env={"PYTHONPATH": str(ROOT)},
                check=True,
                capture_output=True,
            )
            seconds.append(time.perf_counter() - begin)
    yield Row("delivery/verify", min(seconds), "s", Bar(high=1), "a process, from start to exit, with a file in use")
