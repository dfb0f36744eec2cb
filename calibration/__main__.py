"""Command line ``calibration``, and entry point of the actions.

Exit codes are those of :class:`calibration.base.errors.ExitCode`; a command that is stopped by SIGINT
or SIGTERM cleans up and returns 130 or 143 (128 plus the number of the signal), as shells do.
"""

import errno
import gc
import importlib
import mmap
import os
import sys
import warnings
from collections.abc import Mapping, Sequence
from contextlib import suppress
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NoReturn

import click

from calibration import __version__
from calibration.base import CalibrationError, ExitCode, did_you_mean, solvable
from calibration.base.addons import LazyCommand, of_addons
from calibration.base.optional import PACKAGE_OF_MODULE
from calibration.base.process import Terminated, no_collector, run_process, terminate_cleanly
from calibration.ci.workflow import Annotation, Level, Runner, annotate, report_error, stop_commands

_COMMANDS = {
    "run": ("run:command", "Run the whole pipeline of calibration.yml."),
    "calibrate-matrix": ("calibrate_matrix:command", "Calibrate systems from every noisy start."),
    "accept": ("baseline:accept_command", "Keep a run's results as the baseline of later ones."),
    "history": ("baseline:history_command", "Follow the accepted calibrations through git."),
    "next-pose": ("next_pose:next_pose_command", "Say which poses to record next, and when it is enough."),
    "plan-recording": (
        "next_pose:plan_recording_command",
        "Plan the poses of a recording before anything is recorded.",
    ),
    "convergence": ("convergence:command", "Map how large errors of the starting guess may be."),
    "introspect-csv": ("introspect_csv:command", "Check tables against rules."),
    "collect-data-sim": ("collect_data_sim:command", "Collect a dataset in simulation."),
    "build-image": ("build_image:command", "Build the image with the team's software, if anything changed."),
    "plan-matrix": ("workflow:plan_matrix_command", "Plan the jobs of a workflow."),
    "gather-results": ("workflow:gather_results_command", "Merge the results of a workflow's jobs."),
    "comment": ("workflow:comment_command", "Keep one comment on a pull request up to date."),
    "look": ("recordings:look_command", "Look at a recording: what is in it, and what is missing for a calibration."),
    "watch": (
        "recordings:watch_command",
        "Watch images arrive: which views are used, how good the calibration is, and what to show next.",
    ),
    "import-data": ("recordings:import_data_command", "Make a dataset of recorded images and poses."),
    "add-collections": ("recordings:add_collections_command", "Add what was recorded later to a dataset."),
    "label": ("recordings:label_command", "Find the patterns in the images of a dataset."),
    "init": ("init:command", "Write a first calibration.yml and workflow."),
    "export": ("export:command", "Write a calibration as URDF, launch files, camera_info and more."),
    "cleanup": ("cleanup:command", "Remove what killed runs left in the Docker Engine or the cloud."),
    "pattern": ("recordings:pattern_command", "Write a board to print, true to size."),
    "schema": ("schema:command", "Print the JSON Schema of a file."),
    "version": ("version:command", "Print the versions in use."),
}
COMMANDS: Mapping[str, LazyCommand] = {
    **{name: LazyCommand(f"calibration.commands.{target}", help_) for name, (target, help_) in _COMMANDS.items()},
    **of_addons(lambda addon: addon.commands),
}
"""Commands by name, in the order of ``--help``."""
COMPLETION = "_CALIBRATION_COMPLETE"
IMPORTED = 100 << 20
"""Bytes of address space required before a command starts: more than the import of numpy maps, mostly for OpenBLAS."""


