"""What a recording carries beside its frames: the calibration in use, and the background that was taken."""

from __future__ import annotations

import tempfile
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from gelform.calibration_file import Calibration, load_calibration
from gelform.errors import DataError
from gelform.sensors.recordings.bag_folder import is_bag_folder, mcap_file_in
from gelform.sensors.recordings.facts import ATTACHABLE, BACKGROUND, CALIBRATION, image_from_encoded
from gelform.sensors.recordings.image_folder import is_recorded_folder
from gelform.sensors.recordings.mcap_records import Placed, mcap_records

MAX_BYTES = 64 * 2**20


def attachments_of(
    calibration: Calibration | None, background: NDArray[np.floating] | None = None
) -> dict[str, bytes]:
    """What `new_recording` attaches: the files by name.

    Parameters
    ----------
    calibration : in use, or None
    background : (H, W, 3) RGB in whole grey levels that was taken after the calibration, or None
    """
    attached = {}
    if calibration is not None:
        with tempfile.TemporaryDirectory() as folder:
            calibration.save(Path(folder) / CALIBRATION)
            attached[CALIBRATION] = (Path(folder) / CALIBRATION).read_bytes()
    if background is not None:
        pixels = np.rint(background[..., ::-1]).astype(np.uint8)
        attached[BACKGROUND] = cv2.imencode(".png", pixels)[1].tobytes()
    return attached


def attached_to(path: Path) -> dict[str, bytes]:
    """The attachments of a recording (MCAP file or recorded folder); of an MCAP file those before its first frame.

    Videos and plain folders of images carry none.

    Raises
    ------
    DataError
        The file cannot be read, or an attachment is larger than 64 MB.
    """
    if is_recorded_folder(path):
        found = {name: (path / name).read_bytes() for name in ATTACHABLE if (path / name).is_file()}
    elif path.suffix.lower() == ".mcap" or is_bag_folder(path):
        found = _in_mcap(mcap_file_in(path) if path.is_dir() else path)
    else:
        found = {}
    for name, content in found.items():
        if len(content) > MAX_BYTES:
            raise DataError(
                f"Expected {name} in {path} of at most {MAX_BYTES >> 20} MB, got {len(content)} bytes."
            )
    return found


def attached_calibration(path: str | Path) -> Calibration | None:
    """The calibration that a recording carries; None where it carries none.

    Raises
    ------
    DataError
        The recording cannot be read.
    CalibrationError
        The calibration is damaged, or of a newer format.
    """
    content = attached_to(Path(path)).get(CALIBRATION)
    if content is None:
        return None
    with tempfile.TemporaryDirectory() as folder:
        written = Path(folder) / CALIBRATION
        written.write_bytes(content)
        return load_calibration(written)


def attached_background(path: str | Path) -> NDArray[np.float32] | None:
    """The background (H, W, 3), RGB, that a recording carries; None where it carries none."""
    content = attached_to(Path(path)).get(BACKGROUND)
    if content is None:
        return None
    return image_from_encoded(content, 1, f"{BACKGROUND} in {path}").astype(np.float32)


def _in_mcap(path: Path) -> dict[str, bytes]:
    found: dict[str, bytes] = {}
    for record in mcap_records(path):
        if isinstance(record, Placed):
            break
        if type(record).__name__ == "Attachment" and record.name in ATTACHABLE:
            found[record.name] = record.data
    return found
