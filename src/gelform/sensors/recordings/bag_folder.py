"""A rosbag2 folder: which of its files holds the messages."""

from __future__ import annotations

from pathlib import Path

from gelform.errors import DataError

METADATA_FILE, METADATA_KEY = "metadata.yaml", "rosbag2_bagfile_information"
MAX_KEY_AT = 4096


def is_bag_folder(path: Path) -> bool:
    """Whether a folder is one of rosbag2: by its metadata.yaml."""
    file = path / METADATA_FILE
    if not file.is_file():
        return False
    with file.open(encoding="utf-8", errors="replace") as text:
        return METADATA_KEY in text.read(MAX_KEY_AT)


def mcap_file_in(path: Path) -> Path:
    """The one MCAP file of a rosbag2 folder.

    Raises
    ------
    DataError
        Its files are of sqlite3, compressed as a whole, several or missing; the message says what to do.
    """
    files = sorted(file for file in path.iterdir() if file.is_file() and file.name != METADATA_FILE)
    whole = [file for file in files if file.suffix == ".mcap"]
    if len(whole) == 1:
        return whole[0]
    if whole:
        raise DataError(
            f"Expected a bag of one file, got {len(whole)} in {path}. Open them one after the other, such as {whole[0]}."
        )
    if any(file.suffix == ".db3" for file in files):
        raise DataError(
            f"{path} is a bag of sqlite3. Convert it: ros2 bag convert with storage_id mcap, or rosbags-convert "
            f"--src {path.name} --dst {path.name}_mcap --dst-storage mcap."
        )
    compressed = [file for file in files if file.name.endswith((".mcap.zstd", ".mcap.lz4"))]
    if compressed:
        raise DataError(
            f"{compressed[0]} is compressed as a whole. Decompress it: zstd -d {compressed[0].name} -o {path.name}.mcap"
        )
    raise DataError(
        f"Expected a file *.mcap beside {METADATA_FILE} in {path}, got none. Copy the whole folder."
    )
