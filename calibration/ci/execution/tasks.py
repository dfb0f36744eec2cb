"""Tasks, and the loop that runs them: functions in processes, jobs in containers.

A task is named work: a function, or a job of containers whose files are judged in this process. The loop reuses
finished results, runs the remaining tasks on the backends, reports the progress, and stops everything when it is
interrupted or a result demands it. A `Workspace` preserves finished results: it is the folder ``.unfinished``
inside the output, which may be a separate volume. It survives an interruption, and the same command continues from it.
"""

import ctypes
import errno
import fcntl
import hashlib
import json
import mmap
import multiprocessing
import os
import shutil
import signal
import sys
import time
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import ExitStack, closing, contextmanager, suppress
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from queue import SimpleQueue
from typing import Any, Generic, Self, TypeVar
from urllib.parse import quote

from calibration.base import ExitCode, InfrastructureError, InputError, write_atomically, writing
from calibration.base.process import held_back
from calibration.ci.execution.backends import Backend, ExecutionTarget
from calibration.ci.execution.job import Job
from calibration.ci.execution.outcome import JobOutcome

Result = TypeVar("Result")

PR_SET_PDEATHSIG = 1
"""Linux's prctl option for a signal when the parent dies."""
POOL_THREADS_BYTES = 64 << 20
"""Bytes of address space: the stacks of the pool's two threads (8 MB each), their heaps, and some more."""
BATCH_SECONDS = 0.03
"""Seconds of work in a batch, the functions that a worker is sent at once; after a signal it finishes its batch."""
MOST_IN_BATCH = 16
"""Most functions in a batch: one worker may have the last batch while the others have nothing left to do."""
_work: Sequence[Callable[[], Any]] = ()
"""The functions to call, set in a worker only: inherited from the parent with the data that they reference."""
Other = TypeVar("Other")


def in_processes(work: Sequence[Callable[[], Result]], workers: int) -> Generator[tuple[int, Result]]:
    """Call each function in a worker process; see `calibration.ci.execution.tasks.Embedded.run`."""
    with single_threaded_opencv():
        yield from _in_forked_processes(work, workers)


def _in_forked_processes(work: Sequence[Callable[[], Result]], workers: int) -> Generator[tuple[int, Result]]:
    _require_room_for_threads()
    context = multiprocessing.get_context("fork")
    pool = ProcessPoolExecutor(workers, context, initializer=_initialise_worker, initargs=(work, os.getpid()))
    try:
        # A queue, because a signal may interrupt waiting on it: waiting on futures holds locks that the
        # pool's own thread needs to end.
        finished: SimpleQueue[Future[list[Result]]] = SimpleQueue()
        running: dict[Future[list[Result]], tuple[int, ...]] = {}
        waiting = iter(range(len(work)))
        pace = _Pace(workers)

        def submit() -> None:
            if batch := tuple(islice(waiting, pace.batch_size())):
                with held_back():  # the first submission forks the workers
                    future = pool.submit(_run_in_worker, batch)
                running[future] = batch
                future.add_done_callback(finished.put)

        for _ in range(4 * workers):
            submit()
        while running:
            future = finished.get()
            batch = running.pop(future)
            pace.finished += len(batch)
            submit()
            yield from zip(batch, future.result(), strict=True)
    except BrokenProcessPool as error:
        message = "a worker process died (killed, or out of memory); try fewer with jobs"
        raise InfrastructureError(message) from error
    finally:
        # Workers finish their current batch, also after a signal: one that is killed while it writes its result
        # leaves a partial message in the pipe, and the pool would wait for the rest. A second signal is delayed too:
        # an interrupted shutdown leaves workers running, and Python would wait for them at exit.
        with held_back():
            pool.shutdown(wait=True, cancel_futures=True)


@contextmanager
def single_threaded_opencv() -> Iterator[None]:
    """Limit OpenCV, where it is loaded, to one thread: its threads do not survive a fork, OpenCV 5 waits for them."""
    cv2 = sys.modules.get("cv2")
    if cv2 is None:
        yield
        return
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(threads)


class _Pace:
    """Pace of the workers, by which batches are sized: sending takes as long as a cell of a small matrix."""

    def __init__(self, workers: int) -> None:
        """Begin measuring so many workers."""
        self._workers, self._initialise_worker = workers, time.monotonic()
        self.finished = 0
        """Number of functions that have returned."""

    def batch_size(self) -> int:
        """Return how many functions take about `BATCH_SECONDS`, by the mean time so far; 1 before any has returned."""
        if not self.finished:
            return 1
        seconds = (time.monotonic() - self._initialise_worker) * self._workers / self.finished
        return MOST_IN_BATCH if seconds * MOST_IN_BATCH < BATCH_SECONDS else max(1, int(BATCH_SECONDS / seconds))


def _require_room_for_threads() -> None:
    """Check the memory for the pool's own threads: without them the workers would never receive a request to end.

    Raises:
        MemoryError: the free memory is less than the stacks of these threads.
    """
    try:
        mmap.mmap(-1, POOL_THREADS_BYTES).close()
    except OSError:
        raise MemoryError from None


