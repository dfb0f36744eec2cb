"""What ``build-image`` did, and its report."""

from pathlib import Path
from typing import Literal

from calibration.records import computed, field, result
from calibration.report import Code, Outcome, Report, Table, verdict_of
from calibration.workflow import Annotation, Runner

TITLE = "build-image"
_PLACES = {"local": "on the engine", "registry": "in the registry", None: ""}


@result
class Failure:
    """A step of the Dockerfile that failed."""

    message: str = field("What failed.")
    lines: tuple[str, ...] = field("The last lines of the step's output.")


@result(kw_only=True)
class BuildResult:
    """Results of build-image: an image built, found or only promoted, or a failure."""

    reference: str | None = field(
        "What to run: name:key-..., or name@digest where an image was only promoted.", default=None
    )
    id: str | None = field("On the engine, where it is there.", default=None)
    digest: str | None = field("In the registry, where it is there: sha256:...", default=None)
    key: str | None = field(
        "The content key: two images have the same exactly if they are made of the same.", default=None
    )
    built: bool = field("Whether it was built now; else nothing had changed.", default=False)
    found_in: Literal["local", "registry"] | None = field("Where an image was that is not built now.", default=None)
    tags: tuple[str, ...] = field("Its other names now: name:latest.", default=())
    promoted: tuple[str, ...] = field("The names that it was promoted to.", default=())
    seconds: float = field("Of everything.", default=0.0)
    failure: Failure | None = field("What failed.", default=None)

    @property
    @computed()
    def reasons(self) -> tuple[str, ...]:
        """Why the verdict is fail."""
        return (self.failure.message,) if self.failure else ()


def report(result: BuildResult, source: Path, runner: Runner) -> Report:
    """Return the report of ``build-image``.

    Args:
        result: what was done.
        source: the specification or Dockerfile, at which a failure is annotated.
        runner: where the report will be shown; the log of a terminal has not shown the output of a step.
    """
    failure = result.failure
    lines = failure.lines if failure else ()
    on_terminal = not runner.github and runner.stdout.isatty()
    annotated = "\n".join((*result.reasons, *(lines if runner.github else ())))
    return Report(
        title=TITLE,
        verdict=verdict_of(failure is None),
        sentence=_sentence(result),
        results=result,
        outputs={
            "reference": result.reference,
            "digest": result.digest,
            "key": result.key,
            "image-id": result.id,
            "built": result.built,
            "tags": list(dict.fromkeys((*result.tags, *result.promoted))),
        },
        annotations=(Annotation(annotated, file=source),) if failure else (),
        blocks=(
            Code("\n".join(lines), only=None if on_terminal else "summary"),
            Table(
                ("", ""),
                tuple(
                    (name, value)
                    for name, value in (
                        ("Image", result.reference),
                        ("Digest", result.digest),
                        ("Tags", ", ".join(result.tags)),
                        ("Promoted to", ", ".join(result.promoted)),
                        ("Content key", result.key),
                    )
                    if value
                ),
                only="summary",
            ),
        ),
        suites={TITLE: [Outcome(name="image", group=TITLE, reasons=result.reasons, seconds=result.seconds)]},
    )


def _sentence(result: BuildResult) -> str:
    if result.failure is not None:
        return result.failure.message
    names = ", ".join(result.promoted)
    if result.key is None:
        return f"{result.reference} is promoted to {names}"
    how = "built" if result.built else f"unchanged, found {_PLACES[result.found_in]}"
    promoted = f", promoted to {names}" if names else ""
    return f"{result.reference}: {how}{promoted} ({result.seconds:.1f} s)"
