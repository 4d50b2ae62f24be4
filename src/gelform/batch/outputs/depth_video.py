"""Depth as lossless video: FFV1 of 16 bits in Matroska, one file per sequence."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelform.batch.extras import needed
from gelform.batch.outputs.maps import blank_maps, maps_of
from gelform.batch.outputs.places import FRAMES, OutputFile, Place, output_file
from gelform.batch.outputs.video_file import Codec, VideoFile
from gelform.reconstruction import Reconstruction

RATE_HZ = 30  # nominal: when a frame was taken is in the table
CODEC = Codec("ffv1", "gray16le", "matroska", {"level": "3", "slices": "4", "slicecrc": "1"})


class DepthVideo:
    """Writes frames/<sequence>.mkv, levels of depth (v - 32768) x 1e-4 mm; a frame with an error is level 0, unknown."""

    def __init__(self, place: Place) -> None:
        self.files: list[OutputFile] = []
        self._place = place
        self._path = place.output / FRAMES / f"{place.part.sequence or 'frames'}.mkv"
        self._blank = blank_maps(place.settings, place.shape)["depth_mm"]
        self._video = VideoFile(needed("av", "ffv1", "FFV1"), self._path, place.shape, CODEC, RATE_HZ)

    def prepared(self, result: Reconstruction) -> NDArray[np.uint16]:
        """The levels."""
        return maps_of(result, self._place.settings)["depth_mm"]

    def add(self, name: str, index: int, prepared: NDArray[np.uint16] | None) -> dict[str, Any]:
        """Encode the next frame."""
        self._video.add(self._blank if prepared is None else prepared)
        return {} if prepared is None else {"output": self._place.name_of(self._path)}

    def __enter__(self) -> DepthVideo:
        self._video.__enter__()
        return self

    def __exit__(self, *error: Any) -> None:
        self._video.__exit__(*error)
        if error[0] is None:
            self.files.append(output_file(self._place.output, self._path))