def _initialise_worker(work: Sequence[Callable[[], Any]], parent: int) -> None:
    """Initialise a worker: the parent handles signals; if it is killed, the worker is killed too."""
    global _work
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:  # it was killed before the worker could ask for the signal
        os._exit(ExitCode.INFRASTRUCTURE)
    _work = work


def _run_in_worker(batch: Sequence[int]) -> list[Any]:
    return [_work[index]() for index in batch]


def cores() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class Embedded:
    """Runs functions in worker processes of this machine; a :class:`calibration.ci.execution.backends.Backend`.

    Workers are forked, so functions may be closures, whose data they inherit. Return values must be
    picklable. Exceptions of a function are raised here.
    """

    def run(
        self, work: Sequence[Callable[[], Result]], folder: Path = Path(), workers: int | None = None
    ) -> Generator[tuple[int, Result]]:
        """Call each function; yield index and return value, in the order of completion.

        Functions are started in order. All processes have ended when this returns, also after an interruption.

        Args:
            work: the functions.
            folder: ignored.
            workers: number of processes; None for one per core, 1 for the current process only.

        Raises:
            InfrastructureError: a process died.
        """
        count = min(workers or cores(), len(work))
        if count > 1:
            yield from in_processes(work, count)
        else:
            for index, function in enumerate(work):
                yield index, function()


@dataclass(frozen=True, eq=False)
class Task(Generic[Result]):
    """Named work: a function or a job of containers, and the function that judges its outcome."""

    name: str
    """Unique among the tasks of a run."""
    work: Callable[[], Any] | Job
    """A function, which a worker process inherits with the data that it references; or a job of containers."""
    judge: Callable[[Any], Result]
    """Converts the function's picklable return value, or the job's outcome, to the result; runs in this process.
    A failure of a single task is part of its result."""

    @classmethod
    def call(cls, name: str, function: Callable[[], Result]) -> Self:
        """Create a task from a function."""
        return cls(name, function, _as_it_is)

    @classmethod
    def containers(cls, name: str, job: Job, judge: Callable[[JobOutcome], Result]) -> Self:
        """Create a task from a job of containers."""
        return cls(name, job, judge)

    def then(self, change: Callable[[Result], Other]) -> "Task[Other]":
        """Return the task with a function applied to its result, in the process that creates the result."""
        work, judge = self.work, self.judge
        if isinstance(work, Job):
            return Task(self.name, work, lambda outcome: change(judge(outcome)))
        function = work
        return Task(self.name, lambda: change(judge(function())), _as_it_is)


def run_tasks(
    tasks: Sequence[Task[Result]],
    folder: Path = Path(),
    workers: int | None = None,
    target: ExecutionTarget | None = None,
    find: Callable[[str], Result | None] = lambda _: None,
    done: Callable[[int, int, Result], None] = lambda *_: None,
    stops: Callable[[str, Result], bool] = lambda *_: False,
) -> dict[str, Result]:
    """Run tasks: functions first, in order, then jobs.

    An exception in a callback, or a signal, stops and removes everything that was started.

    Args:
        tasks: tasks to run.
        folder: folder that contains the jobs' folders.
        workers: number of concurrent processes, or jobs; None for the capacity of the machine.
        target: execution target of jobs; by default this machine's engine.
        find: returns the finished result of a task of an earlier run, by name.
        done: called after each task with the number of finished tasks, the total, and the result; starts with
            the results of earlier runs.
        stops: returns whether a task's result stops the others, by the task's name.

    Returns:
        Results by task name, in the order of the tasks, without stopped tasks.

    Raises:
        InputError: a job is invalid, or an image is missing; nothing has been run.
        InfrastructureError: a process died, or the execution target cannot be reached.
        CalibrationError: error of a function.
    """
    found = {task.name: kept for task in tasks if (kept := find(task.name)) is not None}
    for count, kept in enumerate(found.values()):
        done(count + 1, len(tasks), kept)
    missing = [task for task in tasks if task.name not in found]
    jobs = [task for task in missing if isinstance(task.work, Job)]
    functions = [task for task in missing if not isinstance(task.work, Job)]
    with ExitStack() as stack:
        backends: list[tuple[Backend[Any, Any], list[Task[Result]]]] = [(Embedded(), functions)]
        if jobs:  # connect before long work, because there may be no engine
            backends.append((stack.enter_context((target or ExecutionTarget()).open()), jobs))
        running = [
            (stack.enter_context(closing(backend.run([task.work for task in some], folder, workers))), some)
            for backend, some in backends
        ]
        for outcomes, some in running:
            for index, outcome in outcomes:
                task = some[index]
                found[task.name] = task.judge(outcome)
                done(len(found), len(tasks), found[task.name])
                if stops(task.name, found[task.name]):
                    return _in_order(tasks, found)
    return _in_order(tasks, found)


def _in_order(tasks: Sequence[Task[Result]], found: dict[str, Result]) -> dict[str, Result]:
    return {task.name: found[task.name] for task in tasks if task.name in found}


def _as_it_is(result: Result) -> Result:
    return result


