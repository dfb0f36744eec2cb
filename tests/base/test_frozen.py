"""Frozen classes behave as the standard library's frozen dataclasses, from the first call of any method on."""

import copy
import dataclasses
import pickle
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import FrozenInstanceError, dataclass, field
from functools import cached_property
from threading import Barrier
from typing import Any, Generic, TypeVar

import pytest

from calibration.base.frozen import frozen

T = TypeVar("T")


def pair(*, eq: bool = True, kw_only: bool = False) -> list[Any]:
    """The same class, made by us and by the standard library."""

    def declared(decorator: Callable[[type], type]) -> type:
        class Point:
            """A point."""

            x: float
            y: float = 0.0
            tags: list[str] = field(default_factory=list, compare=False)
            secret: str = field(default="s", repr=False)

            def __post_init__(self) -> None:
                if self.x < 0:
                    raise ValueError("negative")

            @cached_property
            def norm(self) -> float:
                return float(abs(complex(self.x, self.y)))

        return decorator(Point)

    return [declared(frozen(eq=eq, kw_only=kw_only)), declared(dataclass(frozen=True, eq=eq, kw_only=kw_only))]


@frozen
class Named:
    """At the top of a module, as pickle needs it."""

    name: str
    numbers: tuple[int, ...] = ()


@frozen
class Held(Generic[T]):
    """With a type variable."""

    value: T


@dataclass(frozen=True)
class Longer(Named):
    """One that the standard library makes of one of ours."""

    more: int = 0


@frozen
class Longest(Longer):
    """The other way round."""

    most: int = 0


@pytest.mark.parametrize("number", [0, 1])
def test_it_is_constructed_compared_and_shown_like_a_dataclass(number: int) -> None:
    Point = pair()[number]
    assert repr(Point(1.0)).endswith("Point(x=1.0, y=0.0, tags=[])")
    assert Point(1.0, tags=["a"]) == Point(1.0, tags=["b"]) != Point(1.0, 2.0)
    assert Point(1.0) != (1.0, 0.0)
    assert hash(Point(1.0)) == hash(Point(x=1.0, y=0.0))
    assert Point(1.0).tags is not Point(1.0).tags
    assert dataclasses.replace(Point(3.0), y=4.0).norm == 5.0
    assert dataclasses.asdict(Point(1.0)) == {"x": 1.0, "y": 0.0, "tags": [], "secret": "s"}
    assert Point.__match_args__ == ("x", "y", "tags", "secret")
    assert (Point.y, Point.secret) == (0.0, "s")
    assert not hasattr(Point, "x")
    for negative in ((-1.0,), (-1.0, 0.0, [], "s")):
        with pytest.raises(ValueError, match="negative"):
            Point(*negative)
    for call in (
        Point,
        lambda: Point(y=1.0),
        lambda: Point(1.0, z=2.0),
        lambda: Point(1.0, x=2.0),
        lambda: Point(1.0, 2.0, [], "s", x=2.0),
    ):
        with pytest.raises(TypeError, match=r"Point\.__init__\(\)"):
            call()
    with pytest.raises(TypeError, match=r"missing .*x"):
        Point()
    with pytest.raises(TypeError, match=r"unexpected .*z"):
        Point(1.0, z=2.0)
    with pytest.raises(TypeError, match=r"positional arguments|twice"):
        Point(1.0, 2.0, [], "s", 5)


@pytest.mark.parametrize("number", [0, 1])
def test_the_options_are_those_of_a_dataclass(number: int) -> None:
    by_name, by_identity = pair(kw_only=True)[number], pair(eq=False)[number]
    for given in ((1.0,), (1.0, 2.0, [], "s")):
        with pytest.raises(TypeError, match="positional"):
            by_name(*given)
    assert by_name(x=1.0).x == 1.0
    assert by_identity(1.0) != by_identity(1.0)
    assert len({by_identity(1.0), by_identity(1.0)}) == 2


