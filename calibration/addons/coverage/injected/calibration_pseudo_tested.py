"""Runs tests with one function replaced, in the Python of the tests, for ``pseudo_tested.py``.

Every Python process of the tests compiles the functions in question with questions in them: on entry whether the
function is replaced, at each return and yield what it gives. While the tests are recorded, the answers tell which test
runs which function. The process that would run the tests (of pytest, or of unittest) collects them, and then waits at a
socket for jobs: it forks for each, so that a job costs neither a start of Python nor imports nor a collection.

Runs in the Python of the team's tests, whichever version that is (3.8 and newer).
"""

# mypy: ignore-errors
# ruff: noqa: D102, N815, PTH112, PTH118, PTH119, PTH123, PTH208, S307, SIM105, UP031

import ast
import builtins
import hashlib
import importlib.machinery
import json
import os
import signal
import socket
import sys
import tempfile
import time

PLAN, JOB, TEST = "CALIBRATION_PSEUDO_PLAN", "CALIBRATION_PSEUDO_JOB", "CALIBRATION_PSEUDO_TEST"
"""Environment variables: file of the plan; what a process does with the functions; the test that started it."""
SOCKET = "CALIBRATION_PSEUDO_SOCKET"
"""Environment variable: the socket at which jobs arrive; unset in processes that tests start."""
MAX_EXAMINED = 64
"""Calls of a function whose arguments and results are looked at."""
MAX_VALUES = 2
"""Different results of one type that are noted."""
MORE_MEMORY = 4 << 30
"""Bytes that a job may take more than the process that it is forked from."""
PR_SET_CHILD_SUBREAPER = 36
"""Linux's prctl option by which a process becomes the parent of what its descendants leave behind."""
FINISHED = 17
"""Exit code of a job whose tests have passed; a test that ends its process has another one."""
_SCALARS = {
    bool: ("False", "True"),
    int: ("0", "1"),
    float: ("0.0", "1.0"),
    complex: ("0j", "1j"),
    str: ("''", "'calibration'"),
    bytes: ("b''", "b'calibration'"),
    type(None): ("None",),
}
_claimed = False
"""Whether this process serves jobs already: tests of a test runner run one within a job."""


class Recorder:
    """Notes which test runs which function, and what the functions give."""

    def __init__(self, path):
        self.path = path
        self.test = os.environ.get(TEST)
        self._known = set()
        self._examined = {}
        self._write, self._open, self._close = os.write, os.open, os.close  # tests may replace those of the module

    def enter(self, function, arguments):
        if (function, self.test) not in self._known:
            self._known.add((function, self.test))
            self.note("entered", function, self.test)
        count = self._examined.get(function, 0)
        if count < MAX_EXAMINED:
            self._examined[function] = count + 1
            key = ("arguments", function, tuple([_type_name(each) for each in arguments]))
            if key not in self._known:
                self._known.add(key)
                self.note(*key)
        return False

    def give(self, function, value):
        if self._examined.get(function, 0) < MAX_EXAMINED:
            name, constants = _type_name(value), _constants(value)
            shown = _shown(value, constants)
            values = self._examined.setdefault((function, name), set())
            if shown not in values and len(values) < MAX_VALUES:
                values.add(shown)
                self.note("gave", function, name, constants, shown[:1000])
        return value

    def run_in(self, test):
        """Set the test, or the context of several, that what is run from now on belongs to."""
        self.test = test
        if test is None:
            os.environ.pop(TEST, None)
        else:
            os.environ[TEST] = test

    def note(self, *fields):
        line = json.dumps(fields).encode() + b"\n"
        descriptor = self._open(self.path, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o600)
        self._write(descriptor, line)
        self._close(descriptor)


recorder = None
"""The recorder of this process, while it records."""