class LazyGroup(click.Group):
    """A group whose commands are imported only when they are called."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return the names of the commands whose module is installed."""
        return list(filter(_is_installed, COMMANDS))

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import a command; None for an unknown name."""
        return load_command(cmd_name) if _is_installed(cmd_name) else None

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Find the command that the arguments name; a usage error suggests the nearest name."""
        if not _is_installed(args[0]) and not args[0].startswith("-"):
            ctx.fail(f"there is no command {args[0]!r}{did_you_mean(args[0], self.list_commands(ctx))}")
        return super().resolve_command(ctx, args)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the list of commands for ``--help`` without importing them."""
        with formatter.section("Commands"):
            formatter.write_dl([(name, COMMANDS[name].help) for name in self.list_commands(ctx)])


def _is_installed(name: str) -> bool:
    return name in COMMANDS and find_spec(COMMANDS[name].target.partition(":")[0]) is not None


def load_command(name: str) -> click.Command:
    """Import a command by its name."""
    module, attribute = COMMANDS[name].target.split(":")
    if module not in sys.modules:
        with no_collector():
            importlib.import_module(module)
            gc.freeze()  # modules stay until the end: the collector need never look at them
    command = getattr(sys.modules[module], attribute)
    if not isinstance(command, click.Command):
        raise TypeError(f"{COMMANDS[name].target} is not a click command")
    return command


@click.group(
    "calibration", cls=LazyGroup, no_args_is_help=False, context_settings={"help_option_names": ["-h", "--help"]}
)
@click.version_option(__version__, prog_name="calibration-ci", message="%(prog)s %(version)s")
def group() -> None:
    """Check whether the robot still calibrates.

    Exit codes: 0 pass, 1 the verdict is fail, 2 bad input, 3 infrastructure failed (disk, network, engine).
    """


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line (``sys.argv`` by default) and return its exit code.

    Options are read from the arguments only, not from variables ``INPUT_*``. If ``_CALIBRATION_COMPLETE`` is set,
    click's shell completion is run instead.
    """
    if arguments is None and (asked := os.environ.get(COMPLETION)):
        from click.shell_completion import shell_complete

        return shell_complete(group, {}, "calibration", COMPLETION, asked)
    return _execute(group, "calibration", sys.argv[1:] if arguments is None else arguments)


def run_action(name: str) -> int:
    """Run a command as an action and return its exit code.

    Its options are read from variables ``INPUT_<OPTION>`` (``--every-min`` from ``INPUT_EVERY_MIN``);
    an empty variable counts as not given.
    """
    return _execute(name, name, [], auto_envvar_prefix="INPUT", help_option_names=[])


def _execute(command: click.Command | str, name: str, arguments: Sequence[str], **settings: Any) -> int:
    """Run a command, report its exceptions in one line, and return the exit code."""
    # Work is parallelised over processes; and results of one thread are the same bytes on every machine.
    for variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
        os.environ.setdefault(variable, "1")
    _open_closed_streams()
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):  # a test may have replaced the stream
            stream.reconfigure(errors="backslashreplace", line_buffering=True)
    runner = Runner.from_environment()
    try:
        return _answer(runner, command, name, arguments, **settings)
    except MemoryError:
        report_error(runner, "there is not enough memory: use fewer collections or processes, or more memory")
        return ExitCode.INFRASTRUCTURE
    except OSError:  # raised while an error was printed: nothing more can be reported
        return ExitCode.INFRASTRUCTURE
    finally:
        _flush()


def _answer(runner: Runner, command: click.Command | str, name: str, arguments: Sequence[str], **settings: Any) -> int:
    """Run a command and report its errors; see `_execute`."""
    try:
        _require_memory()
        # Warnings of packages are for developers: problems with the data are reported as errors.
        with terminate_cleanly(), warnings.catch_warnings(record=not runner.debug), solvable("the data"):
            loaded = load_command(command) if isinstance(command, str) else command
            renamed = _former_inputs(loaded) if settings else ()
            with loaded.make_context(name, list(arguments), **settings) as context:
                if settings:
                    _tell_of_deprecated_inputs(runner, context, renamed)
                code = loaded.invoke(context)
            return int(code or ExitCode.PASS)
    except click.exceptions.Exit as stop:
        return stop.exit_code
    except click.ClickException as error:
        report_error(runner, _usage_message(error, is_action=bool(settings)))
        return ExitCode.BAD_INPUT
    except CalibrationError as error:
        report_error(runner, str(error))
        return error.exit_code
    except Terminated:
        report_error(runner, "stopped by SIGTERM")
        return 143
    except KeyboardInterrupt:
        report_error(runner, "stopped by SIGINT")
        return 130
    except BrokenPipeError:
        return ExitCode.INFRASTRUCTURE  # the reader of the output has closed the pipe
    except OSError as error:
        report_error(runner, _failure(error))
        return ExitCode.INFRASTRUCTURE
    except ModuleNotFoundError as error:
        if error.name is None or error.name.partition(".")[0] == "calibration":
            return _report_bug(runner, error)
        module = error.name.partition(".")[0]
        _, source = PACKAGE_OF_MODULE.get(module, (module, module))
        report_error(runner, f"the package {module} is not installed: pip install {source}")
        return ExitCode.INFRASTRUCTURE
    except ImportError as error:
        if "failed to map segment" in str(error):  # of a shared library, for which there is not enough memory
            raise MemoryError from None
        return _report_bug(runner, error)
    except MemoryError:
        raise  # reported by the caller, where the traceback, and the memory that it references, is freed
    except Exception as error:
        if _is_out_of_memory(error):
            raise MemoryError from None
        return _report_bug(runner, error)  # unexpected, hence a bug: print the traceback


