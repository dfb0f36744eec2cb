"""Frozen dataclasses whose methods are made when one of them is first called.

`dataclasses.dataclass` compiles up to six methods for a frozen class, which takes 0.3 ms; for the 230 classes that a
command imports, half of its start. Most of them have no instance in a run, and cost nothing here.
"""

import dataclasses
from collections.abc import Callable, Collection
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
        slots: whether instances have no room for other attributes; such a class is made at once, as one is that
            inherits fields.
    """

    def declare(cls: Any) -> Any:
        if slots or any(map(dataclasses.is_dataclass, cls.__mro__[1:])):
            return dataclasses.dataclass(frozen=True, eq=eq, kw_only=kw_only, slots=slots)(cls)
        return _declared(cls, eq, kw_only)

    return declare if cls is None else declare(cls)


def _declared(cls: Any, eq: bool, kw_only: bool) -> Any:
    """Give a class its fields, and a stand-in for each method that it does not define itself."""
    own = {name: value for name, value in vars(cls).items() if name not in ("__dict__", "__weakref__")}

    def made(**options: bool) -> Any:  # on a copy, as the class is in use
        return dataclasses.dataclass(kw_only=kw_only, **options)(type(cls)(cls.__name__, cls.__bases__, own))

    dataclasses.dataclass(init=False, repr=False, eq=False, kw_only=kw_only)(cls)
    cls.__dataclass_params__.frozen = True
    cls.__setattr__, cls.__delattr__ = _refuse_setting, _refuse_deleting
    _stand_in(cls, {"__init__"} - own.keys(), lambda: made(frozen=True, repr=False, eq=False))
    others = {"__repr__", "__eq__", "__hash__"} if eq else {"__repr__"}
    _stand_in(cls, others - own.keys(), lambda: made(init=False, eq=eq, unsafe_hash=eq))
    return cls


def _stand_in(cls: Any, names: Collection[str], make: Callable[[], Any]) -> None:
    """Give a class methods that replace themselves, at the first call of one, by those of the class that is made."""

    def stand_in(name: str) -> Callable[..., Any]:
        def method(self: Any, *arguments: Any, **named: Any) -> Any:
            methods = vars(make())
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
