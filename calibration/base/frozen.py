"""Frozen dataclasses whose methods are made when one of them is first called.

`dataclasses.dataclass` compiles up to six methods for a frozen class, which takes 0.3 ms; for the 230 classes that a
command imports, half of its start. Most of them have no instance in a run, and cost nothing here; the methods of the
others are closures over the names of their fields, of which nothing is compiled.
"""

import dataclasses
from collections.abc import Callable
from reprlib import recursive_repr
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
        slots: whether instances have no room for other attributes.
    """

    def declare(cls: Any) -> Any:
        own = {name: value for name, value in vars(cls).items() if name not in ("__dict__", "__weakref__")}
        made = _with_slots(cls, kw_only) if slots else _with_lazy_fields(cls, own, kw_only)
        made.__setattr__, made.__delattr__ = _refuse_setting, _refuse_deleting
        for name, make in _METHODS.items():
            if name not in own and (eq or name not in _COMPARING):
                setattr(made, name, _stand_in(made, name, make))
        return made

    return declare if cls is None else declare(cls)


def _with_slots(cls: Any, kw_only: bool) -> Any:
    """Return a dataclass with slots, without methods other than those for pickle."""
    made: Any = dataclasses.dataclass(init=False, repr=False, eq=False, kw_only=kw_only, slots=True)(cls)
    made.__dataclass_params__.frozen = True
    made.__getstate__, made.__setstate__ = _slots_state, _set_slots
    return made


def _slots_state(self: Any) -> dict[str, Any]:
    return {each.name: getattr(self, each.name) for each in dataclasses.fields(self)}


def _set_slots(self: Any, state: dict[str, Any]) -> None:
    for name, value in state.items():
        object.__setattr__(self, name, value)


def _with_lazy_fields(cls: Any, own: dict[str, Any], kw_only: bool) -> Any:
    """Make a class a dataclass whose `_LAZY` attributes, which `dataclasses` reads, are found when first read."""

    def made() -> Any:  # on a copy, as the class is in use
        copy = type(cls)(cls.__name__, cls.__bases__, own)
        inherits = any(map(dataclasses.is_dataclass, cls.__bases__))
        # frozen where its bases are, as they must agree; else not, as two methods would be compiled for that
        return dataclasses.dataclass(init=False, repr=False, eq=False, kw_only=kw_only, frozen=inherits)(copy)

    for name, value in own.items():
        if isinstance(value, dataclasses.Field):
            if value.default is dataclasses.MISSING:
                delattr(cls, name)
            else:
                setattr(cls, name, value.default)
    for name in _LAZY:
        setattr(cls, name, _LazyAttribute(cls, name, made))
    return cls


_LAZY = ("__dataclass_fields__", "__dataclass_params__", "__match_args__")
"""What `dataclasses.dataclass` adds to a class beside its methods."""


class _LazyAttribute:
    """Attribute of a class that is found when it is first read, with the others of `_LAZY`."""

    def __init__(self, cls: Any, name: str, make: Callable[[], Any]) -> None:
        self._class = cls
        self._name = name
        self._make = make

    def __get__(self, _: object, __: object = None) -> Any:
        made = self._make()
        made.__dataclass_params__.frozen = True
        for name in _LAZY:
            setattr(self._class, name, getattr(made, name))
        return getattr(made, self._name)


def _stand_in(cls: Any, name: str, make: Callable[[Any], Callable[..., Any]]) -> Callable[..., Any]:
    """Return a method that replaces itself, at its first call, by the one that is made."""

    def method(self: Any, /, *arguments: Any, **named: Any) -> Any:
        made = make(cls)
        made.__name__, made.__qualname__ = name, f"{cls.__qualname__}.{name}"
        setattr(cls, name, made)
        return made(self, *arguments, **named)

    return method


def _constructor(cls: Any) -> Callable[..., None]:
    fields = dataclasses.fields(cls)
    names = {each.name for each in fields}
    positional = [each.name for each in fields if not each.kw_only]
    defaults = {each.name: each.default for each in fields if each.default is not dataclasses.MISSING}
    factories = {e.name: e.default_factory for e in fields if e.default_factory is not dataclasses.MISSING}
    has_slots, has_post_init = "__slots__" in vars(cls), hasattr(cls, "__post_init__")

    def completed(given: tuple[Any, ...], named: dict[str, Any]) -> dict[str, Any]:
        values = dict(zip(positional, given, strict=False))
        values.update(named)
        if len(values) < len(given) + len(named):
            raise TypeError(f"{cls.__qualname__}.__init__() got too many positional arguments, or one twice")
        if len(values) < len(names):
            values = {**defaults, **values}
            for name in factories.keys() - values.keys():
                values[name] = factories[name]()
        if values.keys() != names:
            raise TypeError(f"{cls.__qualname__}.__init__() {_difference(set(values), names)}")
        return values

    def constructor(self: Any, /, *given: Any, **named: Any) -> None:
        all_in_order = len(given) == len(positional) == len(names) and not named  # most often, and fast
        values = zip(positional, given, strict=True) if all_in_order else completed(given, named).items()
        if has_slots:
            for name, value in values:
                object.__setattr__(self, name, value)
        else:
            self.__dict__.update(values)
        if has_post_init:
            self.__post_init__()

    return constructor


def _difference(found: set[str], names: set[str]) -> str:
    if unknown := sorted(found - names):
        return f"got unexpected arguments: {', '.join(unknown)}"
    return f"is missing arguments: {', '.join(sorted(names - found))}"


def _representation(cls: Any) -> Callable[..., str]:
    names = [each.name for each in dataclasses.fields(cls) if each.repr]

    @recursive_repr()
    def representation(self: Any) -> str:
        return f"{type(self).__qualname__}({', '.join(f'{name}={getattr(self, name)!r}' for name in names)})"

    return representation


def _equality(cls: Any) -> Callable[..., Any]:
    names = [each.name for each in dataclasses.fields(cls) if each.compare]

    def equality(self: Any, other: object) -> Any:
        if type(other) is not type(self):
            return NotImplemented
        return _values(self, names) == _values(other, names)

    return equality


def _hash(cls: Any) -> Callable[..., int]:
    names = [each.name for each in dataclasses.fields(cls) if (each.compare if each.hash is None else each.hash)]
    return lambda self: hash(_values(self, names))


def _values(instance: object, names: list[str]) -> tuple[Any, ...]:
    return tuple([getattr(instance, name) for name in names])


_METHODS: dict[str, Callable[[Any], Callable[..., Any]]] = {
    "__init__": _constructor,
    "__repr__": _representation,
    "__eq__": _equality,
    "__hash__": _hash,
}
"""What makes each method, if a class does not define it itself."""
_COMPARING = ("__eq__", "__hash__")


def _refuse_setting(_: Any, name: str, __: object) -> None:
    raise dataclasses.FrozenInstanceError(f"cannot assign to field {name!r}")


def _refuse_deleting(_: Any, name: str) -> None:
    raise dataclasses.FrozenInstanceError(f"cannot delete field {name!r}")
