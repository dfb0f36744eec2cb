"""Mappings of RoboMaker's, whose keys come in two spellings: Rigel's ``iam_role``, the service's ``iamRole``."""

import re
from collections.abc import Iterator, Mapping
from typing import Any

from calibration.rigel.document import list_at, mapping_at, text_at, truth_at

_SAME = {
    "max_job_duration_in_seconds": "simulation_duration",
    "robot_applications": "robot_application",
    "simulation_applications": "simulation_application",
    "exit_behaviour": "exit_behavior",
}
"""What Rigel calls otherwise."""


def plain_key(key: str) -> str:
    """One spelling for both: ``s3Bucket`` and ``s3_bucket`` give ``s3_bucket``."""
    found = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", key).lower()
    return _SAME.get(found, found)


class Fields:
    """The fields of a mapping; each is taken once, and `left` names those that nobody has taken."""

    def __init__(self, value: object, where: str) -> None:
        """Take a mapping, or nothing.

        Raises:
            InputError: it is something else.
        """
        self.where = where
        self._left = {plain_key(key): (key, entry) for key, entry in mapping_at(value, where).items()}
        self._written = {plain: key for plain, (key, _) in self._left.items()}

    def at(self, key: str) -> str:
        """Where a field is, as it is spelled there."""
        return f"{self.where}.{self._written.get(key, key)}".removeprefix(".")

    def take(self, key: str) -> Any:
        """A field; None where there is none."""
        return self._left.pop(key, (key, None))[1]

    def fields(self, key: str) -> "Fields":
        """A mapping in it; the only one of a list.

        Raises:
            InputError: it is something else.
        """
        value = self.take(key)
        if isinstance(value, list) and len(value) == 1:
            return Fields(value[0], f"{self.at(key)}.0")
        return Fields(value, self.at(key))

    def several(self, key: str) -> list["Fields"]:
        """The mappings of a list.

        Raises:
            InputError: it is no list, or has something else.
        """
        return [Fields(entry, f"{self.at(key)}.{i}") for i, entry in enumerate(list_at(self.take(key), self.at(key)))]

    def mapping(self, key: str) -> Mapping[str, Any]:
        """A mapping whose keys are the user's own.

        Raises:
            InputError: it is something else.
        """
        return mapping_at(self.take(key), self.at(key))

    def text(self, key: str, default: str = "") -> str:
        """A text.

        Raises:
            InputError: it is something else.
        """
        value = self.take(key)
        return default if value is None else text_at(value, self.at(key))

    def texts(self, key: str) -> list[str]:
        """The texts of a list.

        Raises:
            InputError: it is no list, or has something else.
        """
        return [text_at(item, self.at(key)) for item in list_at(self.take(key), self.at(key))]

    def truth(self, key: str) -> bool | None:
        """Whether something is so; None where nothing is said.

        Raises:
            InputError: it is neither true nor false.
        """
        value = self.take(key)
        return None if value is None else truth_at(value, self.at(key))

    def left(self) -> Iterator[str]:
        """Where the fields are that nobody has taken; they are taken by this."""
        for key in list(self._left):
            del self._left[key]
            yield self.at(key)

    def __bool__(self) -> bool:
        return bool(self._left)
