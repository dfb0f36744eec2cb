"""Results of ``build-image``, and their report."""

from pathlib import Path
from typing import Literal

from calibration.base.records import computed, field, result
from calibration.ci.report import Code, Outcome, Report, Table, verdict_of
from calibration.ci.workflow import Annotation, Runner

REPORT_TITLE = "build-image"
WORDS_OF_PLACE = {"local": "on the engine", "registry": "in the registry", None: ""}
"""Where an image was found."""


@result
class Failure:
    """A failed step of the Dockerfile."""

    message: str = field("Reason of the failure.")
    lines: tuple[str, ...] = field("Last lines of the step's output.")


@result(kw_only=True)
class BuildResult:
    """Results of build-image: an image that was built, found or only promoted, or a failure."""

    reference: str | None = field(
        "Name to run: name:key-..., or name@digest if an image was only promoted.", default=None
    )
    id: str | None = field("Image id on the engine, if the engine has it.", default=None)
    digest: str | None = field("Digest in the registry, if it is there: sha256:...", default=None)
    key: str | None = field("Content key: equal exactly for images with the same content.", default=None)
    built: bool = field("Whether it was built now; otherwise nothing had changed.", default=False)
    found_in: Literal["local", "registry"] | None = field(
        "Where an image that was not built now was found.", default=None
    )
    tags: tuple[str, ...] = field("Its other current names: name:latest.", default=())
    promoted: tuple[str, ...] = field("Names that it was promoted to.", default=())
    seconds: float = field("Duration of the whole command.", default=0.0)
    failure: Failure | None = field("Reason of the failure.", default=None)

    @property
    @computed()
    def reasons(self) -> tuple[str, ...]:
        """Reasons of the failure."""
        return (self.failure.message,) if self.failure else ()


def report(result: BuildResult, source: Path, runner: Runner) -> Report:
    """Return the report of ``build-image``.

    Args:
        result: results of the command.
        source: specification or Dockerfile, for the annotation of a failure.
        runner: runner of the report; the log of a terminal has not shown the output of the steps.
    """
    failure = result.failure
    lines = failure.lines if failure else ()
    annotated = "\n".join((*result.reasons, *(lines if runner.service.annotates_lines else ())))
    return Report(
        title="Image",
        verdict=verdict_of(failure is None),
        sentence=_result_sentence(result),
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
            Code("\n".join(lines), only=None if runner.on_terminal else "summary"),
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
        suites={
            REPORT_TITLE: [Outcome(name="image", group=REPORT_TITLE, reasons=result.reasons, seconds=result.seconds)]
        },
    )


def _result_sentence(result: BuildResult) -> str:
    if result.failure is not None:
        return result.failure.message
    names = ", ".join(result.promoted)
    if result.key is None:
        return f"{result.reference} is promoted to {names}"
    how = "built" if result.built else f"unchanged, found {WORDS_OF_PLACE[result.found_in]}"
    promoted = f", promoted to {names}" if names else ""
    return f"{result.reference}: {how}{promoted} ({result.seconds:.1f} s)"
