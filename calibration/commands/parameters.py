"""Types and options that commands share (``click.option("--min", type=number)``), and options of a record's fields.

A value comes from the command line or, in an action, from an environment variable, which is always a string:
so lists are single values with separators, and booleans can be written out.
"""

import json
import math
import os
import re
import typing
from collections.abc import Callable, Iterator, Mapping, MutableMapping, Sequence
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Literal, TypeVar

import click

from calibration.base import InputError
from calibration.base.records import Constraint, Converted, flat_fields, read
from calibration.ci.workflow import Runner, add_mask

SYSTEMS_FOLDER = Path("datasets")
"""Folder of named systems, relative to the working directory."""
PASSWORD_VARIABLE, PASSWORD_VARIABLE_IN_ACTIONS = "CALIBRATION_REGISTRY_PASSWORD", "INPUT_REGISTRY_PASSWORD"
"""Variables with a registry password; the first is also read by the command line."""
DEFAULT_ARTIFACT_NAME = "calibration"
NOISE_OPTION_OF_KEY = {"translation": "translation-noise", "rotation": "rotation-noise"}
"""Options of the noise whose names differ from its keys."""
_TRUTH_OF_WORD = {"true": True, "yes": True, "1": True, "false": False, "no": False, "0": False}
_LIST_SEPARATOR = re.compile(r"[,\r\n]")
_Item = TypeVar("_Item")
_Number = TypeVar("_Number", bound=float)
_Callback = TypeVar("_Callback", bound=Callable[..., Any])


def boolean(value: str | bool) -> bool:
    """Parse true, false, yes, no, 1 or 0 in any case; a usage error for anything else."""
    truth = _TRUTH_OF_WORD.get(str(value).strip().lower())
    if truth is None:
        raise click.BadParameter(f"{value!r} is neither true nor false")
    return truth


def artifact_name(value: str) -> str:
    """Parse the prefix of all artifact names of a run; a usage error if it could match artifacts of another run.

    The workflow appends a tilde, and downloads NAME~*: so names contain neither a tilde nor wildcards.
    """
    if not re.fullmatch(r"[A-Za-z0-9._-]{1,100}", value):
        raise click.BadParameter(f"{value!r}: expected up to 100 letters, digits, dots, dashes and underscores")
    return value


def _number_type(
    name: str, kind: Callable[[Any], _Number], what: str, least: float | None = None, most: float | None = None
) -> Callable[[str | float], _Number]:
    """Return a type for finite numbers within bounds; a usage error for anything else."""

    def parse(value: str | float) -> _Number:
        problem = click.BadParameter(f"{value!r} is not a {what}")
        try:
            found = kind(value)
        except ValueError:
            raise problem from None
        if not -math.inf < found < math.inf:  # nor is NaN
            raise problem
        if least is not None and found < least:
            raise click.BadParameter(f"{value!r} is below {least:g}")
        if most is not None and found > most:
            raise click.BadParameter(f"{value!r} is above {most:g}")
        return found

    parse.__name__ = name  # shown by --help
    return parse


number = _number_type("number", float, "finite number")
non_negative = _number_type("non_negative", float, "finite number", 0)
share = _number_type("share", float, "finite number", 0, 1)
integer = _number_type("integer", int, "whole number")
count = _number_type("count", int, "whole number", 1)


def text(value: str) -> str:
    """Strip white space from a text."""
    return value.strip()


def path(value: str | Path) -> Path:
    """Convert to a path, which need not exist: commands check what they need."""
    return Path(value)


def list_of(item: Callable[[str], _Item]) -> Callable[[str | Sequence[_Item]], tuple[_Item, ...]]:
    """Return a type for lists of items separated by commas or new lines; empty items are dropped.

    White space around items is stripped. Values that ``item`` refuses are usage errors.
    """

    def items(value: str | Sequence[_Item]) -> tuple[_Item, ...]:
        if not isinstance(value, str):
            return tuple(value)
        texts = (part.strip() for part in _LIST_SEPARATOR.split(value))
        return tuple(item(part) for part in texts if part)

    items.__name__ = f"{item.__name__},..."  # shown by --help
    return items


def assignments(value: str | Mapping[str, str]) -> Mapping[str, str]:
    """Parse NAME=VALUE, separated by commas or new lines; a usage error for other texts."""
    if not isinstance(value, str):
        return value
    found = {}
    for part in TEXT_LIST(value):
        name, equals, content = part.partition("=")
        if not name.strip() or not equals:
            raise click.BadParameter(f"{part!r}: expected NAME=VALUE")
        found[name.strip()] = content.strip()
    return found


TEXT_LIST = list_of(text)
INTEGER_LIST = list_of(integer)
PATH_LIST = list_of(path)


