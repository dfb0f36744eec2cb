"""The command ``calibration``, and the way in for the actions.

Exit codes are those of :class:`calibration.errors.ExitCode`; a command that is stopped by SIGINT
or SIGTERM cleans up and answers 130 or 143 (128 and the signal's number), as shells do.
"""

import errno
import importlib
import mmap
import os
import sys
import warnings
from collections.abc import Mapping, Sequence
from contextlib import suppress
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

import click

from calibration import __version__
from calibration.errors import CalibrationError, ExitCode, solvable
from calibration.workflow import Runner, report_error, stop_commands
from calibration.workflow.signals import Terminated, terminate_cleanly
from calibration.workflow.text import did_you_mean


class LazyCommand(NamedTuple):
    """A command that is imported when it is called."""

    target: str
    """``module:attribute`` of the click command."""
    help: str
    """The line in the list of commands, kept here so that ``--help`` imports nothing."""


COMMANDS: Mapping[str, LazyCommand] = {
    "run": LazyCommand("calibration.commands.run:command", "Run the whole pipeline of calibration.yml."),
    "calibrate-matrix": LazyCommand(
        "calibration.commands.calibrate_matrix:command", "Calibrate systems from every noisy start."
    ),
    "accept": LazyCommand("calibration.commands.accept:command", "Keep a run's results as the baseline of later ones."),
    "history": LazyCommand("calibration.commands.history:command", "Follow the accepted calibrations through git."),
    "convergence": LazyCommand("calibration.commands.convergence:command", "Map how far a starting guess may be off."),
    "introspect-csv": LazyCommand("calibration.commands.introspect_csv:command", "Check tables against rules."),
    "collect-data-sim": LazyCommand(
        "calibration.commands.collect_data_sim:command", "Collect a dataset in simulation."
    ),
    "build-image": LazyCommand(
        "calibration.commands.build_image:command", "Build the image with the team's software, if anything changed."
    ),
    "coverage-upload": LazyCommand(
        "calibration.commands.coverage_upload:command", "Run tests, judge their coverage, and upload it."
    ),
    "static-analysis": LazyCommand(
        "calibration.commands.static_analysis:command", "Look for errors in the code; red for what a change brings in."
    ),
    "record-motion": LazyCommand(
        "calibration.commands.record_motion:command", "Record a motion sequence on a page in the browser."
    ),
    "plan-matrix": LazyCommand("calibration.commands.plan_matrix:command", "Plan the jobs of a workflow."),
    "gather-results": LazyCommand(
        "calibration.commands.gather_results:command", "Gather what the jobs of a workflow found."
    ),
    "comment": LazyCommand("calibration.commands.comment:command", "Keep one comment on a pull request up to date."),
    "import-data": LazyCommand(
        "calibration.commands.import_data:command", "Make a dataset of images and poses that were recorded."
    ),
    "label": LazyCommand("calibration.commands.label:command", "Find the patterns in the images of a dataset."),
    "init": LazyCommand("calibration.commands.init:command", "Write a first calibration.yml and workflow."),
    "export": LazyCommand(
        "calibration.commands.export:command", "Write a calibration as URDF, launch files, camera_info and more."
    ),
    "import-rigelfile": LazyCommand(
        "calibration.commands.import_rigelfile:command", "Convert a Rigelfile to calibration.yml."
    ),
    "aws-policy": LazyCommand(
        "calibration.commands.aws_policy:command", "Print the IAM policies that jobs on AWS Batch need."
    ),
    "cleanup": LazyCommand(
        "calibration.commands.cleanup:command", "Remove what killed runs left in the Docker Engine or the cloud."
    ),
    "schema": LazyCommand("calibration.commands.schema:command", "Print the JSON Schema of a file."),
    "version": LazyCommand("calibration.commands.version:command", "Print the versions in use."),
}
"""Every command by its name, in the order of ``--help``."""
COMPLETION = "_CALIBRATION_COMPLETE"
IMPORTED = 100 << 20
"""Bytes: more than numpy takes of the address space when it is imported, most of it for OpenBLAS."""
_PACKAGES = {"cv2": "opencv-python-headless", "yaml": "pyyaml"}
"""What modules are called where they are installed from, if not the same."""


class LazyGroup(click.Group):
    """A group whose commands are imported only when they are called."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """List the commands whose module is installed."""
        return [name for name, command in COMMANDS.items() if find_spec(command.target.partition(":")[0])]

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import a command; None for a name that is not in the list."""
        return load_command(cmd_name) if cmd_name in self.list_commands(ctx) else None

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Find the command that the arguments name; a usage error proposes the nearest name."""
        known = self.list_commands(ctx)
        if args[0] not in known and not args[0].startswith("-"):
            ctx.fail(f"there is no command {args[0]!r}{did_you_mean(args[0], known)}")
        return super().resolve_command(ctx, args)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the list of commands for ``--help`` without importing them."""
        with formatter.section("Commands"):
            formatter.write_dl([(name, COMMANDS[name].help) for name in self.list_commands(ctx)])


def load_command(name: str) -> click.Command:
    """Import the command of that name."""
    module, attribute = COMMANDS[name].target.split(":")
    command = getattr(importlib.import_module(module), attribute)
    if not isinstance(command, click.Command):
        raise TypeError(f"{COMMANDS[name].target} is not a click command")
    return command


