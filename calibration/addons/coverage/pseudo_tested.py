"""Functions that tests run and do not test: their tests pass also when their body is replaced.

R. Niedermayr, E. Juergens, S. Wagner: Will my tests tell me if I break this code? (2016). As there and in Descartes,
a body is replaced as a whole, here by constants of the types that the function gave while its tests ran, or by an
argument of that type: a caller that only passes the result on does not fail for its type alone. Functions without
anything to test are left out (`PythonFunction.trivial`).
"""

import hashlib
import json
import os
import selectors
import time
from collections import defaultdict
from collections.abc import Generator, Iterable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from dataclasses import field as dataclass_field
from functools import cached_property
from pathlib import Path, PurePosixPath

from calibration.addons.coverage.coverage_py import INJECTED_FOLDER, plain
from calibration.addons.coverage.sources import CACHES, PythonFunction, Sources
from calibration.addons.coverage.tests import CommandOfTests
from calibration.addons.coverage.workers import (
    JobOutcome,
    Judging,
    Replacement,
    TestJob,
    TestWorker,
    copy_of_checkout,
    run_on,
)
from calibration.base import InfrastructureError, InputError, one_line, read_bytes, shorten, temporary_folder
from calibration.base.records import computed, field, result
from calibration.ci.workflow.runner import Runner
from calibration.ci.workflow.streams import LogFile

LOG_FILE = "pseudo-tested.log"
PLAN_FILE = "plan.json"
SOCKET_FILE = "socket"
MAX_SECONDS_TO_FINISH = 60.0
"""How long the command of the tests may take after its last job."""
MAX_WORKERS = 8
"""Processes of the tests, of which each has a copy of the checkout."""
MAX_RECORD_BYTES = 512 << 20
"""Largest record of which test runs which function."""
SECONDS_OF_JOB = 10.0
"""How long a job may take beyond a multiple of what its tests took."""
MAX_SLOWDOWN = 4.0
"""That multiple."""
VALUES_OF_FIELDS = ("None", "'calibration'")
"""What the fields that a body would have set are, where its object has none of this name yet."""
OVER_BUDGET = "the budget of time was used up"


@result
class FunctionOfTests:
    """A function that tests run."""

    path: str = field("Its file, in the repository.")
    line: int = field("The line of def.")
    name: str = field("Its name, with the classes around it.")
    changed: bool = field("Whether the change touches it.")


@result
class PseudoTestedFunction(FunctionOfTests):
    """A function whose tests pass also when its body is replaced."""

    replacements: tuple[str, ...] = field("What its body was replaced by, each time without a test that fails.")
    tests: tuple[str, ...] = field("The tests that run it.")


@result
class UnjudgedFunction(FunctionOfTests):
    """A function that tests run, of which it is not known whether they test it."""

    reason: str = field("Why it is not known.")


@result
class PseudoTestedResults:
    """Functions that tests run and do not test."""

    judged: int = field("Number of functions that tests run and that have something to test.")
    judged_of_change: int = field("Those that the change touches.")
    functions: tuple[PseudoTestedFunction, ...] = field("The pseudo-tested ones.")
    unjudged: tuple[UnjudgedFunction, ...] = field("Those that it is not known of.")
    failing: tuple[str, ...] = field("Tests that do not pass in a copy of the checkout, and judge nothing.")
    seconds: float = field("How long it took.")

    @property
    @computed()
    def found_in_change(self) -> int:
        """Number of pseudo-tested functions that the change touches."""
        return sum(each.changed for each in self.functions)