_NO_LOCKS = (errno.EBADF, errno.EINVAL, errno.ENOLCK, errno.ENOTSUP)
"""What file systems say that cannot lock a folder, such as NFS; there nothing is locked."""


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Lock a folder during the block; the lock is gone too when this process was killed.

    The folder and those above are created where they are missing, and removed again if they stay empty.

    Raises:
        InputError: another run uses this folder.
        InfrastructureError: the folder cannot be created or read.
    """
    made = [path for path in (folder, *folder.parents) if not path.exists()]
    try:
        descriptor = _locked_descriptor(folder)
    except BaseException:
        _remove_empty(made)
        raise
    try:
        yield
    finally:
        _remove_empty(made)  # under the lock: else another run may have locked the folder that is removed
        os.close(descriptor)


def _remove_empty(folders: Sequence[Path]) -> None:
    for path in folders:
        with suppress(OSError):  # not empty, or not created
            path.rmdir()


def _locked_descriptor(folder: Path) -> int:
    """Return an open descriptor of a folder, which is locked until it is closed."""
    while True:
        try:
            folder.mkdir(parents=True, exist_ok=True)
            descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
        except (FileExistsError, NotADirectoryError):
            raise InfrastructureError(f"{folder}: cannot be written: it, or a folder above it, is a file") from None
        except FileNotFoundError:
            continue  # another run has just removed it
        except OSError as error:
            raise InfrastructureError(f"{folder}: cannot be written: {error.strerror}") from error
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(descriptor)
            raise InputError(f"{folder}: another run uses this folder; wait for it, or stop it") from None
        except OSError as error:
            if error.errno not in _NO_LOCKS:
                os.close(descriptor)
                raise InfrastructureError(f"{folder}: cannot be locked: {error.strerror}") from error
        with suppress(FileNotFoundError):
            if os.path.samestat(os.fstat(descriptor), folder.stat()):
                return descriptor
        os.close(descriptor)  # another run removed it before it was locked


UNFINISHED_FOLDER = ".unfinished"
_IDENTITY_FILE = "identity.txt"
_RESULT_SUFFIX = ".result.json"


def identity(*parts: bytes) -> str:
    """Return a fingerprint of the inputs of work."""
    digest = hashlib.sha256()
    for part in parts:
        digest.update(len(part).to_bytes(8, "little"))
        digest.update(part)
    return digest.hexdigest()


class Workspace(Generic[Result]):
    """Folder of an unfinished run, locked while it is used."""

    def __init__(self, folder: Path, encode: Callable[[Result], str], decode: Callable[[bytes], Result]) -> None:
        """Use a folder; ``encode`` and ``decode`` convert results to JSON and back."""
        self.folder = folder
        self._encode = encode
        self._decode = decode

    def find(self, name: str) -> Result | None:
        """Return the result of a finished task; None if it is not finished, or cannot be read."""
        with suppress(OSError, ValueError, TypeError, KeyError, AttributeError, InputError):
            return self._decode(self._result_path(name).read_bytes())
        return None

    def keep(self, name: str, result: Result, files: Mapping[str, bytes] | None = None) -> Result:
        """Write the files of a task, then its result, which marks the task as finished.

        Raises:
            InfrastructureError: a file cannot be written.
        """
        for file, content in (files or {}).items():
            write_atomically(self.folder / file, content)
        write_atomically(self._result_path(name), self._encode(result))
        return result

    def keeping(self, task: Task[Result]) -> Task[Result]:
        """Return the task with its result saved as soon as it is available."""
        return task.then(lambda result: self.keep(task.name, result))

    def count(self) -> int:
        """Return the number of finished tasks."""
        return sum(1 for _ in self.folder.glob(f"*{_RESULT_SUFFIX}"))

    def _result_path(self, name: str) -> Path:
        return self.folder / f"{quote(name, safe=' ,')}{_RESULT_SUFFIX}"


@contextmanager
def workspace(
    output: Path, identity: str, encode: Callable[[Result], str], decode: Callable[[bytes], Result]
) -> Iterator[Workspace[Result]]:
    """Open the workspace inside an output folder; its content is kept only if it has the same identity.

    If the block fails, the workspace is kept if it contains results; otherwise it is
    removed, including folders that were created for it.

    Args:
        output: output folder.
        identity: fingerprint of the inputs of the results.
        encode: converts a result to JSON.
        decode: converts JSON to a result; an exception means that the task is not finished.

    Raises:
        InputError: another run uses this folder.
        InfrastructureError: the folder cannot be created or written.
    """
    folder = output / UNFINISHED_FOLDER
    with writing(output), locked(output):
        if not _is_of(folder, identity):
            if folder.exists():
                shutil.rmtree(folder)
            folder.mkdir()
            write_atomically(folder / _IDENTITY_FILE, json.dumps(identity))
        work, finished = Workspace(folder, encode, decode), False
        try:
            yield work
            finished = True
        finally:
            if finished or not work.count():
                shutil.rmtree(folder, ignore_errors=True)


def _is_of(folder: Path, identity: str) -> bool:
    try:
        return bool(json.loads((folder / _IDENTITY_FILE).read_bytes()) == identity)
    except (OSError, ValueError):
        return False
