"""What came of ``build-image`` as people and programs read it."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from calibration.image.builders.failure import BuildFailedError
from calibration.image.building import BuiltImage
from calibration.workflow.summary import code_block, escape_markdown, markdown_table

SCHEMA = 1
"""Number of the form of results.json; ``results.schema.json`` beside this module describes it."""


@dataclass(frozen=True)
class Report:
    """What came of it: an image, or a failure; and what was promoted."""

    image: BuiltImage | None = None
    promoted: tuple[str, ...] = ()
    failure: BuildFailedError | None = None
    reference: str | None = None
    """Of an image that was only promoted."""
    digest: str | None = None
    """Of it."""
    seconds: float = 0.0

    @property
    def passed(self) -> bool:
        """Whether the verdict is pass."""
        return self.failure is None

    def document(self) -> dict[str, Any]:
        """Everything, in the form of ``results.schema.json``."""
        image, failure = self.image, self.failure
        return {
            "schema": SCHEMA,
            "verdict": "pass" if self.passed else "fail",
            "reference": image.reference if image else self.reference,
            "id": image.id if image else None,
            "digest": image.digest if image else self.digest,
            "key": image.key if image else None,
            "built": image.built if image else False,
            "found_in": image.found_in if image else None,
            "tags": list(image.tags) if image else [],
            "promoted": list(self.promoted),
            "seconds": round(self.seconds, 3),
            "failure": failure and {"message": failure.headline, "lines": list(failure.lines)},
        }

    def json(self) -> str:
        """The text of results.json."""
        return json.dumps(self.document(), indent=2, ensure_ascii=False) + "\n"

    def outputs(self) -> dict[str, Any]:
        """The step's outputs."""
        found = self.document()
        outputs = {name: found[name] or "" for name in ("verdict", "reference", "digest", "key")}
        names = [*found["tags"], *(name for name in found["promoted"] if name not in found["tags"])]
        return outputs | {"image-id": found["id"] or "", "built": found["built"], "tags": names}

    def sentence(self) -> str:
        """What came of it in one line."""
        if self.failure is not None:
            return f"fail: {self.failure.headline}"
        names = _names(self.promoted)
        if self.image is None:
            return f"pass: {self.reference} is promoted to {names}"
        how = "built" if self.image.built else f"unchanged, found {_PLACES[self.image.found_in]}"
        promoted = f", promoted to {names}" if names else ""
        return f"pass: {self.image.reference}: {how}{promoted} ({self.seconds:.1f} s)"

    def markdown(self) -> str:
        """The step's summary."""
        text = f"## build-image: {escape_markdown(self.sentence())}\n\n"
        if self.failure is not None:
            return text + (code_block("\n".join(self.failure.lines)) if self.failure.lines else "")
        found = self.document()
        rows = [
            ("Image", found["reference"]),
            ("Digest", found["digest"]),
            ("Tags", _names(found["tags"])),
            ("Promoted to", _names(found["promoted"])),
            ("Content key", found["key"]),
        ]
        return text + markdown_table(("", ""), [(name, value) for name, value in rows if value])


_PLACES = {"local": "on the engine", "registry": "in the registry", None: ""}


def _names(names: Sequence[str]) -> str:
    return ", ".join(names)