@dataclass
class Recording:
    """What was seen of the functions while the tests ran without any change."""

    entered: dict[int, set[str]] = dataclass_field(default_factory=lambda: defaultdict(set))
    """Tests by the function that they run."""
    at_import: set[int] = dataclass_field(default_factory=set)
    """Functions that are run before the tests."""
    outcomes: dict[str, str] = dataclass_field(default_factory=dict)
    seconds: dict[str, float] = dataclass_field(default_factory=dict)
    gave: dict[int, dict[str, tuple[tuple[str, ...], set[str]]]] = dataclass_field(
        default_factory=lambda: defaultdict(dict)
    )
    """By function and type: constants of the type, and the expressions of what was given."""
    arguments: dict[int, set[tuple[str, ...]]] = dataclass_field(default_factory=lambda: defaultdict(set))
    """Types of the arguments of calls."""

    def read(self, path: Path, tests: Sequence[str]) -> None:
        """Read the record; what the tests may have damaged is left out."""
        contexts: dict[str, set[str]] = {test: {test} for test in tests}
        entered = []
        for line in read_bytes(path, MAX_RECORD_BYTES, "the record of the tests").splitlines():
            try:
                match json.loads(line):
                    case ["entered", int() as function, str() | None as context]:
                        entered.append((function, context))
                    case ["context", str() as context, list() as its]:
                        contexts.setdefault(context, set()).update(map(str, its))
                    case ["outcome", str() as test, str() as outcome, float() as seconds]:
                        self.outcomes[test] = outcome
                        self.seconds[test] = seconds
                    case ["gave", int() as function, str() as kind, list() as constants, str() as shown]:
                        known = self.gave[function].setdefault(kind, (tuple(map(str, constants)), set()))
                        known[1].add(shown)
                    case ["arguments", int() as function, list() as kinds]:
                        self.arguments[function].add(tuple(map(str, kinds)))
            except (ValueError, RecursionError):
                continue
        for function, context in entered:
            if context is None:
                self.at_import.add(function)
            else:
                self.entered[function] |= contexts.get(context, set())

    def replacements(self, number: int, function: PythonFunction) -> list[Replacement]:
        """Return what takes the place of a function's body: what differs from all that it gave, and is of its type."""
        gave = self.gave.get(number, {})
        found = []
        for kind, (constants, shown) in gave.items():
            if constants:
                differs = len(gave) > 1 or kind == "builtins.NoneType"
                found += [Replacement(value) for value in constants if differs or shown != {value}]
            else:
                columns = zip(function.parameters, zip(*self.arguments.get(number, ()), strict=False), strict=False)
                same = [Replacement(argument=index) for index, (_, kinds) in enumerate(columns) if set(kinds) == {kind}]
                found += same or ([] if function.generator else [Replacement()])
        if function.generator and not set(function.decorators) & {"contextmanager", "asynccontextmanager", "fixture"}:
            found.append(Replacement(nothing=True))
        found = found if gave or function.generator else [Replacement()]
        if not function.fields:
            return found
        return [replace(each, fields=function.fields, field=value) for each in found for value in VALUES_OF_FIELDS]


