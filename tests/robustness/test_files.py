"""Any damage to any file: an error that names the file, or what was written."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

import gelform
from hostile.budget import SLOW_IF_ALL, cases
from hostile.damage import ODD_VALUES, byte_damages, damaged, odd_arrays
from hostile.files import odd_archives, real_files, sealed, unsealed
from hostile.outcome import judge
from made.small_gel import Touch, image_of

pytestmark = SLOW_IF_ALL

KINDS = (
    "metadata.json",
    "calibration", "calibration of version 1", "result", "sensor.toml", "png", "jpg", "bmp", "tif", "ppm", "presses.csv",
    "image of a press", "sensor.toml of presses", "catalog.csv", "label.npz", "torch weights", "Taxim table", "Taxim pack",
)  # fmt: skip

ALIKE = (
    {"calibration", "calibration of version 1"},
    {"png", "jpg", "bmp", "tif", "ppm", "image of a press"},
    {"sensor.toml", "sensor.toml of presses"},
)


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    return real_files(tmp_path_factory.mktemp("files"))


def read_with(file, content):
    """What the reader says with other bytes in the file; the true ones come back after."""
    file.path.write_bytes(content)
    try:
        return file.read()
    finally:
        file.path.write_bytes(file.content)


@pytest.mark.parametrize("kind", KINDS)
def test_damaged_bytes(files, kind):
    file = files[kind]

    @cases(45)
    @given(damages=byte_damages())
    def of_any_kind(damages):
        content = damaged(file.content, damages)
        judge(
            f"{kind} damaged by {damages}",
            lambda: read_with(file, content),
            lambda got: None if file.same(got) else "read without a word, and not what was written",
        )

    of_any_kind()


@pytest.mark.parametrize("kind", KINDS)
def test_a_file_of_another_kind(files, kind):
    file = files[kind]
    alike = next((group for group in ALIKE if kind in group), {kind})
    others = [other.content for name, other in files.items() if name not in alike]
    for number, content in enumerate(
        [*others, *odd_archives(file.content), b"", b"\x00" * 100, b"\xff\xfe" * 50, b"[" * 20_000]
    ):
        judge(
            f"{kind} replaced by {number}",
            lambda content=content: read_with(file, content),
            lambda got: None if file.same(got) else "another kind of file was read",
        )


@pytest.mark.parametrize("kind", ["calibration", "result"])
@pytest.mark.parametrize("part", ["arrays", "meta"])
def test_a_sealed_file_that_holds_something_else(files, kind, part):
    """Digests agree, the content cannot be: nothing but an error or a finite result may come of it."""
    file = files[kind]
    contents = dict(zip(("arrays", "meta"), unsealed(file.content)))
    names = sorted(contents[part])
    # what replaces settings inside settings too
    nested = [(name, key) for name in names if part == "meta" and isinstance(contents["meta"][name], dict)
              for key in contents["meta"][name]]  # fmt: skip

    @cases(125)
    @given(place=st.sampled_from([*names, *nested]), which=st.integers(-1, 60))
    def of_any_kind(place, which):
        arrays, meta = unsealed(file.content)
        changed = {"arrays": arrays, "meta": meta}[part]
        key = place
        if isinstance(place, tuple):
            changed, key = changed[place[0]], place[1]
        if which < 0:
            del changed[key]
        else:
            odd = odd_arrays(changed[key]) if part == "arrays" else ODD_VALUES
            changed[key] = odd[which % len(odd)]
        try:
            content = sealed(arrays, meta)
        except Exception:
            return  # no file can hold this
        judge(f"{kind} sealed with {place} = odd {which}", lambda: used(read_with(file, content)))

    of_any_kind()


def used(got):
    """What a calibration then gives; a result is shown."""
    if isinstance(got, gelform.Calibration):
        got.describe()
        return gelform.Reconstructor(got)(image_of(Touch()))
    repr(got)
    got._repr_html_()
    return got
