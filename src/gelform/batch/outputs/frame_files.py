"""One file per frame: npz, or depth as 16-bit PNG."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np

from gelform.batch.outputs.maps import maps_of
from gelform.batch.outputs.places import OutputFile, Place, output_file
from gelform.errors import DataError
from gelform.npz_files import write_npz
from gelform.reconstruction import Reconstruction, save_result

KIND, VERSION = "gelform maps", 1


class FrameFiles:
    """Writes frames/<sequence>/<frame>.npz or .png."""

    def __init__(self, place: Place) -> None:
        self.files: list[OutputFile] = []
        self._place = place

    def prepared(self, result: Reconstruction) -> Any:
        """The PNG's bytes, the whole result, or its maps."""
        settings = self._place.settings
        if settings.form == "png":
            return _png(maps_of(result, settings)["depth_mm"])
        if settings.keep == ("all",):
            return result
        meta = {"calibration_digest": result.calibration_digest, "index": result.index}
        scale = {"mm_per_px": np.asarray(result.mm_per_px, dtype=np.float64)}
        return {**maps_of(result, settings), **scale}, meta

    def add(self, name: str, index: int, prepared: Any | None) -> dict[str, Any]:
        """Write the frame's file; nothing where it has an error."""
        if prepared is None:
            return {}
        path = self._place.folder / f"{name}.{self._place.settings.form}"
        path.parent.mkdir(parents=True, exist_ok=True)
        if isinstance(prepared, bytes):
            return _row(self._place.write(path, prepared))
        if isinstance(prepared, Reconstruction):
            save_result(prepared, path, overwrite=True)
        else:
            write_npz(path, *prepared, kind=KIND, version=VERSION, overwrite=True)
        return _row(output_file(self._place.output, path))

    def __enter__(self) -> FrameFiles:
        return self

    def __exit__(self, *_: object) -> None:
        pass


def _row(file: OutputFile) -> dict[str, Any]:
    return {"output": file.path, "bytes": file.bytes, "sha256": file.sha256}


def _png(levels: Any) -> bytes:
    done, encoded = cv2.imencode(".png", levels, [cv2.IMWRITE_PNG_COMPRESSION, 1])
    if not done:
        raise DataError(f"OpenCV cannot encode {levels.shape[0]}x{levels.shape[1]} levels as PNG.")
    return bytes(encoded.tobytes())
