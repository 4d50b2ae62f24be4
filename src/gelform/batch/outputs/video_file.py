"""A video without loss that appears whole or not at all, frame by frame."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelform.batch.outputs.places import RememberingFile
from gelform.errors import DataError
from gelform.npz_files import written_file


@dataclass(frozen=True)
class Codec:
    """How levels are kept without loss.

    Attributes
    ----------
    encoder : ffmpeg's name of it, such as "ffv1"
    pix_fmt : of one plane of little-endian uint16, such as "gray16le"
    container : ffmpeg's name of the muxer, such as "matroska"
    options : of the encoder
    """

    encoder: str
    pix_fmt: str
    container: str
    options: Mapping[str, str] = field(default_factory=dict)


class VideoFile:
    """Writes levels (H, W) uint16 as the frames of a video; a context manager.

    Parameters
    ----------
    av : the module
    path : of the video; its folder is made
    shape : (H, W) of the frames
    codec : how they are kept
    rate_hz : frames a second, which the times of the frames follow

    Raises
    ------
    DataError
        av was built without the encoder; the disk is full.
    """

    def __init__(self, av: Any, path: Path, shape: tuple[int, int], codec: Codec, rate_hz: int) -> None:
        self._av, self._path, self._shape, self._codec, self._rate_hz = av, path, shape, codec, rate_hz
        self._open = ExitStack()
        self._count = 0

    def add(self, levels: NDArray[np.uint16]) -> None:
        """Encode the next frame."""
        frame = self._av.VideoFrame(self._shape[1], self._shape[0], self._codec.pix_fmt)
        plane = frame.planes[0]  # whose rows may be longer than the image's
        rows = np.frombuffer(plane, dtype="<u2").reshape(-1, plane.line_size // 2)
        rows[: self._shape[0], : self._shape[1]] = levels
        frame.pts, frame.time_base = self._count, Fraction(1, self._rate_hz)
        self._file.mux(self._stream.encode(frame))
        self._handle.check()
        self._count += 1

    def __enter__(self) -> VideoFile:
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

    def _added_stream(self) -> Any:
        try:
            stream = self._file.add_stream(
                self._codec.encoder, rate=self._rate_hz, options=dict(self._codec.options)
            )
        except self._av.codec.codec.UnknownCodecError as problem:
            raise DataError(
                f"This build of av has no encoder {self._codec.encoder}. Install the wheel: pip install av."
            ) from problem
        stream.height, stream.width = self._shape
        stream.pix_fmt = self._codec.pix_fmt
        stream.thread_count = 1  # the same bytes, and no threads beside the workers
        return stream
