"""What wheels hold, and whether each is what its name says; 1 where one is not.

    python .ci/wheel_contents.py dist/*.whl

The compiled libraries are read as files (ELF, Mach-O, PE), so that wheels of other platforms are checked too: for which
processor they are, which libraries of the system they load, and which version of the system they need at least.
"""

from __future__ import annotations

import base64
import csv
import hashlib
import io
import re
import struct
import sys
import zipfile
from collections import Counter
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

MOST_BYTES = 2_000_000  # of a wheel: what a slow network takes in a few seconds
MUST_HOLD = (
    "gelform/__init__.pyi",
    "gelform/py.typed",
    "gelform/live/page/index.html",
    "gelform/live/page/style.css",
    "gelform/live/page/icon.svg",
    "gelform/live/page/js/main.js",
    "gelform/calibration/report/page.html",
    "gelform/calibration/report/charts.html",
    "gelform/calibration/report/style.css",
    "gelform/calibration/library/three-edges.npz",
    "gelform/calibration/starters/digit.npz",
    "gelform/calibration/starters/gelsight-mini.npz",
    "gelform/calibration/starters/simulated-three-edges.npz",
    "licenses/LICENSE",
    "licenses/NOTICE",
)
SUFFIXES = {".py", ".pyi", ".typed", ".npz", ".html", ".css", ".js", ".svg", ".so", ".dll"}
LOADED = {  # what a system has, by the beginning of a tag of its wheels
    "manylinux": re.compile(r"lib(c|m|pthread|dl)\.so\.\d|ld-linux.*"),
    "macosx": re.compile(r"/usr/lib/libSystem\.B\.dylib"),
    "win": re.compile(r"(kernel32|ntdll|msvcrt|ucrtbase|api-ms-win-crt-.*)\.dll", re.IGNORECASE),
}
MACHINES = {"x86_64": "x86_64", "amd64": "x86_64", "aarch64": "aarch64", "arm64": "aarch64"}  # of tags


@dataclass(frozen=True)
class Library:
    """A compiled library: its format, its processor, what it loads, the oldest system that has all that it needs."""

    system: str
    machine: str
    loads: tuple[str, ...]
    needs: tuple[int, int]


def library_from_bytes(data: bytes) -> Library:
    """Read a library of Linux, macOS or Windows."""
    if data[:4] == b"\x7fELF":
        return _elf(data)
    if data[:4] == b"\xcf\xfa\xed\xfe":
        return _mach_o(data)
    if data[:2] == b"MZ":
        return _pe(data)
    raise ValueError(f"Expected an ELF, Mach-O or PE file of 64 bits, got one that begins with {data[:4]!r}.")


def _text(data: bytes, at: int) -> str:
    return data[at : data.index(b"\0", at)].decode()


def _elf(data: bytes) -> Library:
    machine = {62: "x86_64", 183: "aarch64"}.get(struct.unpack_from("<H", data, 18)[0], "?")
    (first,) = struct.unpack_from("<Q", data, 40)
    size, count, _ = struct.unpack_from("<HHH", data, 58)
    sections = [struct.unpack_from("<IIQQQQIIQQ", data, first + k * size) for k in range(count)]
    loads, versions = [], [(0, 0)]
    for _, kind, _, _, offset, length, link, info, _, _ in sections:
        strings = sections[link][4] if link < count else 0
        if kind == 6:  # SHT_DYNAMIC; tag 1 is a library that is loaded
            entries = struct.iter_unpack("<QQ", data[offset : offset + length])
            loads = [_text(data, strings + value) for tag, value in entries if tag == 1]
        if kind == 0x6FFFFFFE:  # SHT_GNU_verneed: `info` libraries, each with the versions of its symbols
            place = offset
            for _ in range(info):
                _, names, _, name_at, following = struct.unpack_from("<HHIII", data, place)
                for _ in range(names):
                    _, _, _, name, step = struct.unpack_from("<IHHII", data, place + name_at)
                    found = re.fullmatch(r"GLIBC_(\d+)\.(\d+).*", _text(data, strings + name))
                    versions += [(int(found[1]), int(found[2]))] if found else [(99, 0)]
                    name_at += step
                place += following
    return Library("manylinux", machine, tuple(loads), max(versions))


def _mach_o(data: bytes) -> Library:
    processor, _, _, commands = struct.unpack_from("<IIII", data, 4)
    machine = {0x01000007: "x86_64", 0x0100000C: "aarch64"}.get(processor, "?")
    loads, needs, place = [], (99, 0), 32
    for _ in range(commands):
        command, size = struct.unpack_from("<II", data, place)
        if command == 0xC:  # LC_LOAD_DYLIB
            loads.append(_text(data, place + struct.unpack_from("<I", data, place + 8)[0]))
        if command == 0x32:  # LC_BUILD_VERSION: the platform, then the oldest system
            (oldest,) = struct.unpack_from("<I", data, place + 12)
            needs = (oldest >> 16, oldest >> 8 & 255)
        place += size
    return Library("macosx", machine, tuple(loads), needs)


