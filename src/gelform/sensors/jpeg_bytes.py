"""The bytes of a JPEG: whether they are whole. A decoder fills up what is damaged, and says nothing that Python sees."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from math import ceil

import numpy as np
from numpy.typing import NDArray

from gelform._native import Kernel

SIGNATURE = b"\xff\xd8\xff"
_END, _SCAN, _QUANTISATION, _CODES, _RESTARTS = 0xD9, 0xDA, 0xDB, 0xC4, 0xDD
_SEQUENTIAL = (0xC0, 0xC1)
_FRAMES = (*_SEQUENTIAL, *(kind for kind in range(0xC2, 0xD0) if kind not in (_CODES, 0xC8, 0xCC)))
_ENDED_EARLY = 3  # of native/sensors/jpeg_scan.c
_NO_SEGMENT = (0x01, *range(0xD0, 0xD9))

# The codes of annex K.3 of ITU-T T.81, which frames of cameras leave out: (class, lengths, symbols).
_USUAL_LEVELS = bytes(range(12))
_USUAL_OTHERS = (
    "01020300041105122131410613516107227114328191a1082342b1c11552d1f02433627282090a161718191a25262728292a3435363738393a4344"
    "45464748494a535455565758595a636465666768696a737475767778797a838485868788898a92939495969798999aa2a3a4a5a6a7a8a9aab2b3b4"
    "b5b6b7b8b9bac2c3c4c5c6c7c8c9cad2d3d4d5d6d7d8d9dae1e2e3e4e5e6e7e8e9eaf1f2f3f4f5f6f7f8f9fa",
    "000102031104052131061241510761711322328108144291a1b1c109233352f0156272d10a162434e125f11718191a262728292a35363738393a43"
    "4445464748494a535455565758595a636465666768696a737475767778797a82838485868788898a92939495969798999aa2a3a4a5a6a7a8a9aab2"
    "b3b4b5b6b7b8b9bac2c3c4c5c6c7c8c9cad2d3d4d5d6d7d8d9dae2e3e4e5e6e7e8e9eaf2f3f4f5f6f7f8f9fa",
)
_USUAL_CODES = (
    (0, "00010501010101010100000000000000", _USUAL_LEVELS),
    (1, "00030101010101010101010000000000", _USUAL_LEVELS),
    (4, "0002010303020403050504040000017d", bytes.fromhex(_USUAL_OTHERS[0])),
    (5, "00020102040403040705040400010277", bytes.fromhex(_USUAL_OTHERS[1])),
)

_jpeg_scan = Kernel(
    "jpeg_scan",
    "u8[n] scan, u8[8,16] counts, u8[8,256] symbols, u8[b,3] blocks, u16[4,64] steps, out i64[2] place, i64 mcus, "
    "i64 interval",
)


def jpeg_fault(content: bytes) -> str | None:
    """What is wrong with the bytes of a JPEG, in words that follow "it"; None where it is whole.

    Follows the markers from start to end, and reads every code of a sequential picture: each has to exist, to stay within
    its block and the range of 8-bit samples, and the last block has to end where the bytes do (ITU-T T.81, annexes B, F).
    What follows the end is no concern: cameras fill their buffers up.

    Damage that leaves a valid file cannot be seen: a number changed into another of as many bits, or the table of steps
    by which numbers are multiplied. Of progressive pictures only the markers are followed.
    """
    if not content.startswith(SIGNATURE):
        return "does not begin as a JPEG does"
    try:
        return _Picture(content).fault()
    except (IndexError, ValueError):
        return "has a damaged header"


@dataclass
class _Picture:
    """A JPEG on the way from its first marker to its last, with the tables that are in force."""

    content: bytes
    position: int = 2
    kind: int = 0
    size: tuple[int, int] = (0, 0)
    interval: int = 0
    components: dict[int, tuple[int, int, int]] = field(default_factory=dict)  # id: (across, down, steps)
    to_come: set[int] = field(default_factory=set)
    counts: NDArray[np.uint8] = field(default_factory=lambda: np.zeros((8, 16), np.uint8))
    symbols: NDArray[np.uint8] = field(default_factory=lambda: np.zeros((8, 256), np.uint8))
    steps: NDArray[np.uint16] = field(default_factory=lambda: np.ones((4, 64), np.uint16))

    def __post_init__(self) -> None:
        for place, lengths, symbols in _USUAL_CODES:
            self._set_codes(place, bytes.fromhex(lengths), symbols)

    def fault(self) -> str | None:
        """See `jpeg_fault`. IndexError, ValueError: a header that cannot be."""
        while True:
            kind = self._marker()
            if kind is None:
                return "ends before its end marker, or has bytes between its parts"
            if kind == _END:
                return "lacks a part of the picture" if self.to_come or not self.kind else None
            if kind in _NO_SEGMENT:
                continue
            data = self._segment()
            if kind == _SCAN:
                fault = self._scan(data)
                if fault is not None:
                    return fault
            self._take(kind, data)

    def _marker(self) -> int | None:
        """The next marker's kind; any number of bytes 255 may stand before it."""
        start = self.position
        while self.content[self.position : self.position + 1] == b"\xff":
            self.position += 1
        self.position += 1
        return self.content[self.position - 1] if start + 2 <= self.position <= len(self.content) else None

    def _segment(self) -> bytes:
        length = int.from_bytes(self.content[self.position : self.position + 2], "big")
        data = self.content[self.position + 2 : self.position + length]
        if length < 2 or len(data) != length - 2:
            raise ValueError("a segment beyond the end")
        self.position += length
        return data

    def _take(self, kind: int, data: bytes) -> None:
        """Take in a segment that says how what follows is to be read."""
        if kind in _FRAMES:
            self._take_frame(kind, data)
        elif kind == _CODES:
            self._take_codes(data)
        elif kind == _QUANTISATION:
            self._take_steps(data)
        elif kind == _RESTARTS:
            self.interval = int.from_bytes(data[:2], "big")

    def _take_frame(self, kind: int, data: bytes) -> None:
        height, width = (int.from_bytes(data[k : k + 2], "big") for k in (1, 3))
        precision, count = data[0], data[5]
        if self.kind or not (height and width and 0 < count <= 4) or len(data) != 6 + 3 * count:
            raise ValueError("a frame that cannot be")
        self.kind, self.size = kind if precision == 8 else -1, (height, width)
        for k in range(6, len(data), 3):
            across, down, steps = data[k + 1] >> 4, data[k + 1] & 15, data[k + 2]
            if not (0 < across <= 4 and 0 < down <= 4 and steps < 4):
                raise ValueError("sampling that cannot be")
            self.components[data[k]] = across, down, steps
        self.to_come = set(self.components)

    def _take_codes(self, data: bytes) -> None:
        while data:
            place, lengths = data[0], data[1:17]
            total = sum(lengths)
            if place & 0xEC or len(data) < 17 + total:
                raise ValueError("codes that cannot be")
            self._set_codes((place >> 4) * 4 + (place & 3), lengths, data[17 : 17 + total])
            data = data[17 + total :]

    def _set_codes(self, place: int, lengths: bytes, symbols: bytes) -> None:
        self.counts[place] = np.frombuffer(lengths, np.uint8)
        self.symbols[place, : len(symbols)] = np.frombuffer(symbols, np.uint8)

    def _take_steps(self, data: bytes) -> None:
        while data:
            wide, place = data[0] >> 4, data[0] & 15
            steps = np.frombuffer(data[1 : 1 + 64 * (1 + wide)], ">u2" if wide else "u1")
            if wide > 1 or place > 3 or len(steps) != 64 or not steps.all():
                raise ValueError("steps that cannot be")
            self.steps[place] = steps
            data = data[1 + 64 * (1 + wide) :]

    def _scan(self, data: bytes) -> str | None:
        """Read the codes of a scan, up to the marker behind it."""
        chosen = [(data[1 + 2 * k], data[2 + 2 * k]) for k in range(data[0])]
        if (
            not chosen
            or len(data) != 4 + 2 * len(chosen)
            or any(one not in self.components for one, _ in chosen)
        ):
            raise ValueError("a scan that cannot be")
        self.to_come -= {one for one, _ in chosen}
        if self.kind not in _SEQUENTIAL:
            self._pass_scan()
            return None
        blocks = np.array(self._blocks_of_mcu(chosen), np.uint8)
        mcus, place = self._mcus(chosen), np.zeros(2, np.int64)
        scan = np.frombuffer(self.content, np.uint8, offset=self.position)
        steps = np.ascontiguousarray(self.steps[[steps for _, _, steps in self._four()]])
        status = _jpeg_scan(scan, self.counts, self.symbols, blocks, steps, place, mcus, self.interval)
        self.position += int(place[1])
        if status == 0:
            return None
        share = f"{100 * place[0] // mcus} % of the picture"
        return f"ends after {share}" if status == _ENDED_EARLY else f"is damaged before {share}"

    def _four(self) -> list[tuple[int, int, int]]:
        """The components, in the order of the frame; as many as the kernel has place for."""
        return (list(self.components.values()) + [(1, 1, 0)] * 4)[:4]

    def _blocks_of_mcu(self, chosen: Sequence[tuple[int, int]]) -> list[tuple[int, int, int]]:
        """(component, table of levels, table of the others) of each block of the smallest unit."""
        order = list(self.components)
        alone = len(chosen) == 1
        return [
            (order.index(one), tables >> 4, tables & 15)
            for one, tables in chosen
            for _ in range(1 if alone else self.components[one][0] * self.components[one][1])
        ]

    def _mcus(self, chosen: Sequence[tuple[int, int]]) -> int:
        """How many units a scan has; those of a component alone are its blocks."""
        most = [max(component[axis] for component in self.components.values()) for axis in (0, 1)]
        height, width = self.size
        if len(chosen) > 1:
            return ceil(width / (8 * most[0])) * ceil(height / (8 * most[1]))
        across, down, _ = self.components[chosen[0][0]]
        return ceil(ceil(width * across / most[0]) / 8) * ceil(ceil(height * down / most[1]) / 8)

    def _pass_scan(self) -> None:
        """To the marker behind a scan that is not read."""
        while True:
            self.position = self.content.index(b"\xff", self.position)
            if self.content[self.position + 1] not in (0, 0xFF, *range(0xD0, 0xD8)):
                return
            self.position += 1
