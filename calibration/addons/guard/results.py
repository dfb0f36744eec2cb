"""Results of ``check``, and their report."""

from collections.abc import Mapping
from pathlib import Path

from calibration.addons.guard.outcome import SensorCheck
from calibration.base.records import computed, field, result
from calibration.ci.report import Outcome, Report, Table, Verdict, count_of, shown
from calibration.pipeline.system import Undecided

TITLE = "check"


@result(kw_only=True)
class CheckedRecording:
    """Results of check: whether sensors have moved since their calibration was accepted."""

    recording: tuple[str, ...] = field("The recordings.")
    systems: Mapping[str, tuple[SensorCheck, ...]] = field("The sensors of each system.")

    @property
    def named(self) -> dict[str, SensorCheck]:
        """The sensors by name, with that of their system if there are several."""
        several = len(self.systems) > 1
        return {
            f"{system}: {each.sensor}" if several else each.sensor: each
            for system, checks in self.systems.items()
            for each in checks
        }

    @property
    @computed()
    def moved(self) -> int:
        """Number of sensors that have moved, or whose lens has changed."""
        return sum(each.red for each in self.named.values())

    @property
    @computed()
    def untold(self) -> int:
        """Number of sensors of which the recording cannot tell."""
        return sum(each.outcome == "cannot-tell" for each in self.named.values())

    @property
    def verdict(self) -> Verdict:
        """Fail if something has moved; undecided if that cannot be told of a sensor."""
        return "fail" if self.moved else "undecided" if self.untold else "pass"

    @property
    def sentence(self) -> str:
        """The numbers, for the line of the verdict."""
        unmoved = len(self.named) - self.moved - self.untold
        parts = [f"{self.moved} moved"] * bool(self.moved) + [f"{self.untold} that cannot be told"] * bool(self.untold)
        return ", ".join([*parts, f"{unmoved} unmoved"]) + f" of {count_of(len(self.named), 'sensor')}"


def report(results: CheckedRecording, undecided: Undecided, baseline: Path) -> Report:
    """Return the report.

    Args:
        results: the results.
        undecided: what a sensor counts as of which the recording cannot tell.
        baseline: the file of accepted calibrations, for annotations.
    """
    named = results.named
    red = tuple(f"{name}: {each.reason}" for name, each in named.items() if each.red)
    cannot = {name: each for name, each in named.items() if each.outcome == "cannot-tell"}
    untold = tuple(f"{name}: cannot be told: {each.reason}" for name, each in cannot.items())
    return Report(
        title=TITLE,
        verdict="pass" if results.verdict == "undecided" and undecided == "pass" else results.verdict,
        sentence=results.sentence,
        reasons=red,
        undecided=untold,
        places=dict.fromkeys(red, (baseline, 1)),
        results=results,
        blocks=(
            Table(
                ("sensor", "outcome", "rotation", "error bar", "since", "would be seen", "why"),
                tuple(_row(name, each) for name, each in named.items()),
            ),
        ),
        suites={TITLE: [_outcome(name, each) for name, each in named.items()]},
        outputs={"moved": results.moved, "untold": results.untold},
    )


def _row(name: str, each: SensorCheck) -> tuple[str, ...]:
    rotation = " ".join(f"{value:+.3f}" for value in each.rotation_deg or ())
    sigma = max(each.rotation_sigma_deg) if each.rotation_sigma_deg else None
    since = "-" if not each.red else "the begin" if each.since is None else f"{each.since:.1f} s"
    seen = [shown(each.unseen_deg, ".3f", "deg", ""), shown(each.unseen_mm, ".1f", "mm", "")]
    return (
        name,
        each.outcome.replace("-", " "),
        f"{rotation} deg" if rotation else "-",
        shown(sigma, ".3f", "deg"),
        since,
        ", ".join(filter(None, seen)) or "-",
        each.reason,
    )


def _outcome(name: str, each: SensorCheck) -> Outcome:
    untold = each.outcome == "cannot-tell"
    return Outcome(
        name=name, group=TITLE, reasons=(each.reason,) if each.red else (), skipped=each.reason if untold else None
    )
