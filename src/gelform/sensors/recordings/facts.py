"""Facts of a recording about its camera, and the encoded bytes of its frames."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from gelform.errors import DataError
from gelform.foundations.pictures import FAST_PNG, picture_bytes
from gelform.image.frame import Frame
from gelform.sensors.declared import check_declared
from gelform.sensors.jpeg import image_from_jpeg

FORMAT_VERSION = 1
CALIBRATION, BACKGROUND = "calibration.npz", "background.png"
ATTACHABLE = {
    CALIBRATION: "application/x-npz",
    BACKGROUND: "image/png",
}  # facts that a recording may contain, with their types


@dataclass(frozen=True)
class RecordingFacts:
    """The recorded camera and its settings.

    Attributes
    ----------
    name, serial, settings, rate_hz : as of a `Source`
    calibration_digest : digest of the calibration in use; empty without one
    library_version : gelform's version
    """

    name: str
    serial: str | None = None
    settings: Mapping[str, float | str] = field(default_factory=dict)
    rate_hz: float | None = None
    calibration_digest: str = ""
    library_version: str = ""

    def to_json(self) -> str:
        """All facts as one JSON object."""
        content = {**vars(self), "settings": dict(self.settings), "format_version": FORMAT_VERSION}
        return json.dumps(content)

    @classmethod
    def from_json(cls, text: str, where: str) -> RecordingFacts:
        """The facts that `to_json` wrote; DataError if the text is damaged or of a newer format."""
        try:
            content: dict[str, Any] = json.loads(text)
            version = content.pop("format_version")
            if version > FORMAT_VERSION:
                raise DataError(
                    f"{where} has format version {version}, written by gelform {content.get('library_version')}; this "
                    f"one reads up to {FORMAT_VERSION}. Install that release."
                )
            return cls(**content)
        except (ValueError, TypeError, KeyError, AttributeError) as problem:
            raise DataError(f"{where} is damaged: its facts about the camera cannot be read.") from problem


@dataclass(frozen=True)
class RecordingSummary:
    """Summary of a recording: camera, number of frames, seconds from first to last, whether it was finished."""

    facts: RecordingFacts
    frames: int
    duration_s: float
    finished: bool


def encoded_from_frame(frame: Frame) -> tuple[str, bytes]:
    """("jpeg", the bytes as the camera sent them), or ("png", the pixels without loss)."""
    if frame.encoded is not None:
        return "jpeg", frame.encoded
    return "png", picture_bytes(frame.image, settings=FAST_PNG)


def image_from_encoded(content: bytes, reduction: int, where: str) -> NDArray[np.uint8]:
    """The pixels (H, W, 3) uint8 RGB of the result of `encoded_from_frame`; JPEGs are reduced as the camera's frames were.

    DataError: the bytes are damaged.
    """
    try:
        check_declared(content)
    except ValueError as problem:
        raise DataError(f"{where}: {problem}. It is damaged.") from problem
    if content.startswith(b"\xff\xd8"):
        image = image_from_jpeg(content, reduction)
    else:
        pixels = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_COLOR) if content else None
        image = None if pixels is None else np.asarray(cv2.cvtColor(pixels, cv2.COLOR_BGR2RGB), np.uint8)
    if image is None:
        raise DataError(f"{where} is damaged: its picture cannot be decoded.")
    return image


def reduction_in(settings: Mapping[str, float | str]) -> int:
    """The reduction of the camera's JPEGs during decoding."""
    return int(float(settings.get("reduced", 1)))