@pytest.mark.parametrize("number", [0, 1])
def test_an_instance_does_not_change(number: int) -> None:
    point = pair()[number](1.0)
    for name in ("x", "other"):
        with pytest.raises(FrozenInstanceError, match=f"cannot assign to field '{name}'"):
            setattr(point, name, 2.0)
        with pytest.raises(FrozenInstanceError, match=f"cannot delete field '{name}'"):
            delattr(point, name)
    assert point.x == 1.0


@pytest.mark.parametrize("first", [repr, hash, lambda each: each == Named("n", (1,)), lambda each: {each: 1}[each]])
def test_an_instance_that_came_without_the_constructor_has_the_methods_too(first: Callable[[Any], object]) -> None:
    """As in the process that receives the result of a worker: pickle calls no constructor."""

    @frozen
    class Fresh:
        """Not used yet."""

        name: str

    bare = object.__new__(Fresh)
    bare.__dict__["name"] = "n"
    first(bare)
    assert bare == Fresh("n")
    assert (repr(bare), hash(bare)) == (repr(Fresh("n")), hash(Fresh("n")))
    restored = pickle.loads(pickle.dumps(Named("n", (1,))))  # noqa: S301 (our own)
    assert restored == Named("n", (1,)) == copy.deepcopy(Named("n", (1,)))


def test_a_method_of_its_own_is_kept() -> None:
    @frozen
    class Shown:
        """With a text of its own."""

        name: str

        def __repr__(self) -> str:
            return "mine"

    class Louder(Shown):
        """That asks its base for a method."""

        def __init__(self, name: str) -> None:
            super().__init__(name.upper())

    assert [Louder("n").name for _ in range(2)] == ["N", "N"]
    assert repr(Shown("n")) == "mine"
    assert Shown("n") == Shown("n") != Shown("m")


def test_classes_inherit_from_each_other_and_from_type_variables() -> None:
    longest = Longest("n", (), 1, 2)
    assert longest == Longest("n", (), 1, 2) != Longest("n")
    assert repr(longest) == "Longest(name='n', numbers=(), more=1, most=2)"
    assert Held[int](1) == Held(1)

    class Plain(Named):
        """No dataclass by itself."""

    assert isinstance(Plain("n"), Named)
    assert Plain("n").name == "n"
    assert Plain("n") == Plain("n") != Named("n") != Plain("n")
    with pytest.raises(FrozenInstanceError):
        Longest("n").name = "m"  # type: ignore[misc]


@frozen(slots=True)
class Small:
    """In little memory."""

    x: float
    tags: tuple[str, ...] = ()


def test_slots_have_no_room_for_others() -> None:
    small = Small(1.0)
    assert not hasattr(small, "__dict__")
    assert repr(small) == "Small(x=1.0, tags=())"
    assert small == Small(1.0, tags=()) != Small(2.0)
    assert len({small, Small(1.0)}) == 1
    assert small == dataclasses.replace(Small(2.0), x=1.0) == copy.deepcopy(small) == pickle.loads(pickle.dumps(small))  # noqa: S301 (our own)
    with pytest.raises(FrozenInstanceError):
        small.x = 2.0  # type: ignore[misc]


def test_several_threads_may_be_first() -> None:
    for _ in range(20):
        (Point, _), barrier = pair(), Barrier(4)

        def make(number: int, of: Any = Point, together: Barrier = barrier) -> Any:
            together.wait()
            return of(float(number)), repr(of(1.0)), of(2.0) == of(2.0)

        with ThreadPoolExecutor(4) as pool:
            made = list(pool.map(make, range(4)))
        assert [point.x for point, *_ in made] == [0.0, 1.0, 2.0, 3.0]
        assert {tuple(rest) for _, *rest in made} == {(repr(Point(1.0)), True)}


def test_methods_are_made_at_the_first_call_and_only_those_that_are_called() -> None:
    Point, _ = pair()
    stand_ins = {name: getattr(Point, name) for name in ("__init__", "__eq__")}
    assert Point(1.0).x == 1.0
    assert Point.__init__ is not stand_ins["__init__"]
    assert Point.__eq__ is stand_ins["__eq__"]