@dataclass
class Investigation:
    """Functions under investigation, and what was found."""

    functions: Sequence[PythonFunction]
    changed: frozenset[int]
    """Numbers of the functions that the change touches."""
    record: Path
    tests: tuple[str, ...] = ()
    recording: Recording = dataclass_field(default_factory=Recording)
    found: list[PseudoTestedFunction] = dataclass_field(default_factory=list)
    unjudged: list[UnjudgedFunction] = dataclass_field(default_factory=list)
    judged: list[int] = dataclass_field(default_factory=list)
    left: set[int] = dataclass_field(default_factory=set)
    """Functions that are not judged."""
    _alone: dict[str, bool] = dataclass_field(default_factory=dict)
    """Whether a test passes alone without any change."""

    def recorded(self, worker: TestWorker, seconds: float) -> Judging:
        """Record the tests."""
        outcome = yield TestJob((), seconds, record=self.record, from_start=True)
        self.tests = worker.tests
        if self.record.exists():
            self.recording.read(self.record, self.tests)
        if not outcome.passed:
            name = next((test for test in self.tests if test not in self.recording.outcomes), "")
            raise InputError(
                f"pseudo-tested: the tests do not come to their end in a copy of the checkout: not {shorten(name)}"
            )
        if not self.passing:
            names = ", ".join(self.tests[:3])
            raise InputError(f"pseudo-tested: no test passes in a copy of the checkout ({shorten(one_line(names))})")

    @cached_property
    def passing(self) -> set[str]:
        """Tests that pass, once they are recorded."""
        return {test for test, outcome in self.recording.outcomes.items() if outcome == "passed"}

    def order(self) -> list[int]:
        """Return the functions that passing tests run: those of the change first, then the quickest."""

        def cost(number: int) -> tuple[bool, bool, float]:
            at_import = number in self.recording.at_import
            return number not in self.changed, at_import, self._seconds(self._tests_of(number))

        return sorted((number for number in range(len(self.functions)) if self._tests_of(number)), key=cost)

    def judgement(self, number: int) -> Judging:
        """Judge a function by one replacement after the other, until a test fails."""
        function, tests = self.functions[number], set(self._tests_of(number))
        replacements = self.recording.replacements(number, function)
        for replacement in replacements:
            while tests:
                chosen = tuple(test for test in self.tests if test in tests)
                at_import = number in self.recording.at_import
                seconds = SECONDS_OF_JOB + MAX_SLOWDOWN * self._seconds(chosen)
                outcome = yield TestJob(chosen, seconds, number, replacement, from_start=at_import)
                if outcome.passed:
                    break
                if outcome.test is None or (yield from self._passes_alone(outcome.test)):
                    self.judged.append(number)
                    return
                tests.discard(outcome.test)
        if not tests:
            self.leave(number, "its tests fail when they are run alone")
            return
        self.judged.append(number)
        if replacements:
            its = sorted(tests & self.recording.entered[number])
            texts = tuple(dict.fromkeys(_text_of(each, function) for each in replacements))
            changed = number in self.changed
            self.found.append(
                PseudoTestedFunction(function.path, function.line, function.name, changed, texts, tuple(its))
            )

    def leave(self, number: int, reason: str) -> None:
        """Note that a function is not judged."""
        function = self.functions[number]
        changed = number in self.changed
        self.left.add(number)
        self.unjudged.append(UnjudgedFunction(function.path, function.line, function.name, changed, reason))

    def results(self, seconds: float) -> PseudoTestedResults:
        """Return what was found."""
        return PseudoTestedResults(
            len(self.judged),
            len(self.changed.intersection(self.judged)),
            tuple(sorted(self.found, key=lambda each: (not each.changed, each.path, each.line))),
            tuple(sorted(self.unjudged, key=lambda each: (not each.changed, each.path, each.line))),
            tuple(test for test in self.tests if self.recording.outcomes.get(test) not in ("passed", "skipped")),
            round(seconds, 3),
        )

    def _tests_of(self, number: int) -> set[str]:
        """Return the passing tests that run a function; all of them where a call need not run it, or an import does."""
        its = self.recording.entered.get(number, set()) & self.passing
        everywhere = number in self.recording.at_import or set(self.functions[number].decorators) & set(CACHES)
        return self.passing if its and everywhere else its

    def _seconds(self, tests: Iterable[str]) -> float:
        return sum(self.recording.seconds.get(test, 0.0) for test in tests)

    def _passes_alone(self, test: str) -> Generator[TestJob, JobOutcome, bool]:
        if test not in self._alone:
            seconds = SECONDS_OF_JOB + MAX_SLOWDOWN * self._seconds([test])
            self._alone[test] = (yield TestJob((test,), seconds)).passed
        return self._alone[test]


def _text_of(replacement: Replacement, function: PythonFunction) -> str:
    """Return what is done in place of a function's body, for people."""
    if replacement.nothing:
        return "yields nothing"
    verb = "yields" if function.generator else "returns"
    if replacement.argument is not None:
        return f"{verb} its argument {function.parameters[replacement.argument]}"
    return f"{verb} {replacement.value}"


