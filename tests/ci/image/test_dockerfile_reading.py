import pytest
from hypothesis import given
from hypothesis import strategies as st

from calibration.ci.image.plan import Bases, bases_of, needs_buildkit


def test_bases_of_all_stages() -> None:
    text = """# escape=\\
ARG VERSION=12
ARG BASE="debian:${VERSION}"
FROM --platform=linux/amd64 $BASE AS build
# FROM comment
RUN echo a \\
    # a comment inside
    b
FROM golang:${GO:-1.22} as Tools
FROM scratch
FROM build
COPY --from=Tools /a /a
COPY --from=0 /a /a
COPY --from=ghcr.io/team/x:1 /a /a
RUN --mount=type=bind,from=tool:2,target=/t true
"""
    assert bases_of(text, {}) == Bases(("debian:12", "golang:1.22", "ghcr.io/team/x:1", "tool:2"))
    assert bases_of(text, {"VERSION": "13", "GO": "9"}).images[:2] == ("debian:13", "golang:1.22")  # no ARG GO


def test_names_that_only_the_builder_can_resolve() -> None:
    assert bases_of("FROM x-$TARGETARCH\nFROM y", {}) == Bases(("y",), ("x-$TARGETARCH",))


def test_python_in_a_here_document_is_no_base() -> None:
    text = "FROM a\nRUN <<EOF cat <<'B'\nfrom os import path\nEOF\nfrom x\nB\nRUN <<-END\nfrom y\n\tEND\nFROM b"
    assert bases_of(text, {}).images == ("a", "b")


def test_another_escape_character() -> None:
    assert bases_of("# escape=`\nFROM `\n a\nRUN b\\\nFROM c", {}).images == ("a", "c")


def test_the_same_base_twice_is_one() -> None:
    assert bases_of("\ufeffFROM a\r\nFROM a AS b\r\nFROM B\r\nFROM", {}).images == ("a",)


@pytest.mark.parametrize(
    ("text", "needs"),
    [
        ("FROM a\nRUN make", False),
        ("# syntax=docker/dockerfile:1\nFROM a", True),
        ("FROM a\nRUN --mount=type=cache,target=/c make", True),
        ("FROM a\nrun  --network=none make", True),
        ("FROM a\nCOPY --link a b", True),
        ("FROM a\nCOPY --from=x --chmod=755 a b", True),
        ("FROM a\nCOPY --chown=a a b", False),
        ("FROM a\nRUN <<EOF\nEOF", True),
        ("FROM a\nRUN test 1 -lt 2", False),
    ],
)
def test_who_can_read_it(text: str, needs: bool) -> None:
    assert needs_buildkit(text) is needs


@given(st.text(max_size=200))
def test_any_text_is_read(text: str) -> None:
    bases_of(text, {})
    needs_buildkit(text)