def start():
    """Compile the functions of the plan with their questions from now on, and serve jobs where tests would run."""
    with open(os.environ[PLAN]) as file:
        plan = json.load(file)
    _use_copy(plan["root"], plan["copy"])
    sources = {
        digest: {(line, column): number for number, line, column in places}
        for digest, places in plan["sources"].items()
    }
    names = set(plan["names"])
    take(json.loads(os.environ.get(JOB, "{}")))
    loader = importlib.machinery.SourceFileLoader
    plain_code, plain_exec = loader.get_code, loader.exec_module

    def get_code(self, fullname):
        path = self.get_filename(fullname)
        if os.path.basename(path) in names:
            source = self.get_data(path)
            places = sources.get(hashlib.sha256(source).hexdigest())
            if places:
                return compile(_Questions(places).visit(ast.parse(source, path)), path, "exec", dont_inherit=True)
        return plain_code(self, fullname)

    def exec_module(self, module):
        plain_exec(self, module)
        if module.__name__ == "unittest.runner":
            _serve_unittest(module)

    loader.get_code, loader.exec_module = get_code, exec_module


def _use_copy(root, copy):
    """Import from the copy what an installation in place (pip install -e) imports from the checkout."""
    for index, entry in enumerate(sys.path):
        inside = os.path.join(copy, os.path.relpath(entry, root))
        if entry and (entry == root or entry.startswith(root + os.sep)) and os.path.isdir(inside):
            sys.path[index] = inside


def take(job):
    """Record, or replace a function, in this process and in those that it starts."""
    global recorder
    recorder = None
    os.environ[JOB] = json.dumps({key: job[key] for key in ("record", "function", "replacement") if key in job})
    builtins.__calibration_entered__ = lambda function, arguments: False
    builtins.__calibration_given__ = lambda function, value: value
    if "record" in job:
        recorder = Recorder(job["record"])
        builtins.__calibration_entered__ = recorder.enter
        builtins.__calibration_given__ = recorder.give
    elif "function" in job:
        replaced, replacement = job["function"], job["replacement"]

        def value(arguments):
            for name in replacement["fields"]:  # else a test that only reads one back fails by its absence
                if not hasattr(arguments[0], name):
                    setattr(arguments[0], name, eval(replacement["field"]))
            if replacement["argument"] is not None:
                return arguments[replacement["argument"]]
            return eval(replacement["value"])

        builtins.__calibration_entered__ = lambda function, arguments: function == replaced
        builtins.__calibration_value__ = value
        builtins.__calibration_yields__ = lambda arguments: (value(arguments),)[: not replacement["nothing"]]


class _OwnYields(ast.NodeVisitor):
    """Finds whether a function is a generator."""

    def __init__(self):
        self.found = False

    def visit_Yield(self, node):
        self.found = True

    visit_YieldFrom = visit_Yield

    def visit_FunctionDef(self, node):
        pass

    visit_AsyncFunctionDef = visit_Lambda = visit_ClassDef = visit_FunctionDef


class _Given(ast.NodeTransformer):
    """Wraps what a function returns, or yields."""

    def __init__(self, number, generator):
        self._number = number
        self._generator = generator

    def _wrapped(self, value):
        call = ast.parse("__calibration_given__(%d, None)" % self._number, mode="eval").body
        if value is not None:
            call.args[1] = value
        return call

    def visit_Return(self, node):
        self.generic_visit(node)
        if not self._generator:
            node.value = self._wrapped(node.value)
        return node

    def visit_Yield(self, node):
        self.generic_visit(node)
        node.value = self._wrapped(node.value)
        return node

    def visit_FunctionDef(self, node):
        return node

    visit_AsyncFunctionDef = visit_Lambda = visit_ClassDef = visit_FunctionDef


class _Questions(ast.NodeTransformer):
    """Puts the questions into the functions."""

    def __init__(self, places):
        self._places = places

    def visit_FunctionDef(self, node):
        number = self._places.get((node.lineno, node.col_offset))
        if number is not None:
            own = _OwnYields()
            for statement in node.body:
                own.visit(statement)
            given = _Given(number, own.found)
            last = ast.parse("" if own.found else "return __calibration_given__(%d, None)" % number).body
            body = [given.visit(statement) for statement in node.body] + last
            documented = int(ast.get_docstring(node, clean=False) is not None)
            node.body = [*body[:documented], _first_question(node, number, own.found), *body[documented:]]
            ast.fix_missing_locations(node)
        self.generic_visit(node)
        return node

    visit_AsyncFunctionDef = visit_FunctionDef


