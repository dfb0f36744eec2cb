"""HPL's patterns: truth tables judged by hand, and random traces against the naive evaluator."""

from collections import Counter

import pytest
from hypothesis import given
from hypothesis import strategies as st

from calibration.addons.requirements.hpl import parse_property
from calibration.addons.requirements.patterns import MAX_WAITING_BYTES, HplRequirement
from calibration.addons.requirements.requirement import Message
from calibration.base import InputError
from tests.addons.requirements.naive import Pattern, Sent, Spec, When, naive_status
from tests.addons.requirements.traces import judged, parsed_trace
from tests.addons.requirements.truth_tables import PATTERNS_IN_SCOPES, ROWS, rows

STATUS_OF_SIGN = {"+": "met", "-": "not met", "0": "vacuous"}


@pytest.mark.parametrize("hpl", dict.fromkeys(hpl for hpl, _, _ in ROWS))
def test_each_row_of_the_truth_table_is_right(hpl: str) -> None:
    own = [(trace, sign) for of, trace, sign in ROWS if of == hpl]
    found = {trace: judged(hpl, *parsed_trace(trace)).status for trace, _ in own}
    assert found == {trace: STATUS_OF_SIGN[sign] for trace, sign in own}


def test_the_table_has_each_pattern_in_each_scope_with_and_without_a_limit() -> None:
    counts = Counter(hpl for hpl, _, _ in rows(PATTERNS_IN_SCOPES))
    assert (len(counts), min(counts.values())) == (40, 8)
    assert len(ROWS) >= 300


def conditions(alias: str | None = None) -> st.SearchStrategy[tuple[str, int | str] | None]:
    rights = st.integers(0, 2) if alias is None else st.just(alias)
    return st.one_of(st.none(), st.tuples(st.sampled_from(["=", ">", "<"]), rights))


@st.composite
def events(draw: st.DrawFn, name: str | None = None, reads: str | None = None) -> When:
    topics = draw(st.lists(st.sampled_from("abpq"), min_size=1, max_size=2, unique=True))
    drawn = tuple((topic, draw(conditions(draw(st.sampled_from([reads, None]))))) for topic in topics)
    return When(drawn, name if len(topics) == 1 else None)


@st.composite
def specs(draw: st.DrawFn) -> Spec:
    pattern: Pattern = draw(st.sampled_from(["some", "no", "causes", "requires", "forbids"]))
    first = draw(events(name="A"))
    both = () if pattern in ("some", "no") else (draw(events(reads=first.alias)),)
    return Spec(
        pattern,
        (first, *both),
        draw(st.none() | st.integers(1, 4)),
        draw(st.none() | events()),
        draw(st.none() | events()),
    )


@st.composite
def traces(draw: st.DrawFn) -> tuple[list[Sent], int]:
    time, sent = 0, []
    for _ in range(draw(st.integers(0, 12))):
        time += draw(st.integers(0, 2))
        sent.append(Sent(time, draw(st.sampled_from("abpq")), draw(st.integers(0, 2))))
    return sent, time + draw(st.integers(0, 3))


@given(spec=specs(), trace=traces())
def test_the_state_machine_says_what_the_definition_says(spec: Spec, trace: tuple[list[Sent], int]) -> None:
    sent, end = trace
    found = judged(spec.text(), [(each.time, each.topic, each.x) for each in sent], end)
    assert found.status == naive_status(spec, sent, end), (spec.text(), sent, end)


def test_a_counterexample_has_stamps_and_values() -> None:
    found = judged("globally: /a {x > 1} forbids /b {x > 3} within 2 s", [(1, "a", 2), (2, "b", 4)], 3)
    assert [(each.topic, each.after, dict(each.values)) for each in found.witnesses] == [
        ("/a", 1.0, {"x": "2"}),
        ("/b", 2.0, {"x": "4"}),
    ]


def test_messages_that_wait_are_bounded() -> None:
    hpl = "globally: /a as A causes /b {x = @A.x}"
    requirement = HplRequirement(parse_property(hpl, "hpl"), (("hpl",), hpl))
    requirement.start(0)
    for time in range(9):
        requirement.feed(Message("/a", time, {"x": 1}, MAX_WAITING_BYTES // 10))
    with pytest.raises(InputError, match="within"):
        requirement.feed(Message("/a", 10, {"x": 1}, MAX_WAITING_BYTES // 10))
