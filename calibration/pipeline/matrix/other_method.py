"""A method that a system is compared with."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from calibration.engine.comparison.methods import Method


def other_method(name: str) -> "Method":
    """Return the comparison method with this name.

    Raises:
        InputError: there is no such method.
    """
    from calibration.engine.comparison.methods import method_of  # most matrices compare with no other method

    return method_of(name)
