"""The files that are written once all parts are done: the form's own index, the table, the contact sheet."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from gelform.batch.manifest import Manifest
from gelform.batch.outputs.files import output_file, write_output
from gelform.batch.outputs.writers import WRITERS, depth_of_row
from gelform.batch.records import (
    TABLES,
    PartRecord,
    files_of,
    outputs_there,
    read_record,
    write_record,
    write_table,
)
from gelform.foundations.pictures import picture_bytes

Pitch = float | Sequence[float]
SHEET = "sheet.png"
COLUMNS, ROWS = 6, 4  # of the contact sheet: tiles per row, rows
TILE_PX, LABEL_PX, GAP_PX = (
    200,
    50,
    8,
)  # px: width of a tile, height of the text below it, gap right of it and below
GAP_LEVEL = 90  # gray level of gaps
BAR = np.linspace(0, 255, 60).astype(np.uint8)  # the color bar of a tile, gray levels of its px
ROUND_MM = (0.5, 1, 2, 5, 10)  # mm, lengths of a scale
LEAST_RANGE_MM = 0.1  # mm, smallest range of a tile's colors, so that a gel at rest stays dark


def finish(
    output: Path, manifest: Manifest, table: str, source: Path, mm_per_px: Pitch | None = None
) -> None:
    """Write the files and their record, unless they are there; of the table, the form that was asked for."""
    done = read_record(output, None)
    if done is None or not outputs_there(output, done):
        for name in TABLES.values():  # of an earlier state of the parts
            (output / name).unlink(missing_ok=True)
        files = WRITERS[manifest.settings["form"]].finish(output, files_of(output, manifest.parts), source)
        sheet = sheet_bytes(output, manifest, mm_per_px)
        if sheet:
            files.append(write_output(output, output / SHEET, sheet))
    else:
        files = list(done.files)
    name = TABLES[table]
    if name not in {file.path for file in files}:
        write_table(output, manifest.parts, table)
        files.append(output_file(output, output / name))
        write_record(output, None, PartRecord("", (), tuple(files)))


def sheet_bytes(output: Path, manifest: Manifest, mm_per_px: Pitch | None = None) -> bytes:
    """The contact sheet of up to 24 frames; empty if depth was not kept.

    The choice depends only on the list of inputs, so that the same data set gives the same sheet.
    """
    return contact_sheet(
        [
            (depth, f"{row['sequence']}/{row['frame']}", f"{_deepest(row)} {row['health']}")
            for depth, row in _choose_frames(output, manifest)
        ],
        mm_per_px,
    )


def contact_sheet(
    frames: Sequence[tuple[NDArray[Any], str, str]], mm_per_px: Pitch | None = None, unit: str = "mm"
) -> bytes:
    """A PNG of frames, each from 0 (dark) to its own deepest point, with a color bar and a scale; empty without frames.

    Parameters
    ----------
    frames : depth (H, W), name and note of each
    mm_per_px : of the images, mm, or (x, y); None leaves out the scale
    unit : of the depths
    """
    pitch = None if mm_per_px is None else float(np.ravel(mm_per_px)[0])
    tiles = [_tile(*frame, pitch, unit) for frame in frames]
    if not tiles:
        return b""
    blank = np.zeros_like(tiles[0])
    blank[-GAP_PX:] = blank[:, -GAP_PX:] = GAP_LEVEL
    tiles += [blank] * (-len(tiles) % COLUMNS)
    lines = [np.hstack(tiles[k : k + COLUMNS]) for k in range(0, len(tiles), COLUMNS)]
    return picture_bytes(np.vstack(lines)[..., ::-1])  # OpenCV colors tiles in BGR


def _choose_frames(output: Path, manifest: Manifest) -> list[tuple[NDArray[Any], dict[str, Any]]]:
    """Depth and row of random frames; parts are drawn first, so that at most one record is read per frame."""
    rng = np.random.default_rng(int(manifest.listing_digest[:16], 16))
    wanted, form = COLUMNS * ROWS, manifest.settings["form"]
    numbers = np.sort(rng.permutation(manifest.parts)[:wanted])
    each = -(-wanted // len(numbers))
    chosen = []
    for number in numbers.tolist():
        record = read_record(output, number)
        rows = [row for row in record.rows if row["output"]] if record else []
        for k in np.sort(rng.permutation(len(rows))[:each]):
            depth = depth_of_row(output, form, rows[k])
            if depth is not None:
                chosen.append((depth, rows[k]))
    return chosen[:wanted]


def _tile(depth: NDArray[Any], name: str, note: str, pitch: float | None, unit: str) -> NDArray[np.uint8]:
    """Depth as colors with three lines below: color bar and scale, the frame's name, its deepest point and findings."""
    depth = np.nan_to_num(depth, nan=0.0)
    deepest = max(float(depth.max()), LEAST_RANGE_MM)
    levels = np.clip(255 * depth / deepest, 0, 255).astype(np.uint8)
    height = round(TILE_PX * depth.shape[0] / depth.shape[1])
    small = cv2.resize(levels, (TILE_PX, height), interpolation=cv2.INTER_AREA)
    tile = np.vstack(
        [cv2.applyColorMap(small, cv2.COLORMAP_VIRIDIS), np.zeros((LABEL_PX, TILE_PX, 3), np.uint8)]
    )
    tile[height + 6 : height + 14, 14 : 14 + len(BAR)] = cv2.applyColorMap(BAR[None], cv2.COLORMAP_VIRIDIS)
    name = name.encode("ascii", "replace").decode()
    texts = [("0", 4, 14), (f"{deepest:.2f} {unit}", 78, 14), (name[-32:], 4, 30), (note[:32], 4, 44)]
    if pitch is not None:
        px_per_mm = TILE_PX / (depth.shape[1] * pitch)
        length_mm = max((one for one in ROUND_MM if one * px_per_mm <= 40), default=ROUND_MM[0])
        tile[height + 9 : height + 11, TILE_PX - round(length_mm * px_per_mm) - 2 : TILE_PX - 2] = 255
        texts.append((f"{length_mm:g} mm", TILE_PX - 42, 24))
    for text, x, y in texts:
        cv2.putText(
            tile, text, (x, height + y), cv2.FONT_HERSHEY_SIMPLEX, 0.36, (255, 255, 255), 1, cv2.LINE_AA
        )
    return cv2.copyMakeBorder(tile, 0, GAP_PX, 0, GAP_PX, cv2.BORDER_CONSTANT, value=[GAP_LEVEL] * 3)


def _deepest(row: dict[str, Any]) -> str:
    """The deepest point as text; a row has no number if depth is known in no pixel."""
    return f"{row['deepest_mm']:.3f} mm" if isinstance(row["deepest_mm"], float) else "unknown"