def _former_inputs(command: click.Command) -> tuple[str, ...]:
    """Take inputs of the action by their former names, and return a line about each."""
    from calibration.commands.parameters import take_former_inputs  # as the command's module does

    return tuple(take_former_inputs(command, os.environ))


def _tell_of_deprecated_inputs(runner: Runner, context: click.Context, renamed: Sequence[str]) -> None:
    """Annotate inputs that the user gave: to an action, or to the workflow, whose first job tells for all of them."""
    from calibration.commands.parameters import deprecated_inputs

    if os.environ.get("GITHUB_ACTION_PATH") or context.info_name == "plan-matrix":
        lines = (*renamed, *deprecated_inputs(context))
        annotate(runner, [Annotation(line, Level.WARNING, title="deprecated input") for line in lines])


def _is_out_of_memory(error: BaseException | None) -> bool:
    """Return whether an exception comes of a MemoryError, or is OpenCV's or a loader's word for one."""
    while error is not None:
        if isinstance(error, MemoryError) or "insufficient memory" in str(error).lower():
            return True
        error = error.__cause__ or error.__context__
    return False


def _open_closed_streams() -> None:
    """Open standard streams that the caller has closed (``>&-``) on the null device.

    Otherwise printing would fail, and the next file that is opened would receive the log.
    """
    for descriptor, name in enumerate(("stdin", "stdout", "stderr")):
        try:
            os.fstat(descriptor)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # uses the lowest free descriptor: this one
        if getattr(sys, name) is None:
            setattr(sys, name, Path(os.devnull).open("r" if descriptor == 0 else "w"))  # noqa: SIM115 (until the end)


def _require_memory() -> None:
    """Check the free memory before numpy is imported: without enough, OpenBLAS ends the process with exit code 1.

    Raises:
        MemoryError: less than `IMPORTED` bytes can be mapped.
    """
    try:
        mmap.mmap(-1, IMPORTED).close()
    except OSError:
        raise MemoryError from None


def _flush() -> None:
    """Flush the output streams; discard their content if that fails, because Python would change the exit code."""
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except (OSError, ValueError):
            with suppress(OSError, ValueError):
                os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def _usage_message(error: click.ClickException, is_action: bool) -> str:
    message = error.format_message()
    context = getattr(error, "ctx", None)
    if is_action or context is None:
        return message
    return f"{message.rstrip('.')} (see {context.command_path} --help)"


def _failure(error: OSError) -> str:
    """Return the message of an operating system error: path (of the log if there is none), reason, advice."""
    if error.strerror is None:
        return str(error)
    where = "the output" if error.filename is None else os.fsdecode(error.filename)
    advice = {
        errno.EACCES: ": give this user read and write access, or choose another path",
        errno.ENOSPC: ": free disk space, or choose another path",
    }
    return f"{where}: {error.strerror}{advice.get(error.errno or 0, '')}"


def _report_bug(runner: Runner, error: Exception) -> int:
    with stop_commands(runner, sys.stderr):
        sys.excepthook(type(error), error, error.__traceback__)
    report_error(runner, "this is a bug in Calibration CI, please report it with the lines above")
    return ExitCode.INFRASTRUCTURE


def action_entry(name: str) -> NoReturn:
    """Run a command as an action, as all that this process does."""
    run_process(lambda: run_action(name))


def entry() -> NoReturn:
    """Run the command line as all that this process does."""
    run_process(main)


if __name__ == "__main__":
    entry()