class ActionInput(click.Option):
    """Option whose input of an action is deprecated: a key of calibration.yml says it now, or it has another name.

    As an option of the command line it stays.
    """

    def __init__(self, *args: Any, instead: str = "", written: Any = None, formerly: str = "", **settings: Any) -> None:
        """Create the option.

        Args:
            args: as of `click.Option`.
            instead: the key of calibration.yml that replaces the input, such as ``systems.NAME.evaluate``.
            written: what that key gets, where it is not the value of the input.
            formerly: former name of the option and the input.
            settings: as of `click.Option`.
        """
        super().__init__(*args, **settings)
        self.instead, self.written, self.formerly = instead, written, formerly

    def get_help_record(self, ctx: click.Context) -> tuple[str, str] | None:
        """Return the line of ``--help``, without the former name."""
        shown = super().get_help_record(ctx)
        return shown and (shown[0].replace(f", --{self.formerly}", ""), shown[1])


def _variable_of_input(name: str) -> str:
    return f"INPUT_{name.upper().replace('-', '_')}"


def take_former_inputs(command: click.Command, environment: MutableMapping[str, str]) -> Iterator[str]:
    """Give the variables of inputs with a former name the present one, and yield a line about each for the user."""
    for option in command.params:
        if isinstance(option, ActionInput) and (value := environment.get(_variable_of_input(option.formerly))):
            name = option.opts[0].removeprefix("--")
            if not environment.get(_variable_of_input(name)):
                environment[_variable_of_input(name)] = value
            yield f"input '{option.formerly}' is deprecated: write {name}"


def deprecated_inputs(context: click.Context) -> Iterator[str]:
    """Yield a line for each given input of an action that calibration.yml replaces: what to write there."""
    for option in context.command.params:
        if not isinstance(option, ActionInput) or not option.instead or option.name is None:
            continue
        value = context.params[option.name]
        if value is False or context.get_parameter_source(option.name) is not click.core.ParameterSource.ENVIRONMENT:
            continue
        value = _in_document(value) if option.written is None else option.written
        for key in reversed(option.instead.split(".")):
            value = {key: value}
        text = json.dumps(value, ensure_ascii=False)  # YAML too
        yield f"input '{option.opts[0].removeprefix('--')}' is deprecated: write in calibration.yml {text}"


def boolean_option(
    *names: str,
    help: str,  # noqa: A002 (click's word)
    default: bool | None = False,
    **settings: Any,
) -> Callable[[_Callback], _Callback]:
    """Declare an option that can be written ``--flag``, ``--flag true`` or ``--flag no``."""

    def or_default(_context: click.Context, _option: click.Parameter, value: bool | None) -> bool | None:
        return default if value is None else value

    # Not with click's default parameter: with it, click 8.3.0 and 8.3.1 require a value after the flag.
    return click.option(
        *names, type=boolean, is_flag=False, flag_value="true", callback=or_default, help=help, **settings
    )


def find_system(system: str) -> Path | None:
    """Return the folder of a system by its name in `SYSTEMS_FOLDER` or by its path; None if it does not exist."""
    return next((folder for folder in (SYSTEMS_FOLDER / system, Path(system)) if system and folder.is_dir()), None)


def system_folder(system: str) -> Path:
    """Return the folder of a system, as `find_system` does.

    Raises:
        InputError: it does not exist.
    """
    if (folder := find_system(system)) is not None:
        return folder
    known = sorted(folder.parent.name for folder in SYSTEMS_FOLDER.glob("*/simulation.yml"))
    files = "a folder with robot.urdf, config.yml and simulation.yml"
    own = f"{files}; {Path.cwd()} has no {SYSTEMS_FOLDER}/ of systems by name"
    names = f"one of {', '.join(known)} or a folder" if known else own
    raise InputError(f"system: found '{system}', expected {names}")


registry_password_option = click.option(
    "--registry-password",
    envvar=PASSWORD_VARIABLE,
    help="Password or token of this user; on a command line by the variable CALIBRATION_REGISTRY_PASSWORD instead.",
)
"""Option for a registry password, to be passed to `password_variable`."""


def masked_secret(context: click.Context, name: str, value: str | None, runner: Runner, place: str) -> str | None:
    """Return the value of a secret option, masked in the log; None if it is blank.

    Args:
        context: context of the command.
        name: the option, without dashes in front.
        value: its value.
        runner: the runner, which masks it.
        place: where it belongs instead of a command line, for the message.

    Raises:
        InputError: it is on the command line, where every process reads it.
    """
    if not value or not value.strip():
        return None
    add_mask(runner, value)
    if context.get_parameter_source(name.replace("-", "_")) is click.core.ParameterSource.COMMANDLINE:
        raise InputError(f"{name}: found on the command line, where every process reads it: put it into {place}")
    return value


