"""Messages of a client: each is a known command with fields of the right type, or is refused."""

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


def test_what_is_no_message():
    infinite = '{"do": "press", "station": 0, "x_px": Infinity, "y_px": 0}'
    for message in ("x" * (MAX_BYTES + 1), "[" * 9000, '{"do": NaN}', infinite, "{}", "[]", '{"do": 3}'):
        with pytest.raises(MessageError):
            parsed(message)


def test_wrong_fields_are_the_clients_fault_and_refusals_hold_no_path():
    right = {"station": 0, "x_px": 1, "y_px": 1}
    wrong = ({"station": True}, {"x_px": True}, {"x_px": 1e300}, {"z_px": 1}, {"station": -1})
    for fields in (*(right | one for one in wrong), {"station": 0, "x_px": 1}):
        with pytest.raises(MessageError):
            done(Hub(), {"do": "press", **fields})
    with pytest.raises(MessageError) as refused:
        done(Hub(), {"do": "../../etc/passwd"})
    assert "/" not in str(refused.value)
