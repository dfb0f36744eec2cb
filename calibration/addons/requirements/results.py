"""Results of ``check-messages`` and of the stage judge, their documents, and their report."""

from collections.abc import Sequence
from pathlib import Path

from calibration.addons.requirements.requirement import Judgement, Requirement
from calibration.base import line_of, shorten
from calibration.base.records import computed, field, result
from calibration.ci.report import Outcome, Report, Table, count_of, verdict_of
from calibration.ci.report.report import StageResult
from calibration.ci.workflow.runner import Annotation, Level


@result(kw_only=True)
class MessageResults:
    """Results of check-messages."""

    bag: tuple[str, ...] = field("The bag's files.")
    seconds: float = field("What the bag spans.", unit="s")
    requirements: tuple[Judgement, ...] = field("The requirements, in the order of calibration.yml.")

    @property
    @computed()
    def not_met(self) -> int:
        """Number of requirements that are not met."""
        return sum(each.status == "not met" for each in self.requirements)

    @property
    @computed()
    def vacuous(self) -> int:
        """Number of requirements to which nothing came."""
        return sum(each.status == "vacuous" for each in self.requirements)

    @property
    def reasons(self) -> tuple[str, ...]:
        """Requirements that are not met, one line each."""
        return tuple(str(each) for each in self.requirements if each.status == "not met")

    @property
    def warnings(self) -> tuple[str, ...]:
        """Vacuous requirements, one line each."""
        return tuple(f"vacuous: {each}" for each in self.requirements if each.status == "vacuous")

    @property
    def sentence(self) -> str:
        """Return the numbers, for the line of the verdict."""
        count = count_of(len(self.requirements), "requirement")
        vacuous = f", {self.vacuous} vacuous" if self.vacuous else ""
        if self.not_met:
            return f"{self.not_met} of {count} not met{vacuous}, over {self.seconds:.1f} s of messages"
        return f"{count} met{vacuous}, over {self.seconds:.1f} s of messages"


@result(kw_only=True)
class JudgedMessages(StageResult):
    """Requirements over messages, in a run."""

    heading = "Requirements over messages"

    requirements: int = field("Number of requirements.")
    not_met: int = field("Those that are not met.")
    vacuous: tuple[str, ...] = field("Those to which nothing came, with why.", default=())

    @property
    def sentence(self) -> str:
        """Return the number of requirements, for the line of the verdict."""
        count = count_of(self.requirements, "requirement")
        return f"{self.not_met} of {count} over messages not met" if self.not_met else f"{count} over messages met"


TITLE = "check-messages"
MAX_ROWS_SHOWN = 200


def report(results: MessageResults, requirements: Sequence[Requirement], config: Path) -> Report:
    """Return the report.

    Args:
        results: the results.
        requirements: those of the results, in their order.
        config: the file in which they are written, for annotations.
    """
    lines = [_line_of_requirement(each, config) for each in requirements]
    judged = list(zip(results.requirements, lines, strict=True))
    worst_first = sorted(results.requirements, key=lambda each: ("not met", "vacuous", "met").index(each.status))
    return Report(
        title="Requirements over messages",
        verdict=verdict_of(not results.not_met),
        sentence=results.sentence,
        reasons=results.reasons,
        warnings=results.warnings,
        places={
            text: (config, line)
            for each, line in judged
            for text in (str(each), f"vacuous: {each}")
            if each.status != "met" and line is not None
        },
        results=results,
        blocks=(
            Table(
                ("requirement", "status", "expected", "found", "at"),
                tuple(_row(each) for each in worst_first),
                MAX_ROWS_SHOWN,
            ),
        ),
        suites={TITLE: [_outcome(each, config, line) for each, line in judged]},
        outputs={
            "requirements": len(results.requirements),
            "not-met": results.not_met,
            "vacuous": results.vacuous,
        },
    )


def annotations_of(report: Report) -> tuple[Annotation, ...]:
    """Return the annotations of a stage: warnings, and failures at their lines; the run lists the others itself."""
    return tuple(each for each in report.all_annotations() if each.level is not Level.ERROR or each.line is not None)


def _row(each: Judgement) -> tuple[str, ...]:
    witness = str(each.witnesses[-1]) if each.witnesses else ""
    name, expected = shorten(each.name, 100), shorten(each.expected, 100)
    return (name, each.status, "" if expected == name else expected, shorten(each.found, 200), shorten(witness, 200))


def _outcome(each: Judgement, config: Path, line: int | None) -> Outcome:
    return Outcome(
        name=each.name,
        group=TITLE,
        reasons=(str(each),) if each.status == "not met" else (),
        skipped=f"vacuous: {each.found}" if each.status == "vacuous" else None,
        file=str(config),
        line=line,
    )


def _line_of_requirement(each: Requirement, config: Path) -> int | None:
    keys, text = each.place
    return line_of(config, ("requirements", *keys), text)