def masked_token(context: click.Context, token: str | None, runner: Runner) -> str | None:
    """Return the token of the CI service, by option or by its own variable; raises as `masked_secret`."""
    variable = runner.service.token_variable
    return masked_secret(context, "token", token or os.environ.get(variable, "").strip(), runner, variable)


def password_variable(context: click.Context, password: str | None, runner: Runner) -> str | None:
    """Return the variable that has the registry password; None if there is none; raises as `masked_secret`."""
    place = f"the environment variable {PASSWORD_VARIABLE}"
    if masked_secret(context, "registry-password", password, runner, place) is None:
        return None
    return PASSWORD_VARIABLE if os.environ.get(PASSWORD_VARIABLE) else PASSWORD_VARIABLE_IN_ACTIONS


_Record = TypeVar("_Record")


def option_keys(kind: type) -> tuple[str, ...]:
    """Return the keys of a record, including its flat records, that are command line options."""
    return tuple(key for key, each in flat_fields(kind).items() if each.option is not False)


def record_options(
    kind: type,
    *keys: str,
    names: Mapping[str, str] | None = None,
    helps: Mapping[str, str] | None = None,
    required: bool = False,
    instead: str | None = None,
    **settings: str,
) -> Callable[[_Callback], _Callback]:
    """Decorate a command with options for fields of a record; booleans become flags.

    Args:
        kind: type of the record.
        keys: keys of the fields, in the order of the options; by default all of `option_keys`.
        names: names of options that differ from their keys, by key.
        helps: help of options that differs from the field's, by key.
        required: whether the options of required fields are required.
        instead: for options whose inputs calibration.yml replaces: the key there of the whole record, such as
            ``systems.NAME``, or empty for the file itself.
        settings: further ones of `ActionInput`.
    """
    fields = flat_fields(kind)

    def declare(command: _Callback) -> _Callback:
        for key in reversed(keys or option_keys(kind)):
            own = fields[key].option
            sentence = (helps or {}).get(key) or (own if isinstance(own, str) else fields[key].help)
            flags, base = [f"--{(names or {}).get(key, key)}"], fields[key].type
            more: dict[str, Any] = {"help": sentence, **settings}
            if former := settings.get("formerly", fields[key].formerly):
                flags.append(f"--{former}")
                more |= {"formerly": former}
            if instead is not None:
                more |= {"instead": f"{instead}.{key}".removeprefix(".")}
            if more.keys() - {"help"}:
                more |= {"cls": ActionInput}
            if bool in (base, *typing.get_args(base)):
                boolean_option(*flags, default=None, **more)(command)
            else:
                click.option(*flags, type=_type_of(base), required=required and fields[key].required, **more)(command)
        return command

    return declare


def given(kind: type, options: Mapping[str, Any], *keys: str, names: Mapping[str, str] | None = None) -> dict[str, Any]:
    """Convert values of options of `record_options` to a document; empty and missing options are omitted."""
    document: dict[str, Any] = {}
    for key in keys or option_keys(kind):
        value = options.get((names or {}).get(key, key).replace("-", "_"))
        if value not in (None, ()):
            document[key] = _in_document(value)
    return document


def _in_document(value: Any) -> Any:
    """Return the value of an option as a document has it: a text for a path, a list without repeats."""
    if isinstance(value, tuple):
        return [_in_document(each) for each in dict.fromkeys(value)]
    return str(value) if isinstance(value, Path) else value


def chosen(kind: type[_Record], options: Mapping[str, Any], **more: Any) -> _Record:
    """Convert the options of a command to a record of its inputs.

    Args:
        kind: type of the record, all of whose fields are options.
        options: options of the command.
        more: values of fields that are not options.

    Raises:
        InputError: an option is missing, or its value is wrong.
    """
    return read(kind, given(kind, options), "options", **more)


def _type_of(kind: Any, limits: tuple[Constraint, ...] = ()) -> Any:
    """Return click's type for values of a field's type."""
    origin, arguments = typing.get_origin(kind), typing.get_args(kind)
    if origin is typing.Annotated:
        special = next((each for each in arguments if isinstance(each, Converted)), None)
        own = tuple(each for each in arguments if isinstance(each, Constraint))
        return _type_of(special.accepts if special else arguments[0], (*limits, *own))
    if origin in (typing.Union, UnionType):
        return _type_of(next(each for each in arguments if each is not NoneType), limits)
    if origin is Literal:
        return click.Choice(list(dict.fromkeys(map(str, arguments))))
    if origin is tuple:
        return list_of(_type_of(arguments[0]))
    bounds = {name: value for limit in limits for name, value in limit.schema.items()}
    if kind is int:
        return count if bounds.get("minimum") == 1 else integer
    if kind is float:
        least, most = bounds.get("minimum"), bounds.get("maximum")
        return share if (least, most) == (0, 1) else non_negative if least == 0 else number
    return path if kind is Path else text