@click.group("calibration", cls=LazyGroup, no_args_is_help=False)
@click.version_option(__version__, prog_name="calibration-ci", message="%(prog)s %(version)s")
def group() -> None:
    """Tell whether the robot still calibrates.

    Exit codes: 0 pass, 1 the verdict is fail, 2 bad input, 3 infrastructure failed (disk, network, engine).
    """


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line (``sys.argv`` unless arguments are given) and return its exit code.

    Only the arguments count: variables ``INPUT_*`` are not read. A shell that completes the line, or asks how, says so
    by a variable, as click has it.
    """
    if arguments is None and (asked := os.environ.get(COMPLETION)):
        from click.shell_completion import shell_complete

        return shell_complete(group, {}, "calibration", COMPLETION, asked)
    return _execute(group, "calibration", sys.argv[1:] if arguments is None else arguments)


def run_action(name: str) -> int:
    """Run a command as an action and return its exit code.

    Its options come from variables ``INPUT_<OPTION>`` (``--every-min`` from ``INPUT_EVERY_MIN``);
    an empty variable counts as not given.
    """
    return _execute(name, name, [], auto_envvar_prefix="INPUT", help_option_names=[])


def _execute(command: click.Command | str, name: str, arguments: Sequence[str], **settings: Any) -> int:
    """Run a command, turn what it raises into one line for the user, and return the exit code."""
    # Processes are the parallelism; and one thread gives the same bytes on every machine.
    for variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
        os.environ.setdefault(variable, "1")
    _open_closed_streams()
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):  # a test may have put another stream there
            stream.reconfigure(errors="backslashreplace", line_buffering=True)
    runner = Runner.from_environment(os.environ)
    try:
        return _answer(runner, command, name, arguments, **settings)
    except MemoryError:
        report_error(runner, "there is not enough memory: give it more, or take fewer collections or processes")
        return ExitCode.INFRASTRUCTURE
    except OSError:  # of what was to be said: nobody can be told
        return ExitCode.INFRASTRUCTURE
    finally:
        _flush()


def _answer(runner: Runner, command: click.Command | str, name: str, arguments: Sequence[str], **settings: Any) -> int:
    """Run a command and say what went wrong; see `_execute`."""
    try:
        _require_memory()
        # Warnings of packages are for us: what is wrong with the data is said in an error.
        with terminate_cleanly(), warnings.catch_warnings(record=not runner.debug), solvable("the data"):
            loaded = load_command(command) if isinstance(command, str) else command
            with loaded.make_context(name, list(arguments), **settings) as context:
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
        return ExitCode.INFRASTRUCTURE  # nobody reads what would be said
    except OSError as error:
        report_error(runner, _failure(error))
        return ExitCode.INFRASTRUCTURE
    except ModuleNotFoundError as error:
        if error.name is None or error.name.partition(".")[0] == "calibration":
            return _report_bug(runner)
        module = error.name.partition(".")[0]
        report_error(runner, f"the package {module} is not installed: pip install {_PACKAGES.get(module, module)}")
        return ExitCode.INFRASTRUCTURE
    except ImportError as error:
        if "failed to map segment" in str(error):  # of a library for which there is no room
            raise MemoryError from None
        return _report_bug(runner)
    except MemoryError:
        raise  # said where its traceback, and with it the memory, is gone
    except Exception:  # whatever was not foreseen is our bug: the traceback is for us
        return _report_bug(runner)


def _open_closed_streams() -> None:
    """Open standard streams that the caller has closed (``>&-``) on nothing.

    Or what is printed is an error, and the next file that is opened takes the place of the log.
    """
    for descriptor, name in enumerate(("stdin", "stdout", "stderr")):
        try:
            os.fstat(descriptor)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # takes the lowest number that is free: this one
        if getattr(sys, name) is None:
            setattr(sys, name, Path(os.devnull).open("r" if descriptor == 0 else "w"))  # noqa: SIM115 (until the end)


def _require_memory() -> None:
    """Refuse to begin where OpenBLAS would find no memory for itself: it ends the process with exit code 1.

    Raises:
        MemoryError: there is less than numpy takes when it is imported.
    """
    try:
        mmap.mmap(-1, IMPORTED).close()
    except OSError:
        raise MemoryError from None


def _flush() -> None:
    """Write out what is printed, or drop it where that fails: else Python ends with an exit code of its own."""
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
    """Message about an error of the operating system: what failed, at which path, what to do."""
    if error.filename is None or error.strerror is None:
        return str(error)
    advice = {
        errno.EACCES: ": let this user read and write it, or name another place",
        errno.ENOSPC: ": make room, or name another place",
    }
    return f"{os.fsdecode(error.filename)}: {error.strerror}{advice.get(error.errno or 0, '')}"


def _report_bug(runner: Runner) -> int:
    import traceback

    with stop_commands(runner, sys.stderr):
        traceback.print_exc()
    report_error(runner, "this is a bug in Calibration CI, please report it with the lines above")
    return ExitCode.INFRASTRUCTURE


if __name__ == "__main__":
    sys.exit(main())
