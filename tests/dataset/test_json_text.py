import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from calibration.dataset.json_text import json_text
from tests.dataset import documents

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
