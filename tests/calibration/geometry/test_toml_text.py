"""Values change, everything else in the text stays as the user wrote it."""

import sys

import pytest

from gelform.calibration.geometry.toml_text import edited_toml

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

TEXT = """# my sensor, bought in May
name = "a # b"   # not a comment: the first
mm_per_px = 0.05 # from the seller

[view]   # measured
crop = [
  1, 2,  # left, top
  3, 4,
]
flip = "x"

# the end
"""


def test_comments_order_and_other_keys_stay():
    edited = edited_toml(
        TEXT, {(): {"mm_per_px": 0.0634, "mm_per_px_sigma": 1e-5}, ("measured",): {"scale": 'a "b"'}}
    )
    assert edited == (
        TEXT.replace("0.05 #", "0.0634 #").replace("seller\n", "seller\nmm_per_px_sigma = 1e-05\n")
        + '\n[measured]\nscale = "a \\"b\\""\n'
    )


def test_a_table_and_what_is_below_it_can_be_dropped():
    text = TEXT + "[view.lens]\ncamera = [1, 2]\n[other]\nx = 1\n"
    edited = edited_toml(text, {("view",): {"flip": "y"}}, drop=[("view",)])
    content = tomllib.loads(edited)
    assert content["view"] == {"flip": "y"}
    assert content["other"] == {"x": 1}
    assert edited.startswith("# my sensor")


def test_keys_are_edited_however_they_are_written():
    for text in ("view.flip = 'x'\n", "view = { flip = 'x' }\n", "[view]\nflip = 'x'\n"):
        assert tomllib.loads(edited_toml(text, {("view",): {"flip": "y"}})) == {"view": {"flip": "y"}}
    with pytest.raises(ValueError, match="cannot be written into it"):
        edited_toml("view = 3\n", {("view",): {"flip": "y"}})


def test_line_ends_of_all_kinds_stay():
    for text in ("a = 1  # one\u2028two\r\nb = 2\r\n", "a = 1", "\n\na = 1\n\n", "# only words"):
        edited = edited_toml(text, {("t",): {"x": 1}})
        assert edited.startswith(text)
        assert tomllib.loads(edited)["t"] == {"x": 1}


def test_no_toml_is_refused():
    with pytest.raises(ValueError, match="cannot be written into it"):
        edited_toml("name = \n", {(): {"name": "x"}})
