"""Changes of a file by a seed: bytes turned over, pieces doubled or gone, values that nobody expects."""

import random
import re

WORDS = (
    *("0", "-1", "1e308", "-1e308", "1e20", "1e-320", "NaN", "Infinity", "9" * 400, "0.1", "18446744073709551616"),
    *(
        "null",
        "true",
        "[]",
        "{}",
        '""',
        "[[]]",
        '"\\u0000"',
        '"../../x"',
        '"\\u202e"',
        "~",
        "*a",
        "&a",
        "!!python/none",
    ),
)
"""In the place of a value, in text."""
_YAML = (
    *(b"&a [*a]", b"*a", b"!!python/object:os.system x", b"!!binary ", b"<<: *x", b"? ", b"- ", b": ", b"|", b"---\n"),
    *(b"...\n", b"2024-13-45", b".nan", b".inf", b"0x", b"1_000", b"${HOME}", b"${", b"!!set {a}", b"\t", b"%YAML 9\n"),
    *(b"0o17", b"1:30", b"\xc2\x85", b"!!opencv-matrix", b"!!timestamp 1", b"!!omap [a]", b"!!float x", b"!!int x"),
    *(b"!!bool z", b"!!null x", b"? [a]\n: b\n", b"? {a: b}\n: c\n", b'"\\ud800"', b"9" * 5001, b"[" * 20_000),
)
_XML = (
    *(b'<!DOCTYPE x [<!ENTITY a "b">]>', b"&a;", b"<![CDATA[", b"<x>" * 200, b"<x>" * 20_000, b"\0", b"&#0;", b"<!--"),
    *(b'<?xml version="1.1" encoding="utf-7"?>', b"]]>", b"$(find x)", b"$(eval 1/0)", b"$(arg ", b"$(var x)"),
    *(b'xmlns:a="b"', b"<a:b/>", b"9" * 5001),
)
_CODE = (
    *(b"f'{", b"(" * 90, b"[" * 2000, b"lambda: " * 50, b"\\\n", b"\x0c", b"if x:\n" * 3, b"rospy.Publisher(", b"'''"),
    *(b"*a, **b", b"@", b"0o9", b"1e999999", b"9" * 5001, b"create_publisher(", b"${X}", b"if(", b"endif()"),
    *(b"foreach(x ${y})\n", b"function(f)\n", b"file(GLOB x *)\n", b"set(A ${A}${A})\n"),
)
_JSON = (b'"\\ud800"', b"\\udc80", b"9" * 5001, b"[" * 20_000, b'{"a":' * 20_000, b"-" + b"9" * 400, b"\xff", b"\0")
PIECES = {
    **dict.fromkeys((".yml", ".yaml", ".repos", ".samples"), _YAML),
    **dict.fromkeys((".xml", ".urdf", ".launch"), _XML),
    **dict.fromkeys((".py", ".cpp"), _CODE),
    **dict.fromkeys((".json", ".sarif"), _JSON),
}
"""What is put into files, by their suffix."""
_VALUE = re.compile(rb'-?[0-9][0-9.eE+-]*|"[^"\n]{0,200}"|[A-Za-z_][\w./-]{0,80}')
_MOST = 1 << 16
"""Bytes of a piece that is doubled or removed."""


def mutated(data: bytes, seed: int, suffix: str = "") -> bytes:
    """A file that was changed in one to four places, and by a piece of its language; the same for the same seed."""
    draw = random.Random(seed)
    for _ in range(draw.choice((1, 1, 1, 2, 4))):
        data = draw.choice((_value, _value, _value, _bits, _doubled, _removed, _swapped, _ended))(data, draw)
    if draw.random() < 0.05:
        data = _repeated(data, draw)
    if suffix in PIECES and draw.random() < 0.4:
        place, piece = draw.randrange(len(data) + 1), draw.choice(PIECES[suffix])
        return data[:place] + piece + data[place if draw.random() < 0.5 else min(len(data), place + len(piece)) :]
    return data


def _value(data: bytes, draw: random.Random) -> bytes:
    """A value of a text in the place of which stands another one, of the text itself or of `WORDS`."""
    start = draw.randrange(len(data) + 1)
    found = _VALUE.search(data, start) or _VALUE.search(data)
    if found is None:
        return _bits(data, draw)
    other = _VALUE.search(data, draw.randrange(len(data) + 1))
    word = other[0] if other and draw.random() < 0.3 else draw.choice(WORDS).encode()
    return data[: found.start()] + word + data[found.end() :]


def _bits(data: bytes, draw: random.Random) -> bytes:
    if not data:
        return bytes([draw.randrange(256)])
    place = draw.randrange(len(data))
    return data[:place] + bytes([data[place] ^ (1 << draw.randrange(8))]) + data[place + 1 :]


def _piece(data: bytes, draw: random.Random) -> tuple[int, int]:
    start = draw.randrange(len(data) + 1)
    return start, min(len(data), start + draw.choice((1, 4, 40, 400, draw.randrange(1, _MOST))))


def _doubled(data: bytes, draw: random.Random) -> bytes:
    start, end = _piece(data, draw)
    return data[:end] + data[start:end] * draw.choice((1, 1, 3)) + data[end:]


def _repeated(data: bytes, draw: random.Random) -> bytes:
    """A short piece that is there thousands of times: what is nested, is nested deeply."""
    start = draw.randrange(len(data) + 1)
    piece = data[start : start + draw.randrange(1, 12)]
    return data[:start] + piece * (_MOST // 12) + data[start:]


def _removed(data: bytes, draw: random.Random) -> bytes:
    start, end = _piece(data, draw)
    return data[:start] + data[end:]


def _swapped(data: bytes, draw: random.Random) -> bytes:
    """A piece that also stands where another one was."""
    (start, end), (other, _) = _piece(data, draw), _piece(data, draw)
    return data[:other] + data[start:end] + data[other + end - start :]


def _ended(data: bytes, draw: random.Random) -> bytes:
    return data[: draw.randrange(len(data) + 1)]
