import json
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from calibration.base.json_text import Shared, json_text
from tests.engine.dataset import documents

scalars = st.none() | st.booleans() | st.integers() | st.floats() | st.text() | st.sampled_from(["},\n    {", "[", '"'])
values = st.recursive(
    scalars,
    lambda inner: (
        st.lists(inner, max_size=4)
        | st.dictionaries(st.text(max_size=3), inner, max_size=4)
        | st.lists(st.dictionaries(st.text(max_size=3), scalars, max_size=3), max_size=4)
    ),
    max_leaves=20,
)


@given(st.dictionaries(st.text(), values))
def test_the_text_is_that_of_the_standard_library(document):
    assert json_text(document) == json.dumps(document, indent=2, sort_keys=True)


@given(st.dictionaries(st.text(), values))
def test_with_another_indent_and_keys_in_their_own_order(document):
    assert json_text(document, width=1, sort_keys=False) == json.dumps(document, indent=1)


@given(st.dictionaries(st.text(), values), st.dictionaries(st.text(), values))
def test_what_documents_share_has_the_same_text_in_each(document, other):
    shared = Shared(document.values())
    for each in (document, {**other, **document}, {"deeper": document}):
        assert json_text(each, shared=shared) == json.dumps(each, indent=2, sort_keys=True)


@pytest.mark.parametrize("document", [{"a": math.nan}, {"a": [[math.inf]]}, {"a": {"b": [-math.inf, 1]}}])
def test_numbers_that_must_be_finite(document):
    with pytest.raises(ValueError, match="not JSON compliant"):
        json_text(document, allow_nan=False)


def test_of_a_dataset_too():
    document = documents.document()
    assert json_text(document) == json.dumps(document, indent=2, sort_keys=True)


def test_tuples_are_lists():
    document = {"a": (1, 2, (3, {"b": ()}))}
    assert json_text(document) == json.dumps(document, indent=2, sort_keys=True)


@pytest.mark.parametrize("document", [{1: {"a": [[]]}}, {"a": object()}, {"a": [{"b": {1, 2}}]}])
def test_what_json_does_not_have(document):
    with pytest.raises(TypeError):
        json_text(document)
