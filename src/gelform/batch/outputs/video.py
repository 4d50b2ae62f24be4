"""Depth as lossless video, one complete file per sequence or none."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelform.batch.outputs.files import (
    PartTarget,
    PartWriter,
    RememberingFile,
    output_file,
)
from gelform.errors import DataError
from gelform.exchange.exporters.quantised import UNKNOWN
from gelform.foundations.npz_files import written_file


@dataclass(frozen=True)
class Codec:
    """A lossless codec for levels.

    Attributes
    ----------
    encoder : name in ffmpeg, such as "libx265"
    pix_fmt : pixel format of one plane of little-endian uint16, such as "gray12le"
    container : name of the muxer in ffmpeg, such as "mp4"
    options : of the encoder
    """

    encoder: str
    pix_fmt: str
    container: str
    options: Mapping[str, str] = field(default_factory=dict)


class VideoWriter(PartWriter):
    """Writes levels (H, W) uint16 as the frames of one video; the part is a whole sequence.

    The frame times follow `rate_hz`; `av` is the module. DataError if it was built without the encoder.
    """

    def __init__(self, target: PartTarget, path: Path, codec: Codec, rate_hz: int, av: Any) -> None:
        super().__init__(target)
        self._path, self._codec, self._rate_hz, self._av = path, codec, rate_hz, av
        self._open = ExitStack()
        self._count = 0

    def add(self, name: str, index: int, prepared: NDArray[np.uint16] | None) -> dict[str, Any]:
        """Encode the next frame; level 0 (unknown) for a frame with an error."""
        height, width = self._target.shape
        frame = self._av.VideoFrame(width, height, self._codec.pix_fmt)
        plane = frame.planes[0]  # its rows may be longer than the image's
        rows = np.frombuffer(plane, dtype="<u2").reshape(-1, plane.line_size // 2)
        rows[:height, :width] = UNKNOWN if prepared is None else prepared
        frame.pts, frame.time_base = self._count, Fraction(1, self._rate_hz)
        self._file.mux(self._stream.encode(frame))
        self._handle.check()
        self._count += 1
        return self._row(self._path, prepared)

    def __enter__(self) -> VideoWriter:
        self._path.parent.mkdir(parents=True, exist_ok=True)
        with ExitStack() as opened:
            self._handle = RememberingFile(opened.enter_context(written_file(self._path, overwrite=True)))
            opened.callback(self._handle.check)
            bitexact = {"fflags": "bitexact"}  # no random identifiers
            self._file = opened.enter_context(
                self._av.open(self._handle, "w", format=self._codec.container, options=bitexact)
            )
            self._stream = self._added_stream()
            self._open = opened.pop_all()
        return self

    def __exit__(self, *error: Any) -> None:
        if error[0] is None:
            self._file.mux(self._stream.encode())
        self._open.__exit__(*error)  # a full disk becomes a DataError of `written_file`
        if error[0] is None:
            self.files.append(output_file(self._target.output, self._path))

    def _added_stream(self) -> Any:
        codec = self._codec
        try:
            stream = self._file.add_stream(codec.encoder, rate=self._rate_hz, options=dict(codec.options))
        except self._av.codec.codec.UnknownCodecError as problem:
            raise DataError(
                f"This build of av has no encoder {codec.encoder}. Install the wheel: pip install av."
            ) from problem
        stream.height, stream.width = self._target.shape
        stream.pix_fmt = codec.pix_fmt
        stream.thread_count = 1  # the same bytes each time, and no threads besides the workers
        return stream
