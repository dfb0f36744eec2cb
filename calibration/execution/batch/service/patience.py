"""AWS may be away for a while: what was asked is asked again until it has been away too long."""

import random
import time
from collections.abc import Callable
from typing import TypeVar

from calibration.aws_errors import AwsLostError

Result = TypeVar("Result")

PATIENCE = 300.0
"""Seconds that AWS may be away, beyond what boto3 tries by itself."""
_FIRST, _LONGEST = 1.0, 30.0


class Patience:
    """How long something that answered before has not answered."""

    def __init__(self, seconds: float = PATIENCE) -> None:
        self._seconds = seconds
        self._since: float | None = None
        self._delay = _FIRST

    def answered(self) -> None:
        """Note that it did."""
        self._since, self._delay = None, _FIRST

    def failed(self, error: AwsLostError) -> float:
        """Note that it did not.

        Returns:
            Seconds after which it may be asked again.

        Raises:
            AwsLostError: it has been away too long.
        """
        now = time.monotonic()
        self._since = now if self._since is None else self._since
        if now - self._since >= self._seconds:
            raise error
        delay, self._delay = self._delay, min(_LONGEST, 2 * self._delay)
        return delay * random.uniform(0.75, 1.25)  # noqa: S311 (so that many do not come at the same moment)


def patiently(ask: Callable[[], Result], go_on: Callable[[], bool] = lambda: True) -> Result:
    """Ask until there is an answer.

    Args:
        ask: what may raise `AwsLostError`.
        go_on: whether it is worth asking again.

    Raises:
        AwsLostError: AWS has been away too long.
    """
    patience = Patience()
    while True:
        try:
            return ask()
        except AwsLostError as error:
            delay = patience.failed(error)
            if not go_on():
                raise
            time.sleep(delay)
