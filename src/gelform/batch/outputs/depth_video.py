"""Depth as lossless video: FFV1 of 16 bits in Matroska, one file per sequence."""

from __future__ import annotations

from contextlib import ExitStack
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelform.batch.extras import needed
from gelform.batch.outputs.maps import blank_maps, maps_of
from gelform.batch.outputs.places import FRAMES, OutputFile, Place, RememberingFile, output_file
from gelform.npz_files import written_file
from gelform.reconstruction import Reconstruction

RATE_HZ = 30  # nominal: when a frame was taken is in the table
OPTIONS = {"level": "3", "slices": "4", "slicecrc": "1"}


class DepthVideo:
    """Writes frames/<sequence>.mkv, levels of depth (v - 32768) x 1e-4 mm; a frame with an error is level 0, unknown."""

    def __init__(self, place: Place) -> None:
        self._av = needed("av", "ffv1", "FFV1")
        self.files: list[OutputFile] = []
        self._place = place
        self._path = place.output / FRAMES / f"{place.part.sequence or 'frames'}.mkv"
        self._blank = blank_maps(place.settings, place.shape)["depth_mm"]
        self._open = ExitStack()
        self._count = 0

    def prepared(self, result: Reconstruction) -> NDArray[np.uint16]:
        """The levels."""
        return maps_of(result, self._place.settings)["depth_mm"]

    def add(self, name: str, index: int, prepared: NDArray[np.uint16] | None) -> dict[str, Any]:
        """Encode the next frame."""
        levels = self._blank if prepared is None else prepared
        frame = self._av.VideoFrame.from_ndarray(np.ascontiguousarray(levels), format="gray16le")
        frame.pts, frame.time_base = self._count, Fraction(1, RATE_HZ)
        self._file.mux(self._stream.encode(frame))
        self._handle.check()
        self._count += 1
        return {} if prepared is None else {"output": self._place.name_of(self._path)}

    def __enter__(self) -> DepthVideo:
        self._path.parent.mkdir(parents=True, exist_ok=True)
        self._handle = RememberingFile(self._open.enter_context(written_file(self._path, overwrite=True)))
        self._open.callback(self._handle.check)
        bitexact = {"fflags": "bitexact"}  # no random identifiers
        self._file = self._open.enter_context(
            self._av.open(self._handle, "w", format="matroska", options=bitexact)
        )
        self._stream = self._file.add_stream("ffv1", rate=RATE_HZ, options=OPTIONS)
        self._stream.height, self._stream.width = self._place.shape
        self._stream.pix_fmt = "gray16le"
        self._stream.thread_count = 1
        return self

    def __exit__(self, *error: Any) -> None:
        if error[0] is None:
            self._file.mux(self._stream.encode())
        self._open.__exit__(*error)
        if error[0] is None:
            self.files.append(output_file(self._place.output, self._path))
