"""Tables and settings that people write by hand: any odd entry is refused by name, or means what it says."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

import gelform
from gelform.sensors.files import read_background, read_sensor_toml
from hostile.budget import SLOW_IF_ALL, cases
from hostile.files import SENSOR_TOML, real_files
from hostile.outcome import judge

pytestmark = SLOW_IF_ALL

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
    path = tmp_path_factory.getbasetemp() / "sensor.toml"
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
