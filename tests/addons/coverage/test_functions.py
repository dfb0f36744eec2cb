import pytest

from calibration.addons.coverage.sources import functions_of

SOURCE = b'''"""Module."""
import functools


@functools.lru_cache(
    maxsize=None
)
def outer(a, /, b, *rest, c, **more):
    """Doc."""
    def inner():
        return 1 + a
    return inner


class Arm:
    def move(self): return self.x + 1

    async def drive(self):
        await self.x


def values():
    if True:
        yield 1
'''


def test_functions_of_a_file() -> None:
    found = {each.name: each for each in functions_of("a.py", SOURCE)}
    assert list(found) == ["outer", "outer.inner", "Arm.move", "Arm.drive", "values"]
    outer = found["outer"]
    assert (outer.first, outer.line, outer.column, outer.last) == (5, 8, 0, 12)
    assert outer.own_lines == {9, 10, 12}  # line 11 is that of the function within it
    assert outer.parameters == ("a", "b", "rest", "c", "more")
    assert outer.decorators == ("lru_cache",)
    assert found["Arm.move"].own_lines == frozenset()  # whether it is run cannot be told by its line
    assert [name for name, each in found.items() if each.generator] == ["values"]
    assert not any(each.trivial for each in found.values())


@pytest.mark.parametrize("source", [b"def f(:", b"\0", b"(" * 10000, b"\xff\xfe"])
def test_what_is_no_python_has_no_functions(source: bytes) -> None:
    assert functions_of("a.py", source) == []


@pytest.mark.parametrize(
    ("source", "trivial"),
    [
        ("def f(): pass", True),
        ("def f():\n '''Text.'''\n ...", True),
        ("def f(): raise NotImplementedError", True),
        ("def f(): return None", True),
        ("def f(): return 7", True),
        ("def f(self): return self._x", True),
        ("def f(self, x): self._x = x", True),
        ("@abc.abstractmethod\ndef f(self): return self.x + 1", True),
        ("@overload\ndef f(self): return self.x + 1", True),
        ("def __repr__(self): return str(self.x)", True),
        ("def f(self): return self._x.y", False),
        ("def f(x): return x + 1", False),
        ("def f(x): print(x)", False),
        ("def f(self, x): self.x = x + 1", False),
        ("def f(self, x):\n self.x = x\n self.y = x", False),
    ],
)
def test_functions_without_anything_to_test(source: str, trivial: bool) -> None:
    [function] = functions_of("a.py", source.encode())
    assert function.trivial is trivial
