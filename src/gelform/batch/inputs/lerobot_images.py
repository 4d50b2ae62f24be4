"""Images that a LeRobot data set keeps in its tables (features of the dtype image), instead of videos."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelform.batch.extras import needed
from gelform.errors import DataError

ROWS_AT_ONCE = 32


def stored_images(
    path: Path, key: str, offset: int, start: int, count: int
) -> Iterator[tuple[float, NDArray[np.uint8] | DataError]]:
    """Images of an episode that begins at the row `offset` of a table: seconds since then, and PNG or JPEG bytes (L,).

    Only the row groups and the columns that are needed are read.

    Parameters
    ----------
    path : of a file below the data set's `data`
    key : the feature
    start, count : which frames of the episode

    Raises
    ------
    DataError
        pyarrow is not installed; the table cannot be read, ends before, or is in another order than the episodes' table
        says.
    """
    parquet = needed("pyarrow.parquet", "lerobot", "LeRobot")
    pyarrow = needed("pyarrow", "lerobot", "LeRobot")
    done = 0
    try:
        with parquet.ParquetFile(path) as file:
            for row in _rows(file, offset + start, count, [key, "frame_index", "timestamp"]):
                if row["frame_index"] != start + done:
                    raise DataError(
                        f"Expected frame {start + done} of an episode in row {offset + start + done} of {path}, got frame "
                        f"{row['frame_index']}. The tables of the data set do not agree: make it anew."
                    )
                yield float(row["timestamp"]), _bytes_of(row[key], path, start + done)
                done += 1
    except (pyarrow.ArrowException, OSError, KeyError) as problem:
        raise DataError(f"Cannot read {key} in {path}: {problem}.") from problem
    if done < count:
        raise DataError(
            f"Expected {offset + start + count} rows in {path}, got {offset + start + done}. It is cut off."
        )


def _rows(file: Any, first: int, count: int, columns: list[str]) -> Iterator[dict[str, Any]]:
    """Rows of a range, of the row groups that it meets."""
    lengths = [file.metadata.row_group(k).num_rows for k in range(file.num_row_groups)]
    ends = np.cumsum(lengths, dtype=np.int64)
    groups = [k for k, end in enumerate(ends) if end > first and end - lengths[k] < first + count]
    if not groups:
        return
    at = int(ends[groups[0]]) - lengths[groups[0]]
    for batch in file.iter_batches(ROWS_AT_ONCE, row_groups=groups, columns=columns):
        begin, stop = max(0, first - at), first + count - at
        at += len(batch)
        yield from batch.slice(begin, max(0, stop - begin)).to_pylist()


def _bytes_of(value: Any, path: Path, index: int) -> NDArray[np.uint8] | DataError:
    """What a cell holds; LeRobot's images are {bytes, path}, of which the bytes count."""
    content = value.get("bytes") if isinstance(value, dict) else None
    if not content:
        return DataError(f"Frame {index} in {path} has no bytes of an image. Record the data set anew.")
    return np.frombuffer(content, dtype=np.uint8)
