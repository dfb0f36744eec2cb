"""``make fuzz``: files that were changed by a seed, given to every reader of files of others.

Each is read, or refused by an error of one line. What else happens is a failure: another exception, a message of many
lines or characters, more than `SECONDS` or `MEMORY`, which are measured for each case. It is named by its target and
its seed, and becomes a line of `test_fuzz.FOUND`. ``python -m tests.campaigns.fuzz --target table --case 17`` runs one
case alone.
"""

import argparse
import contextlib
import random
import resource
import signal
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

from calibration.base import CalibrationError, solvable
from calibration.base.errors import LONGEST_MESSAGE
from tests.campaigns.mutations import mutated
from tests.campaigns.target import Target
from tests.campaigns.targets import TARGETS

SECONDS = 10
"""Of the processor, for one case."""
MEMORY = 1 << 30
"""Bytes by which the memory of the process may grow in a case."""
ADDRESSES = 4 << 30
"""Bytes of address space that a case may ask for: more than it may use, so that a reader that asks is found."""


class HangError(BaseException):
    """A case takes too long; no `Exception`, so that no reader catches it."""


@dataclass
class Campaign:
    """What came of the cases."""

    read: Counter[str] = field(default_factory=Counter)
    refused: Counter[str] = field(default_factory=Counter)
    failures: list[str] = field(default_factory=list)
    slowest: dict[str, float] = field(default_factory=dict)
    """Seconds of the processor of the slowest case of a target."""
    largest: dict[str, int] = field(default_factory=dict)
    """Bytes by which the process grew in the largest case of a target."""

    def run(self, name: str, target: Target, seed: int) -> None:
        """Run one case, and count what came of it."""
        _originals(target)
        begin, before = time.process_time(), _memory("VmRSS")
        Path("/proc/self/clear_refs").write_text("5")  # the peak is counted anew
        failure = problem_of(target, seed)
        seconds, size = time.process_time() - begin, _memory("VmHWM") - before
        self.slowest[name] = max(self.slowest.get(name, 0.0), seconds)
        self.largest[name] = max(self.largest.get(name, 0), size)
        if size > MEMORY:
            failure = f"{size >> 20} MiB"
        if failure is None:
            self.read[name] += 1
        elif failure == "":
            self.refused[name] += 1
        else:
            self.failures.append(f"{name} --case {seed}: {failure}")


def problem_of(target: Target, seed: int) -> str | None:
    """What is wrong with what a case did: None where it was read, empty where it was refused as it should be."""
    originals = _originals(target)
    data = mutated(originals[seed % len(originals)], seed, Path(target.name).suffix)
    with tempfile.TemporaryDirectory(prefix="calibration-fuzz-") as folder, warnings.catch_warnings(record=True):
        path = Path(folder) / target.name
        path.write_bytes(data)
        try:
            with bounded(SECONDS, ADDRESSES), solvable("the data"):
                target.read(path)
        except CalibrationError as refused:
            lines, size = len(str(refused).splitlines()), len(str(refused))
            return "" if lines == 1 and size <= LONGEST_MESSAGE + 1 else f"an error of {lines} lines, {size} characters"
        except HangError:
            return f"not done after {SECONDS} s"
        except Exception as bug:
            place = traceback.extract_tb(bug.__traceback__)[-1]
            return f"{type(bug).__name__}: {str(bug)[:200]} ({Path(place.filename).name}:{place.lineno})"
    return None


def _memory(what: str) -> int:
    """Memory of this process in bytes: what it has (VmRSS), or its peak (VmHWM)."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return 1024 * next(int(line.split()[1]) for line in lines if line.startswith(f"{what}:"))


@cache
def _originals(target: Target) -> list[bytes]:
    return target.originals()


@contextlib.contextmanager
def bounded(seconds: int, memory: int) -> Iterator[None]:
    """Bound time and address space inside the block, by `HangError` and `MemoryError`.

    It is the time of the processor, as the machine may be busy, and three times as much by the clock.
    """

    def stop(*_: object) -> None:
        raise HangError

    before = {number: signal.signal(number, stop) for number in (signal.SIGALRM, signal.SIGPROF)}
    limits = resource.getrlimit(resource.RLIMIT_AS)
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    resource.setrlimit(resource.RLIMIT_AS, (pages * resource.getpagesize() + memory, limits[1]))
    signal.setitimer(signal.ITIMER_PROF, seconds)
    signal.alarm(3 * seconds)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.setitimer(signal.ITIMER_PROF, 0)
        resource.setrlimit(resource.RLIMIT_AS, limits)
        for number, handler in before.items():
            signal.signal(number, handler)


def campaign(cases: int, seed: int, names: list[str], seconds: float | None = None) -> Campaign:
    """Run so many cases of targets by their shares, or as many as there is time for."""
    found, draw, end = Campaign(), random.Random(seed), time.monotonic() + (seconds or 1e9)
    weights = [TARGETS[name].share for name in names]
    for _ in range(cases):
        if time.monotonic() > end:
            break
        [name] = draw.choices(names, weights)
        found.run(name, TARGETS[name], draw.randrange(1 << 31))
    return found


def main() -> int:
    """Run the campaign of the command line, and print its counts; 1 where a case failed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cases", type=int, default=100_000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--seconds", type=float, help="end sooner, after so long")
    parser.add_argument("--target", choices=TARGETS, help="this one alone")
    parser.add_argument("--case", type=int, help="of the target, this case alone")
    asked = parser.parse_args()
    names = [asked.target] if asked.target else list(TARGETS)
    if asked.case is not None:
        print(problem_of(TARGETS[names[0]], asked.case) or "as it should be")
        return 0
    found = campaign(asked.cases, asked.seed, names, asked.seconds)
    for name in names:
        at_most = f"{found.slowest.get(name, 0):5.1f} s {found.largest.get(name, 0) >> 20:5} MiB at most"
        print(f"{name:22} {found.read[name]:7} read {found.refused[name]:7} refused, {at_most}")
    print("\n".join(found.failures))
    total, count = found.read.total() + found.refused.total(), len(found.failures)
    at_most = f"{max(found.slowest.values()):.1f} s, {max(found.largest.values()) >> 20} MiB"
    print(f"{total + count} cases, seed {asked.seed}: {count} failures; {at_most} at most")
    return 1 if found.failures else 0


if __name__ == "__main__":
    sys.exit(main())
