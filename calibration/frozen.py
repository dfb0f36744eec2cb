"""Frozen dataclasses whose methods are made when one of them is first called.

`dataclasses.dataclass` compiles up to six methods for a frozen class, which takes 0.3 ms; for the 230 classes that a
command imports, half of its start. Most of them have no instance in a run, and cost nothing here.
"""

import dataclasses
from collections.abc import Callable, Collection, Mapping
from typing import Any, TypeVar, dataclass_transform, overload

_Class = TypeVar("_Class", bound=type)


@overload
def frozen(cls: _Class, /) -> _Class: ...
@overload
def frozen(*, eq: bool = True, kw_only: bool = False, slots: bool = False) -> Callable[[_Class], _Class]: ...
@dataclass_transform(frozen_default=True, field_specifiers=(dataclasses.field,))
def frozen(cls: Any = None, /, *, eq: bool = True, kw_only: bool = False, slots: bool = False) -> Any:
    """Make a class a frozen dataclass, as ``dataclass(frozen=True)`` does, whose methods are made at their first use.

    Args:
        cls: the class.
        eq: whether instances are compared by their fields.
        kw_only: whether the constructor takes its arguments by name only.
        slots: whether instances have no room for other attributes; such a class is made at once.
    """

    def declare(cls: Any) -> Any:
        if slots:
            return dataclasses.dataclass(frozen=True, eq=eq, kw_only=kw_only, slots=slots)(cls)
        return _declared(cls, eq, kw_only)

    return declare if cls is None else declare(cls)


def _declared(cls: Any, eq: bool, kw_only: bool) -> Any:
    """Give a class a stand-in for each method that it does not define itself, and for what `dataclasses` asks it."""
    own = {name: value for name, value in vars(cls).items() if name not in ("__dict__", "__weakref__")}

    def made(**options: bool) -> Any:  # on a copy, as the class is in use
        copy = type(cls)(cls.__name__, cls.__bases__, own)
        frozen = any(map(dataclasses.is_dataclass, cls.__bases__))  # as its bases are, else not, which takes longer
        return dataclasses.dataclass(init=False, kw_only=kw_only, frozen=frozen, **options)(copy)

    for name, value in own.items():
        if isinstance(value, dataclasses.Field):
            if value.default is dataclasses.MISSING:
                delattr(cls, name)
            else:
                setattr(cls, name, value.default)
    for name in _ASKED:
        setattr(cls, name, _Asked(cls, name, lambda: made(repr=False, eq=False)))
    cls.__setattr__, cls.__delattr__ = _refuse_setting, _refuse_deleting
    if "__init__" not in own:
        _stand_in(cls, {"__init__"}, lambda: {"__init__": _constructor(cls)})
    others = {"__repr__", "__eq__", "__hash__"} if eq else {"__repr__"}
    _stand_in(cls, others - own.keys(), lambda: vars(made(eq=eq, unsafe_hash=eq)))
    return cls


def _constructor(cls: Any) -> Callable[..., None]:
    """Return a frozen dataclass's ``__init__``.

    It is a closure over the names and defaults of the fields: `dataclasses` compiles one for each class, which takes as
    long as hundreds of calls.
    """
    fields = dataclasses.fields(cls)
    names = {each.name for each in fields}
    positional = [each.name for each in fields if not each.kw_only]
    defaults = {each.name: each.default for each in fields if each.default is not dataclasses.MISSING}
    factories = {e.name: e.default_factory for e in fields if e.default_factory is not dataclasses.MISSING}
    has_more = hasattr(cls, "__post_init__")

    def constructor(self: Any, /, *given: Any, **named: Any) -> None:
        values = dict(zip(positional, given, strict=False))
        values.update(named)
        if len(values) < len(given) + len(named):
            raise TypeError(f"{cls.__qualname__}.__init__() got too many positional arguments, or one twice")
        if len(values) < len(names):
            values = {**defaults, **values}
            for name in factories.keys() - values.keys():
                values[name] = factories[name]()
        if values.keys() != names:
            raise _wrong_names(cls, values)
        self.__dict__.update(values)
        if has_more:
            self.__post_init__()

    constructor.__name__, constructor.__qualname__ = "__init__", f"{cls.__qualname__}.__init__"
    return constructor


def _wrong_names(cls: Any, values: Mapping[str, Any]) -> TypeError:
    names = [each.name for each in dataclasses.fields(cls)]
    if unknown := [name for name in values if name not in names]:
        return TypeError(f"{cls.__qualname__}.__init__() got unexpected arguments: {', '.join(unknown)}")
    missing = [name for name in names if name not in values]
    return TypeError(f"{cls.__qualname__}.__init__() is missing arguments: {', '.join(missing)}")


_ASKED = ("__dataclass_fields__", "__dataclass_params__", "__match_args__")


class _Asked:
    """Attribute of a class that is found when it is first asked for, with the others of `_ASKED`."""

    def __init__(self, cls: Any, name: str, make: Callable[[], Any]) -> None:
        self._class = cls
        self._name = name
        self._make = make

    def __get__(self, _: object, __: object = None) -> Any:
        made = self._make()
        made.__dataclass_params__.frozen = True
        for name in _ASKED:
            setattr(self._class, name, getattr(made, name))
        return getattr(made, self._name)


def _stand_in(cls: Any, names: Collection[str], make: Callable[[], Mapping[str, Any]]) -> None:
    """Give a class methods that replace themselves, at the first call of one, by those that are made."""

    def stand_in(name: str) -> Callable[..., Any]:
        def method(self: Any, *arguments: Any, **named: Any) -> Any:
            methods = make()
            for each in names:
                setattr(cls, each, methods[each])
            return methods[name](self, *arguments, **named)

        return method

    for name in names:
        setattr(cls, name, stand_in(name))


def _refuse_setting(_: Any, name: str, __: object) -> None:
    raise dataclasses.FrozenInstanceError(f"cannot assign to field {name!r}")


def _refuse_deleting(_: Any, name: str) -> None:
    raise dataclasses.FrozenInstanceError(f"cannot delete field {name!r}")
