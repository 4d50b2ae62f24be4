"""Calls of the command line with odd arguments and damaged inputs, and the question whether one ended in a bug."""

from __future__ import annotations

import random
import re
import shutil
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from gelform.batch import run_batch
from hostile.commands import commands, make_work, prepare
from hostile.damage import OPERATIONS, damaged
from hostile.files import real_files

TRACEBACK = "Traceback (most recent call last)"
ODD = (
    "", " ", "x" * 5000, "a/" * 3000, "nan", "-1", "0", "1e999", "1e-300", "9" * 400, "1,2,3", "0,0,0,0", "0,0,99999,99999",
    ".", "..", "/", "/dev/null", "/proc/self/mem", "/proc/self/environ", "~", "~nobody", "[", "*", "**", "-", "--", "é",
    "=1+1", "\udcff", "a\nb", "%s", "{}", "auto", "none", "http://", "0x0", "1x1", "99999x99999", "-o", "--json", "../out",
)  # fmt: skip
CELLS = (
    "", "nan", "-1", "1e300", "1e-300", "\x00", "[1, 1]", "[99999999, 99999999]", "'", '"', "é", "\ufeff", "true", "null",
    "{}", "[0, 0, 9999, 9999]", "[" * 3000, "x" * 5000, "=1+1", "../../x", "\n", "[[1], [2]]", "{ a = 1 }", "1979-05-27",
)  # fmt: skip
CONTENTS = (
    b"", b"\0" * 100, b"\xff\xfe" * 50, b"[" * 20_000, b"{" * 20_000, b"a" + b".a" * 5000 + b" = 1",
    b"PK\x03\x04" + b"\0" * 40, b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR\0\0u0\0\0u0\x08\x02\0\0\0", b"GIF89a\xff\xff\xff\xff",
    b"\x89HDF\r\n\x1a\n" + b"\xff" * 200, b"\x89MCAP0\r\n\x06" + b"\xff" * 8, b"\xff\xd8\xff\xe0" * 9,
)  # fmt: skip
LAYOUTS = ("presses", "gs_sdk", "py3dcal", "pack/dataPack.npz")
SLOW = ("demo", "design")  # one in ten of them is tried


def inputs_in(work: Path) -> Path:
    """Inputs of every command, in a new folder."""
    work.mkdir()
    make_work(work)
    (work / "other").mkdir()
    real_files(work / "other")
    run_batch(work / "frames", work / "cal.npz", work / "done")
    return work


def bases(work: Path, out: Path) -> list[list[str]]:
    """The arguments of right calls: every command that writes, and every one that reads."""
    other = work / "other"
    ball = ["--ball-diameter-mm", "8", "--mm-per-px", "0.1", "--model", "polynomial"]
    read = [
        *(work / name for name in ("cal.npz", "result.npz", "presses", "image0.png", "frames")),
        *sorted(other.iterdir()),
    ]
    made = [
        *commands(work, out).values(),
        *(["info", path] for path in read),
        *(["info", path, "--json"] for path in read[:6]),
        *(["calibrate", other / name, *ball, "-o", out / "new.npz"] for name in LAYOUTS),
        ["evaluate", work / "presses", "-c", work / "cal.npz"],
        ["force", "evaluate", work / "loads", "-c", work / "cal.npz"],
        ["verify", work / "done"],
        ["calibrations", "add", work / "cal.npz", "--serial", "a1"],
        ["calibrations", "list"],
        ["calibrations", "remove", "a1"],
        ["calibrations", "export", "a1", "-o", out / "kept.npz"],
        ["batch", other / "image.png", "-c", other / "cal.npz", "-o", out / "b", "--format", "zarr", "--table", "csv"],
        ["import", other / "polycalib.npz", "--from", "taxim", "--background", work / "rest.png", "-o", out / "t.npz"],
        ["import", other / "nnmodel.pth", "--from", "gs_sdk", "--background", work / "rest.png", "-o", out / "n.npz"],
        ["reconstruct", work / "frames", "-c", work / "cal.npz", "-o", out / "r", "--format", "npz,png"],
        ["cameras", "--json"],
    ]  # fmt: skip
    return [[str(one) for one in call] for call in made]


