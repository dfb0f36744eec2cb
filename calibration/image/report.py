"""What ``build-image`` did, and its report."""

from dataclasses import dataclass
from pathlib import Path

from calibration.image.builders.failure import BuildFailedError
from calibration.image.building import BuiltImage
from calibration.report import Code, Outcome, Report, Table, verdict_of
from calibration.workflow import Annotation, Runner

TITLE = "build-image"
_PLACES = {"local": "on the engine", "registry": "in the registry", None: ""}


@dataclass(frozen=True)
class BuildResult:
    """What was done: an image built or found, or a failure; and what was promoted."""

    image: BuiltImage | None = None
    promoted: tuple[str, ...] = ()
    failure: BuildFailedError | None = None
    reference: str | None = None
    """Of an image that was only promoted."""
    digest: str | None = None
    """Of an image that was only promoted."""
    seconds: float = 0.0


def report(result: BuildResult, source: Path, runner: Runner) -> Report:
    """Return the report of ``build-image``.

    Args:
        result: what was done.
        source: the specification or Dockerfile, at which a failure is annotated.
        runner: where the report will be shown; the log of a terminal has not shown the output of a step.
    """
    image, failure = result.image, result.failure
    tags = image.tags if image else ()
    reference = image.reference if image else result.reference
    digest = image.digest if image else result.digest
    lines = failure.lines if failure else ()
    on_terminal = not runner.github and runner.stdout.isatty()
    headlines = (failure.headline,) if failure else ()
    annotated = "\n".join((*headlines, *(lines if runner.github else ())))
    return Report(
        title=TITLE,
        verdict=verdict_of(failure is None),
        sentence=_sentence(result),
        results={
            "reasons": list(headlines),
            "reference": reference,
            "id": image.id if image else None,
            "digest": digest,
            "key": image.key if image else None,
            "built": image.built if image else False,
            "found_in": image.found_in if image else None,
            "tags": list(tags),
            "promoted": list(result.promoted),
            "seconds": round(result.seconds, 3),
            "failure": failure and {"message": failure.headline, "lines": list(lines)},
        },
        outputs={
            "reference": reference,
            "digest": digest,
            "key": image.key if image else None,
            "image-id": image.id if image else None,
            "built": image.built if image else False,
            "tags": list(dict.fromkeys((*tags, *result.promoted))),
        },
        annotations=(Annotation(annotated, file=source),) if failure else (),
        blocks=(
            Code("\n".join(lines), only=None if on_terminal else "summary"),
            Table(
                ("", ""),
                tuple(
                    (name, value)
                    for name, value in (
                        ("Image", reference),
                        ("Digest", digest),
                        ("Tags", ", ".join(tags)),
                        ("Promoted to", ", ".join(result.promoted)),
                        ("Content key", image.key if image else None),
                    )
                    if value
                ),
                only="summary",
            ),
        ),
        suites={TITLE: [Outcome(name="image", group=TITLE, reasons=headlines, seconds=result.seconds)]},
    )


def _sentence(result: BuildResult) -> str:
    if result.failure is not None:
        return result.failure.headline
    names = ", ".join(result.promoted)
    if result.image is None:
        return f"{result.reference} is promoted to {names}"
    how = "built" if result.image.built else f"unchanged, found {_PLACES[result.image.found_in]}"
    promoted = f", promoted to {names}" if names else ""
    return f"{result.image.reference}: {how}{promoted} ({result.seconds:.1f} s)"