def _first_question(node, number, generator):
    given = node.args
    names = [
        each.arg for each in [*given.posonlyargs, *given.args, given.vararg, *given.kwonlyargs, given.kwarg] if each
    ]
    arguments = "(%s)" % "".join(name + ", " for name in names)
    answer = "return __calibration_value__(%s)" % arguments
    if generator:
        answer = (
            "for __calibration_each__ in __calibration_yields__(%s): yield __calibration_each__\n return" % arguments
        )
    question = ast.parse("if __calibration_entered__(%d, %s):\n %s" % (number, arguments, answer)).body[0]
    for each in ast.walk(question):
        if hasattr(each, "lineno"):
            each.lineno = each.end_lineno = node.body[0].lineno
    return question


def _type_name(value):
    return "%s.%s" % (type(value).__module__, type(value).__qualname__)


def _constants(value):
    """Return expressions of constants of a value's type; none where only other values tell what it is made of."""
    kind = type(value)
    if kind in _SCALARS:
        return _SCALARS[kind]
    if kind is tuple:
        parts = [_constants(each) for each in value[:20]]
        if not all(parts) or len(value) > 20:
            return ("()",)
        return tuple(dict.fromkeys("(%s)" % "".join(part[end] + ", " for part in parts) for end in (0, -1)))
    if kind is list:
        first = _constants(value[0])[:1] if value else ()
        return ("[]", *("[%s]" % each for each in first))
    if kind in (dict, set, frozenset):
        return ("%s()" % kind.__name__,)
    if _type_name(value) == "numpy.ndarray" and value.dtype.kind in "biufc":
        return tuple(
            "__import__('numpy').%s(%r, %r)" % (name, value.shape, value.dtype.str) for name in ("zeros", "ones")
        )
    return ()


def _shown(value, constants):
    """Return the expression of a value as `_constants` writes it; empty for what none of them can equal."""
    kind = type(value)
    if kind in _SCALARS:
        return repr(value)
    if kind is tuple:
        parts = [_shown(each, _constants(each)) for each in value[:20]]
        return "(%s)" % "".join(part + ", " for part in parts) if all(parts) else ""
    if constants and (not value.any() if hasattr(value, "any") else not value):
        return constants[0]
    return ""


def claim():
    """Return whether this process is to serve jobs, which is so once."""
    global _claimed
    before, _claimed = _claimed, True
    return not before and SOCKET in os.environ


def serve(tests, runner, run):
    """Run jobs until there are no more.

    Args:
        tests: names of all tests, in their order.
        runner: pytest or unittest.
        run: called in a forked process with a job and what is to be called with the name of a test that fails.
    """
    with socket.socket(socket.AF_UNIX) as connection:
        connection.connect(os.environ.pop(SOCKET))
        descriptor = connection.fileno()

        def tell(message):
            data = json.dumps(message).encode() + b"\n"
            while data:
                data = data[os.write(descriptor, data) :]

        adopts = _adopt_orphans()
        own = _children() if adopts else ()
        tell({"tests": tests, "runner": runner})
        with open(descriptor, "rb", closefd=False) as lines:
            for line in lines:
                passed = _fork(json.loads(line), run, tell)
                if adopts:
                    _end_orphans(own)
                tell({"ended": passed})


def _adopt_orphans():
    """Become the parent of what jobs leave behind in sessions of their own; return whether the system can do that."""
    try:
        import ctypes

        return ctypes.CDLL(None).prctl(PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0) == 0
    except (ImportError, OSError, AttributeError):
        return False


def _children():
    """Return the processes that this one is the parent of."""
    found = set()
    for name in filter(str.isdigit, os.listdir("/proc")):
        try:
            with open("/proc/%s/stat" % name, "rb") as file:
                parent = int(file.read().rpartition(b")")[2].split()[1])
        except OSError:  # it has ended
            continue
        if parent == os.getpid():
            found.add(int(name))
    return found


