"""``import-rigelfile``: convert a Rigelfile to ``calibration.yml``."""

import os
from pathlib import Path

import click

from calibration.addons.rigel.conversion import convert, written
from calibration.addons.rigel.document import read_rigelfile
from calibration.addons.rigel.fields import NoteKind
from calibration.base import ExitCode, InputError, count_of, one_line, write_atomically
from calibration.ci.workflow import Annotation, Level, Runner, annotate, stop_commands
from calibration.commands.parameters import boolean_option, path


@click.command("import-rigelfile")
@click.option(
    "--file", type=path, default="Rigelfile", show_default=True, help="Rigelfile to read, or RoboMaker's request."
)
@click.option("--output", type=path, default="calibration.yml", show_default=True, help="File to write.")
@boolean_option("--overwrite", help="Replace an existing output file.")
def command(file: Path, output: Path, overwrite: bool) -> ExitCode:
    """Write a calibration.yml from a Rigelfile, and list what could not be converted.

    A request of RoboMaker's CreateSimulationJob or StartSimulationJobBatch, as JSON or YAML, is converted too.
    Nothing in the file is executed. Secrets are replaced by variables.
    """
    return import_rigelfile(file, output, Runner.from_environment(os.environ), overwrite=overwrite)


def import_rigelfile(file: Path, output: Path, runner: Runner, *, overwrite: bool = False) -> ExitCode:
    """Convert a Rigelfile; each part that is not converted is a warning, and a comment in the new file.

    Raises:
        InputError: the Rigelfile is missing, invalid or has nothing to convert, or the output file exists.
    """
    if output.exists() and (not overwrite or output.samefile(file)):
        hint = "name another file" if overwrite else "name another file, or add --overwrite"
        raise InputError(f"{output}: there is such a file already: {hint}")
    conversion = convert(read_rigelfile(file))
    if output.absolute().parent.resolve() != file.absolute().parent.resolve():
        conversion.notes.to_do("paths", f"they are relative to calibration.yml here: move it beside {file.name}")
    if conversion.is_empty:
        reasons = "; ".join(map(str, conversion.notes)) or "it has no jobs"
        raise InputError(f"{file}: nothing in it can be converted to calibration.yml: {reasons}")
    write_atomically(output, written(conversion, file.name))
    levels = {NoteKind.LOST: Level.WARNING, NoteKind.TO_DO: Level.WARNING, NoteKind.CHANGED: Level.NOTICE}
    annotate(runner, [Annotation(f"{n.kind}: {n}", levels[n.kind], file=file) for n in conversion.notes])
    count = {kind: sum(note.kind is kind for note in conversion.notes) for kind in NoteKind}
    with stop_commands(runner):
        runner.log(
            f"{one_line(str(output))}: {count_of(len(conversion.systems), 'system')}, "
            f"{count_of(len(conversion.simulations), 'simulation')}, {'an' if conversion.image else 'no'} image; "
            f"{count[NoteKind.TO_DO]} to do, "
            f"{count[NoteKind.CHANGED]} work otherwise here, {count[NoteKind.LOST]} not carried over"
        )
        complaint = _complaint_of_reader(output)
        if complaint:
            runner.log(one_line(f"before `calibration run --config {output}`: {complaint}"))
    return ExitCode.PASS


def _complaint_of_reader(output: Path) -> str:
    """Return the error of our own reader for the new file; empty if there is none."""
    try:
        from calibration.pipeline.configuration import read_configuration  # needs the extra calibrate

        read_configuration(output)
    except ModuleNotFoundError:  # installed without the engine
        return ""
    except InputError as error:
        return str(error)
    return ""
