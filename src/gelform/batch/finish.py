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

SHEET = "sheet.png"
COLUMNS, ROWS, TILE_PX, LABEL_PX = 6, 4, 200, 34  # of the contact sheet: tiles per row, rows, px
LEAST_RANGE_MM = 0.1  # mm, smallest range of a tile's colors, so that a gel at rest stays dark


def finish(output: Path, manifest: Manifest, table: str, source: Path) -> None:
    """Write the files and their record, unless they are there; of the table, the form that was asked for."""
    done = read_record(output, None)
    if done is None or not outputs_there(output, done):
        for name in TABLES.values():  # of an earlier state of the parts
            (output / name).unlink(missing_ok=True)
        files = WRITERS[manifest.settings["form"]].finish(output, files_of(output, manifest.parts), source)
        sheet = sheet_bytes(output, manifest)
        if sheet:
            files.append(write_output(output, output / SHEET, sheet))
    else:
        files = list(done.files)
    name = TABLES[table]
    if name not in {file.path for file in files}:
        write_table(output, manifest.parts, table)
        files.append(output_file(output, output / name))
        write_record(output, None, PartRecord("", (), tuple(files)))


def sheet_bytes(output: Path, manifest: Manifest) -> bytes:
    """The contact sheet of up to 24 frames; empty if depth was not kept.

    The choice depends only on the list of inputs, so that the same data set gives the same sheet.
    """
    return contact_sheet(
        [
            (depth, f"{row['sequence']}/{row['frame']}", f"{_deepest(row)} {row['health']}")
            for depth, row in _choose_frames(output, manifest)
        ]
    )


def contact_sheet(frames: Sequence[tuple[NDArray[Any], str, str]]) -> bytes:
    """A PNG of frames, each from 0 (dark) to its own deepest point; empty without frames.

    Parameters
    ----------
    frames : depth (H, W), name and note of each
    """
    tiles = [_tile(*frame) for frame in frames]
    if not tiles:
        return b""
    blank = np.zeros_like(tiles[0])
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


def _tile(depth: NDArray[Any], name: str, note: str) -> NDArray[np.uint8]:
    """Depth as colors with two lines of text below: the frame's name, and its deepest point and findings."""
    depth = np.nan_to_num(depth, nan=0.0)
    levels = np.clip(255 * depth / max(float(depth.max()), LEAST_RANGE_MM), 0, 255).astype(np.uint8)
    height = round(TILE_PX * depth.shape[0] / depth.shape[1])
    small = cv2.resize(levels, (TILE_PX, height), interpolation=cv2.INTER_AREA)
    tile = np.vstack(
        [cv2.applyColorMap(small, cv2.COLORMAP_VIRIDIS), np.zeros((LABEL_PX, TILE_PX, 3), np.uint8)]
    )
    name = name.encode("ascii", "replace").decode()
    for text, y in ((name[-32:], 14), (note[:32], 28)):
        cv2.putText(
            tile, text, (4, height + y), cv2.FONT_HERSHEY_SIMPLEX, 0.36, (255, 255, 255), 1, cv2.LINE_AA
        )
    return np.asarray(tile)


def _deepest(row: dict[str, Any]) -> str:
    """The deepest point as text; a row has no number if depth is known in no pixel."""
    return f"{row['deepest_mm']:.3f} mm" if isinstance(row["deepest_mm"], float) else "unknown"
