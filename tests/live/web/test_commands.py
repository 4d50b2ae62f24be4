"""Messages of a client: whatever comes, it is a known command with fields of the right kind, or refused."""

import json

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gelform.errors import GelformError
from gelform.live.hub import Hub
from gelform.live.web.commands import COMMANDS, MAX_BYTES, MessageError, done, parsed

JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text(),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=8), inner, max_size=4),
    max_leaves=12,
)


@settings(max_examples=60, deadline=None)
@given(st.text(max_size=200) | JSON.map(json.dumps))
def test_whatever_is_no_message_is_refused_as_one(message):
    try:
        content = parsed(message)
    except MessageError:
        return
    assert isinstance(content["do"], str)


@settings(max_examples=60, deadline=None)
@given(
    st.sampled_from(sorted(COMMANDS)),
    st.dictionaries(
        st.sampled_from(["station", "name", "x_px", "frame", "speed", "paused", "view", "x"]),
        JSON,
    ),
)
def test_fields_are_checked_before_anything_happens(name, fields):
    """The hub has no station: what passes the checks can only be told so."""
    with pytest.raises(GelformError):
        done(Hub(), {"do": name, **fields})


@pytest.mark.parametrize(
    "message",
    [
        "x" * (MAX_BYTES + 1),
        "[" * 9000,
        '{"do": NaN}',
        '{"do": "press", "station": 0, "x_px": Infinity, "y_px": 0}',
        "{}",
        "[]",
        '{"do": 3}',
    ],
)
def test_what_is_no_message(message):
    with pytest.raises(MessageError):
        parsed(message)


@pytest.mark.parametrize(
    "fields",
    [
        {"station": True, "x_px": 1, "y_px": 1},
        {"station": 0, "x_px": True, "y_px": 1},
        {"station": 0, "x_px": 1e300, "y_px": 1},
        {"station": 0, "x_px": 1},
        {"station": 0, "x_px": 1, "y_px": 1, "z_px": 1},
        {"station": -1, "x_px": 1, "y_px": 1},
    ],
)
def test_wrong_fields_are_the_clients_fault(fields):
    with pytest.raises(MessageError):
        done(Hub(), {"do": "press", **fields})


def test_the_message_of_a_refusal_holds_no_path():
    with pytest.raises(MessageError) as refused:
        done(Hub(), {"do": "../../etc/passwd"})
    assert "/" not in str(refused.value)
