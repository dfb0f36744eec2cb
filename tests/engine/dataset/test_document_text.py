import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from calibration.engine.dataset.document_text import SharedTexts, document_text
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
    assert document_text(document) == json.dumps(document, indent=2, sort_keys=True)


@given(st.dictionaries(st.text(), values), st.dictionaries(st.text(), values))
def test_what_documents_share_has_the_same_text_in_each(document, other):
    shared = SharedTexts(document.values())
    for each in (document, {**other, **document}, {"deeper": document}):
        assert document_text(each, shared) == json.dumps(each, indent=2, sort_keys=True)


def test_of_a_dataset_too():
    document = documents.document()
    assert document_text(document) == json.dumps(document, indent=2, sort_keys=True)


def test_tuples_are_lists():
    document = {"a": (1, 2, (3, {"b": ()}))}
    assert document_text(document) == json.dumps(document, indent=2, sort_keys=True)


@pytest.mark.parametrize("document", [{1: {"a": [[]]}}, {"a": object()}, {"a": [{"b": {1, 2}}]}])
def test_what_json_does_not_have(document):
    with pytest.raises(TypeError):
        document_text(document)