def _pe(data: bytes) -> Library:
    (start,) = struct.unpack_from("<I", data, 60)
    machine, count = struct.unpack_from("<HH", data, start + 4)
    (optional,) = struct.unpack_from("<H", data, start + 20)
    sections = [
        struct.unpack_from("<IIII", data, start + 24 + optional + 40 * k + 8) for k in range(count)
    ]  # bytes in memory, address, bytes in the file, place in the file

    def place_of(address: int) -> int:
        return next(file + address - at for size, at, _, file in sections if at <= address < at + size)

    (imports,) = struct.unpack_from("<I", data, start + 24 + 112 + 8)
    loads, place = [], place_of(imports)
    while name := struct.unpack_from("<I", data, place + 12)[0]:
        loads.append(_text(data, place_of(name)))
        place += 20
    return Library("win", {0x8664: "x86_64", 0xAA64: "aarch64"}.get(machine, "?"), tuple(loads), (0, 0))


def problems_of(wheel: Path) -> list[str]:
    """What is wrong with a wheel, a sentence each."""
    wrong = []
    platform = wheel.stem.split("-")[-1]
    with zipfile.ZipFile(wheel) as archive:
        files = {name: archive.read(name) for name in archive.namelist()}
    if wheel.stat().st_size > MOST_BYTES:
        wrong.append(f"Expected at most {MOST_BYTES} bytes, got {wheel.stat().st_size}.")
    wrong += [f"{name} is missing." for name in MUST_HOLD if not any(f.endswith(name) for f in files)]
    wrong += [
        f"{name} does not belong in a wheel."
        for name in files
        if ".dist-info/" not in name
        and (not name.startswith("gelform/") or PurePosixPath(name).suffix not in SUFFIXES)
    ]
    info = next((data.decode() for name, data in files.items() if name.endswith(".dist-info/WHEEL")), "")
    tags = {line.removeprefix("Tag: ") for line in info.splitlines() if line.startswith("Tag: ")}
    if tags != {f"py3-none-{one}" for one in platform.split(".")} or "Root-Is-Purelib: false" not in info:
        wrong.append(f"The file WHEEL says {sorted(tags)}, the wheel's name {platform}.")
    wrong += _wrong_in_record(files)
    machine = next((here for end, here in MACHINES.items() if platform.endswith(end)), "?")
    suffix = ".dll" if platform.startswith("win") else ".so"
    expected = {
        f"kernels_{isa}{suffix}" for isa in (("base", "v3", "v4") if machine == "x86_64" else ("base",))
    }
    libraries = {PurePosixPath(n).name: data for n, data in files.items() if n.endswith((".so", ".dll"))}
    if set(libraries) != expected:
        wrong.append(f"Expected the libraries {sorted(expected)}, got {sorted(libraries)}.")
    for name, data in libraries.items():
        wrong += [
            f"{name}: {problem}" for problem in _wrong_in_library(library_from_bytes(data), platform, machine)
        ]
    return wrong


def _wrong_in_record(files: dict[str, bytes]) -> list[str]:
    """RECORD lists every file with its digest."""
    listed = next((data.decode() for name, data in files.items() if name.endswith(".dist-info/RECORD")), "")
    digests = {row[0]: row[1] for row in csv.reader(io.StringIO(listed)) if row}
    wrong = [f"RECORD and the files differ in {name}." for name in sorted(set(digests) ^ set(files))]
    for name in set(digests) & set(files):
        digest = base64.urlsafe_b64encode(hashlib.sha256(files[name]).digest()).rstrip(b"=").decode()
        if not name.endswith("RECORD") and digests[name] != f"sha256={digest}":
            wrong.append(f"RECORD has another digest of {name}.")
    return wrong


def _wrong_in_library(library: Library, platform: str, machine: str) -> list[str]:
    wrong = []
    if not platform.startswith(library.system) or library.machine != machine:
        wrong.append(f"it is for {library.system} {library.machine}, the tag says {platform}.")
        return wrong
    wrong += [
        f"it loads {name}, which not every such system has."
        for name in library.loads
        if not LOADED[library.system].fullmatch(name)
    ]
    said = re.search(r"_(\d+)_(\d+)_", platform)
    if said and library.needs > (int(said[1]), int(said[2])):
        wrong.append(f"it needs a system of {library.needs}, the tag says {platform}.")
    return wrong


def description_of(wheel: Path) -> str:
    """Its size, how many files of each kind it holds, what its libraries load and need."""
    with zipfile.ZipFile(wheel) as archive:
        infos = archive.infolist()
        kinds = Counter(PurePosixPath(info.filename).suffix or "of metadata" for info in infos)
        libraries = {
            PurePosixPath(info.filename).name: (info.file_size, library_from_bytes(archive.read(info)))
            for info in infos
            if info.filename.endswith((".so", ".dll"))
        }
    lines = [
        f"{wheel.name}: {wheel.stat().st_size / 1e6:.2f} MB, {sum(i.file_size for i in infos) / 1e6:.2f} MB unpacked"
    ]
    lines.append("  files: " + ", ".join(f"{count} {kind}" for kind, count in kinds.most_common()))
    for name, (size, one) in sorted(libraries.items()):
        needs = f", from version {one.needs[0]}.{one.needs[1]} on" if one.needs > (0, 0) else ""
        loads = ", ".join(one.loads) or "nothing"
        lines.append(f"  {name}: {size // 1000} kB, {one.system} {one.machine}{needs}, loads {loads}")
    return "\n".join(lines)


def main(arguments: list[str]) -> int:
    """Describe and check each wheel."""
    wrong = 0
    for wheel in map(Path, arguments):
        print(description_of(wheel))
        for problem in problems_of(wheel):
            print(f"  wrong: {problem}")
            wrong += 1
    return 1 if wrong or not arguments else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
