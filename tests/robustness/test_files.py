"""Any damage to any file, any odd entry of tables and settings that people write by hand: an error that names the file, or
what was written."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

import gelform
from gelform.sensors.files import read_background, read_sensor_toml
from hostile.damage import ODD_VALUES, byte_damages, damaged, odd_arrays
from hostile.files import SENSOR_TOML, odd_archives, real_files, sealed, unsealed
from hostile.outcome import SLOW_IF_ALL, cases, judge
from made.small_gel import Touch, image_of

pytestmark = SLOW_IF_ALL

KINDS = (
    "metadata.json",
    "calibration", "result", "sensor.toml", "png", "jpg", "bmp", "tif", "ppm", "presses.csv",
    "image of a press", "sensor.toml of presses", "catalog.csv", "label.npz", "torch weights", "browser weights",
    "Taxim table", "Taxim pack",
)  # fmt: skip

ALIKE = (
    {"calibration"},
    {"png", "jpg", "bmp", "tif", "ppm", "image of a press"},
    {"sensor.toml", "sensor.toml of presses"},
)


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    return real_files(tmp_path_factory.mktemp("files"))


def of_kind(files, kind):
    if kind == "torch weights":
        pytest.importorskip("torch", reason="torch, the extra `torch`, is not installed")
    return files[kind]


def read_with(file, content):
    """What the reader says with other bytes in the file; the true ones come back after."""
    file.path.write_bytes(content)
    try:
        return file.read()
    finally:
        file.path.write_bytes(file.content)


@pytest.mark.parametrize("kind", KINDS)
def test_damaged_bytes(files, kind):
    file = of_kind(files, kind)

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
    file = of_kind(files, kind)
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

    @cases(80)
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


ENTRIES = (
    "", " ", "6", "6.35", "6,35", "-6", "0", "1e300", "1e-300", "nan", "inf", "abc", "6 mm",
    "\x00", "é", "'", '"', "x" * 5000,
    "../a",     "0000.png", "images/0000.png", "nothing.png", "ball", "punch", "[1]", "NULL",
    "=1+1", "\ufeff", "6\n7", "6;35",
)  # fmt: skip
VALUES = (
    "[0, 0, 1e-9, 1e-9]", "[3, 3, 0.5, 9]",
    '"0.1"', "true", "0.1", "0", "-1", "1e300", "1e-300", "nan", "inf", "[]", "[1, 2]", "[1, 2, 3, 4]", "{}", "{ a = 1 }",
    "''", "1979-05-27", "[" * 2000, "[-1, 4]", "[1000000, 1000000]", "[64, 80]",
    "[1.5, 2]", '"x"', '"xy"', '"none"', "0.0634", "15.8",
    "[" * 90 + "]" * 90, "9223372036854775807", "[0, 0, 80, 64]", "[0, 0, 1e9, 1e9]", "[nan, 1]", "{ focal_px = 1 }",
)  # fmt: skip
KEYS = (
    "name", "mm_per_px", "mm_per_px_sigma", "response", "serial", "gel_id", "view", "other", "view.crop", "view.flip",
    "view.lens", "view.image_shape", "view.frame_shape", "view.other", "view.lens.other",
)  # fmt: skip


@pytest.fixture(scope="module")
def presses(tmp_path_factory):
    return real_files(tmp_path_factory.mktemp("files"))["presses.csv"]


@cases(150)
@given(
    row=st.integers(0, 3), column=st.integers(0, 6), entry=st.sampled_from(ENTRIES), ending=st.sampled_from("\n\r")
)  # fmt: skip
def test_an_odd_entry_of_presses_csv(presses, row, column, entry, ending):
    lines = [line.split(",") for line in presses.content.decode().splitlines()]
    line = lines[min(row, len(lines) - 1)]
    if column < len(line):
        line[column] = entry
    else:
        line.append(entry)
    presses.path.write_text(ending.join(",".join(one) for one in lines), newline="")

    def right(got):
        for press in got.presses:
            if not 0.1 < press.ball_diameter_mm < 200:
                return f"a ball of {press.ball_diameter_mm} mm"
        rows = [one for one in lines[1:] if any(value.strip() for value in one)]
        if "image" not in lines[0] or "ball_diameter_mm" not in lines[0] or len(got.presses) > len(rows):
            return "more presses than rows"
        surplus = [one for one in lines[1:] if len(one) > len(lines[0])]
        return f"surplus fields in {surplus[0]} were ignored" if surplus and entry.strip() else None

    try:
        judge(
            f"presses.csv row {row} column {column}: {entry[:20]!r}",
            lambda: gelform.read_presses(presses.path.parent),
            right,
        )
    finally:
        presses.path.write_bytes(presses.content)


@cases(200)
@given(key=st.sampled_from(KEYS), value=st.sampled_from(VALUES), beside=st.booleans())
def test_an_odd_setting_of_sensor_toml(tmp_path_factory, key, value, beside):
    path = tmp_path_factory.mktemp("settings") / "sensor.toml"
    lines = SENSOR_TOML.splitlines() if beside else ['name = "known gel"', "mm_per_px = 0.1"]
    kept = [line for line in lines if not line.startswith(key.split(".")[-1] + " =")]
    if key.startswith("view.") and beside:
        kept.append(f"{key.removeprefix('view.')} = {value}")
    else:
        kept.insert(0, f"{key} = {value}")
    path.write_text("\n".join(kept), encoding="utf-8")

    def right(got):
        if not 1e-4 < got.mm_per_px < 2:
            return f"mm_per_px {got.mm_per_px}"
        shape = got.view.shape
        return f"images of {shape} px" if shape is not None and shape[0] * shape[1] > 1e9 else None

    judge(f"sensor.toml {key} = {value[:30]}, beside {beside}", lambda: read_sensor_toml(path), right)


@cases(60)
@given(
    name=st.sampled_from(["mm_per_px", "ball_diameter_mm", "crop", "sensor", "background"]),
    value=st.sampled_from(
        [float("nan"), float("inf"), -1.0, 0.0, 0, True, "0.1", "x", None, [], [1, 2], (0, 0, 5, 5), (0, 0, 1e9, 1e9), 300.0,
         1e300, 1e-300, b"x", {}, object(), 15.77, "a\x00b"]
    ),
)  # fmt: skip
def test_odd_arguments_of_read_presses(presses, name, value):
    judge(
        f"read_presses({name}={value!r:.30})",
        lambda: gelform.read_presses(presses.path.parent, **{name: value}),
    )


@cases(40)
@given(
    door=st.sampled_from(
        [gelform.read_presses, gelform.read_image, gelform.load_calibration, gelform.load_result, read_background]
    ),
    path=st.sampled_from(
        ["", ".", "/", "\x00", "a\x00b", "x" * 5000, "nowhere", "/dev/null", "/proc/self/mem", "~", None, 3, b"x", [], 2.5]
    ),
)  # fmt: skip
def test_what_is_no_path(door, path):
    judge(f"{door.__name__}({path!r:.30})", lambda: door(path))
