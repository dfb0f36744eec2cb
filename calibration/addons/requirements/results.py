"""Results of ``check-messages`` and of the stage judge, and their documents."""

from calibration.addons.requirements.requirement import Judgement
from calibration.base.records import computed, field, result
from calibration.ci.report import count_of
from calibration.ci.report.stage_result import StageResult


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
