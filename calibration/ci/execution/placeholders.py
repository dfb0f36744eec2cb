"""Placeholders in commands, such as ``{seed}``, replaced in each argument separately, without a shell."""

import re
import shlex
from collections.abc import Mapping, Sequence

from calibration.base.errors import InputError
from calibration.base.text import did_you_mean, shorten

_BRACED_TEXT = r"\{\{|\}\}|\{([^{}]*)\}|[{}]"


def fill(arguments: Sequence[str], values: Mapping[str, str], where: str) -> tuple[str, ...]:
    """Replace ``{name}`` by its value in each argument; ``{{`` and ``}}`` are literal braces.

    An argument remains one argument, whatever the value.

    Raises:
        InputError: unknown name, or a single brace; the message contains the argument.
    """

    def replacement(match: re.Match[str]) -> str:
        found, name = match[0], match[1]
        if found in ("{{", "}}"):
            return found[0]
        if name in values:
            return values[name]
        if name is None:
            raise InputError(f"{where}: a single '{found}' in '{shorten(match.string)}': write {found * 2} for a brace")
        raise InputError(
            f"{where}: there is no placeholder '{{{shorten(name)}}}'{did_you_mean(name, values)} "
            f"(known: {', '.join(values) or 'none'}; write {{{{ and }}}} for braces)"
        )

    return tuple(re.sub(_BRACED_TEXT, replacement, argument) for argument in arguments)


def split_command(command: str | Sequence[str], where: str) -> tuple[str, ...]:
    """Convert a command to arguments: a string is split as in a shell, a list is unchanged.

    No other syntax of a shell is supported: no variables, no ``&&``, no ``>``. Call it before :func:`fill`.

    Raises:
        InputError: the quoting is wrong, it is empty, or an argument is not a string.
    """
    arguments = _split_words(command, where) if isinstance(command, str) else tuple(command)
    for argument in arguments:
        if not isinstance(argument, str):
            raise InputError(f"{where}: found {argument!r} among the arguments, expected strings: put it in quotes")
        if "\0" in argument:
            raise InputError(f"{where}: {argument!r} has a NUL character, which no argument can have")
    if not arguments:
        raise InputError(f"{where}: the command is empty")
    return arguments


def _split_words(text: str, where: str) -> tuple[str, ...]:
    try:
        return tuple(shlex.split(text))
    except ValueError as error:
        raise InputError(f"{where}: '{shorten(text)}' cannot be split into arguments: {error}") from None