def _end_orphans(own):
    """Kill what a job has left behind, and what that leaves in turn; not the children that were there before it."""
    while True:
        try:
            os.waitid(os.P_ALL, 0, os.WEXITED | os.WNOHANG | os.WNOWAIT)
        except ChildProcessError:
            return
        orphans = _children().difference(own)
        if not orphans:
            return
        for orphan in orphans:
            os.kill(orphan, signal.SIGKILL)
            os.waitpid(orphan, 0)


def _fork(job, run, tell):
    """Run a job in a process group of its own; return whether it has come to its end without a test that fails."""
    sys.stdout.flush()
    sys.stderr.flush()
    wait, go = os.pipe()
    child = os.fork()
    if not child:
        code = 1
        try:
            os.close(go)
            if os.read(wait, 1):
                _run_job(job, run, tell)
                code = FINISHED
        except BaseException:
            sys.excepthook(*sys.exc_info())
        finally:
            os._exit(code)
    os.close(wait)
    try:
        os.setpgid(child, child)
        tell({"child": child})
        os.write(go, b"1")
    finally:
        os.close(go)
    if hasattr(os, "waitid"):
        os.waitid(os.P_PID, child, os.WEXITED | os.WNOWAIT)  # it keeps the number of its group until it is reaped
        try:
            os.killpg(child, signal.SIGKILL)
        except OSError:
            pass
    return os.waitpid(child, 0)[1] == FINISHED << 8


def _run_job(job, run, tell):
    _limit_memory()
    folder = tempfile.mkdtemp()
    os.environ["TMPDIR"] = tempfile.tempdir = folder
    take(job)

    def fail(test):
        if "record" not in job:
            tell({"failed": test})
            os._exit(1)

    run(job["tests"], fail)


def _limit_memory():
    try:
        import resource

        with open("/proc/self/statm") as file:
            used = int(file.read().split()[0]) * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_DATA, (used + MORE_MEMORY, resource.getrlimit(resource.RLIMIT_DATA)[1]))
    except (ImportError, OSError, ValueError):  # not on Linux, or a lower limit is set
        pass


def _serve_unittest(module):
    plain_run = module.TextTestRunner.run

    def run(self, test):
        if not claim():
            return plain_run(self, test)
        cases = list(_flat(test))
        serve([case.id() for case in cases], "unittest", lambda names, fail: _run_unittest(cases, set(names), fail))
        return self._makeResult()

    module.TextTestRunner.run = run


def _flat(test):
    try:
        parts = iter(test)
    except TypeError:
        yield test
        return
    for part in parts:
        yield from _flat(part)


def _run_unittest(cases, names, fail):
    import unittest

    chosen = [case for case in cases if case.id() in names]
    modules = {}
    for case in chosen:
        modules.setdefault(type(case).__module__, []).append(case.id())
    following = iter([type(case).__module__ for case in chosen[1:]])

    def run_around(module):
        """What runs between tests (setUpClass, setUpModule) belongs to all tests of the module."""
        if recorder:
            recorder.run_in("around " + module)

    class Result(unittest.TestResult):
        def startTest(self, test):
            super().startTest(test)
            self.begin, self.outcome = time.monotonic(), "passed"
            if recorder:
                recorder.run_in(test.id())

        def stopTest(self, test):
            super().stopTest(test)
            if recorder:
                recorder.note("outcome", test.id(), self.outcome, time.monotonic() - self.begin)
            run_around(next(following, type(test).__module__))

        def addError(self, test, error):
            self.outcome = "failed"
            fail(test.id())

        addFailure = addError

        def addSubTest(self, test, subtest, error):
            if error is not None:
                self.addError(test, error)

        def addUnexpectedSuccess(self, test):
            self.outcome = "failed"
            fail(test.id())

        def addSkip(self, test, reason):
            super().addSkip(test, reason)
            self.outcome = "skipped"

    if recorder:
        for module, its in modules.items():
            recorder.note("context", "around " + module, its)
    if chosen:
        run_around(type(chosen[0]).__module__)
        unittest.TestSuite(chosen).run(Result())