def find_pseudo_tested(
    functions: Sequence[PythonFunction],
    changed: frozenset[int],
    command: CommandOfTests,
    sources: Sources,
    seconds: float,
    output: Path,
    runner: Runner,
    secrets: Iterable[str] = (),
) -> PseudoTestedResults:
    """Find the functions whose tests pass also when their body is replaced.

    Args:
        functions: those to judge.
        changed: numbers of those that the change touches, which come first.
        command: the command of the tests, which passes.
        sources: the checkout, and where the tests run in it.
        seconds: budget of time; functions that it does not suffice for are left unjudged.
        output: folder of the log, which is no part of the copies.
        runner: for the log.
        secrets: values to mask in the log.

    Raises:
        InputError: the tests cannot be run in a copy of the checkout.
        InfrastructureError: the budget does not suffice for running the tests once, or the checkout cannot be copied.
    """
    begin = time.monotonic()
    deadline = begin + seconds
    with ExitStack() as stack:
        # Sockets have short names: the folder of the system, not that of TMPDIR, which may be deep.
        folder = stack.enter_context(temporary_folder(parent="/tmp", ignore_cleanup_errors=True))  # noqa: S108
        selector = stack.enter_context(selectors.DefaultSelector())
        log = stack.enter_context(LogFile(output / LOG_FILE, secrets, lambda _line: None))
        count = min(os.cpu_count() or 1, MAX_WORKERS, max(len(functions), 1))
        workers = []
        for number in range(count):
            place = folder / str(number)
            copy_of_checkout(sources.repository.root, place / "copy", output.absolute())
            (place / "tmp").mkdir()
            _write_plan(place, sources, functions)
            directory = place / "copy" / sources.directory.resolve().relative_to(sources.repository.root.resolve())
            worker = TestWorker(
                command.arguments, directory, _environment(place), place / SOCKET_FILE, selector, log.feed
            )
            workers.append(worker)
            stack.callback(worker.close)
        investigation = Investigation(functions, changed, folder / "record")
        for worker in workers[1:]:
            worker.prepare()
        recording = investigation.recorded(workers[0], seconds)
        if not run_on(workers, [recording], deadline, selector):
            raise InfrastructureError(
                f"pseudo-tested: one run of the tests took longer than {seconds:g} s (pseudo-tested-budget)"
            )
        order = investigation.order()
        runner.log(
            f"pseudo-tested: {len(order)} functions are replaced, one after the other, and their tests run in copies "
            "of the checkout (home folder, absolute paths, servers and network are not isolated)"
        )
        if not run_on(workers, map(investigation.judgement, order), deadline, selector):
            decided = {*investigation.judged, *investigation.left}
            for number in order:
                if number not in decided:
                    investigation.leave(number, OVER_BUDGET)
        for worker in workers[1:]:
            worker.close()
        workers[0].finish(MAX_SECONDS_TO_FINISH)
    return investigation.results(time.monotonic() - begin)


def _write_plan(place: Path, sources: Sources, functions: Sequence[PythonFunction]) -> None:
    """Write what a process of the tests needs to know: which functions, by the content of their files."""
    root = sources.repository.root
    places: dict[str, list[tuple[int, int, int]]] = defaultdict(list)
    for number, function in enumerate(functions):
        digest = hashlib.sha256((root / function.path).read_bytes()).hexdigest()
        places[digest].append((number, function.line, function.column))
    names = sorted({PurePosixPath(function.path).name for function in functions})
    plan = {"root": str(root), "copy": str(place / "copy"), "names": names, "sources": places}
    (place / PLAN_FILE).write_text(json.dumps(plan))


def _environment(place: Path) -> dict[str, str]:
    kept = plain(os.environ)
    join = os.pathsep.join
    return {
        **kept,
        "PYTHONPATH": join(filter(None, [str(INJECTED_FOLDER), kept.get("PYTHONPATH")])),
        "PYTEST_PLUGINS": ",".join(filter(None, ["calibration_pseudo_pytest", kept.get("PYTEST_PLUGINS")])),
        "CALIBRATION_PSEUDO_PLAN": str(place / PLAN_FILE),
        "CALIBRATION_PSEUDO_SOCKET": str(place / SOCKET_FILE),
        "TMPDIR": str(place / "tmp"),
    }