def known_faults(work: Path, out: Path) -> Iterator[list[str]]:
    """Calls that were bugs once."""
    cal, presses = str(work / "cal.npz"), work / "other" / "presses"
    for path in ("x" * 5000, "a/" * 3000, str(work / ("y" * 5000))):
        yield ["info", path]
        yield ["reconstruct", path, "-c", cal, "-o", str(out / "r")]
        yield ["calibrate", path, "-o", str(out / "c.npz")]
        yield ["calibrate", str(presses), "-o", path]
        yield ["reconstruct", str(work / "image0.png"), "-c", path, "-o", path]
        yield ["batch", str(work / "frames"), "-c", cal, "-o", path]
    for name, text in (
        ("presses.csv", "image,ball_diameter_mm\nimages/0\x00.png,8\n"),
        (
            "sensor.toml",
            'name = "s"\nmm_per_px = 0.1\n[view]\nframe_shape = [64, 80]\nimage_shape = [1, 1]\n',
        ),
        (
            "sensor.toml",
            'name = "s"\nmm_per_px = 0.1\n[view]\nframe_shape = [64, 80]\ncrop = [70, 50, 60, 60]\n',
        ),
        ("sensor.toml", 'name = "s"\nmm_per_px = 0.1\n[view]\ncrop = [70, 50, 60, 60]\n'),
        ("sensor.toml", 'name = "s"\nmm_per_px = 0.1\nview = ' + "[" * 3000),
        ("sensor.toml", 'name = "s"\nmm_per_px = 0.1\n' + "a." * 5000 + "a = 1\n"),
    ):
        (presses / name).write_text(text)
        yield ["info", str(presses)]
        yield ["calibrate", str(presses), "-o", str(out / "c.npz"), "--model", "polynomial"]
        yield ["scale", str(presses / "sensor.toml"), "--points", "20,30,60,30,4"]
    pack = work / "other" / "pack" / "dataPack.npz"
    raw_pack(pack)
    yield ["info", str(pack)]
    yield ["calibrate", str(pack), "--ball-diameter-mm", "8", "--mm-per-px", "0.1", "-o", str(out / "c.npz")]
    for box in ("70,50,60,60", "0,0,1,1", "-1,0,5,5"):
        yield ["calibrate", str(work / "presses"), "-o", str(out / "c.npz"), "--crop", box]


def raw_pack(pack: Path) -> None:
    """Taxim's pack with members that are no arrays."""
    with zipfile.ZipFile(pack, "w") as archive:
        for name in ("f0.npy", "imgs", "touch_center", "touch_radius"):
            archive.writestr(name, b"raw" * 9)


def odd_call(rng: random.Random, work: Path, out: Path) -> list[str]:
    """A call with one to three faults of its arguments and its files."""
    calls = [one for one in bases(work, out) if one[0] not in SLOW or rng.random() < 0.1]
    call = rng.choice(calls)
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        fault = rng.choice((odd_argument, odd_argument, odd_file, odd_file, odd_file, less, twice))
        call = fault(rng, call, work)
    return call


def odd_argument(rng: random.Random, call: list[str], work: Path) -> list[str]:
    place = rng.randrange(1, len(call) + 1)
    return [*call[:place], rng.choice(ODD), *call[place + 1 :]]


def less(rng: random.Random, call: list[str], work: Path) -> list[str]:
    place = rng.randrange(1, len(call) + 1)
    return [*call[:place], *call[place + 1 :]]


def twice(rng: random.Random, call: list[str], work: Path) -> list[str]:
    return [*call, call[rng.randrange(len(call))]]


def odd_file(rng: random.Random, call: list[str], work: Path) -> list[str]:
    """Damage a file that an argument names, or one in a folder that it names."""
    named = [Path(one) for one in call if one.startswith(str(work)) and "*" not in one and Path(one).exists()]
    if not named:
        return call
    path = rng.choice(named)
    files = sorted(one for one in path.rglob("*") if one.is_file()) if path.is_dir() else [path]
    if not files:
        return call
    texts = [one for one in files if one.suffix in (".csv", ".toml", ".json")]
    file = rng.choice(texts if texts and rng.random() < 0.5 else files)
    content, kind = file.read_bytes(), rng.randrange(7)
    if kind == 0:
        file.write_bytes(rng.choice(CONTENTS))
    elif kind == 1:
        others = sorted(one for one in work.rglob("*") if one.is_file())
        file.write_bytes(rng.choice(others).read_bytes())
    elif kind == 2:
        file.unlink()
        if rng.random() < 0.7:
            file.symlink_to(rng.choice((file, "/dev/null", work))) if rng.random() < 0.6 else file.mkdir()
    elif kind <= 4 and file in texts:
        pieces = re.split(r"([,=\n\]\[:]+)", content.decode("utf-8", "replace"))
        pieces[2 * rng.randrange((len(pieces) + 1) // 2)] = rng.choice(CELLS)
        file.write_text("".join(pieces), encoding="utf-8")
    else:
        damages = [
            (rng.choice(OPERATIONS), rng.random(), rng.randrange(256)) for _ in range(rng.randint(1, 3))
        ]
        file.write_bytes(damaged(content, damages))
    return call


def made_calls(template: Path, folder: Path, count: int, seed: int) -> Iterator[tuple[list[str], Path]]:
    """The calls, each with its own copy of the inputs, gone when the next one comes; those of known faults come first."""
    known = len(list(known_faults(shutil.copytree(template, folder / "first"), folder)))
    shutil.rmtree(folder / "first")
    for number in range(count):
        here = folder / str(number)
        work, out = shutil.copytree(template, here / "work", symlinks=True), here / "out"
        out.mkdir()
        (here / "home").mkdir()
        prepare(out)
        if number < known:
            call = next(one for k, one in enumerate(known_faults(work, out)) if k == number)
        else:
            call = odd_call(random.Random(f"{seed} {number}"), work, out)
        yield call, here
        shutil.rmtree(here, ignore_errors=True)


def is_fault(status: Any, said: str) -> bool:
    """Whether a call ended otherwise than well or in a sentence of gelform's own."""
    return status not in (0, 1, 2, 3) or TRACEBACK in said or "gelform: bug:" in said
