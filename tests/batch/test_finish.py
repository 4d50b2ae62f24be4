"""What is written at the end comes back where it went, and is found where it is wrong; the contact sheet shows
depth where it is, of frames of the whole data set, the same each time."""

import cv2
import numpy as np

from gelform.batch import BatchSettings, run_batch
from gelform.batch.finish import LABEL_PX, TILE_PX, finish, problems_of_finish, write_sheet
from gelform.batch.manifest import read_manifest


def test_what_went_is_written_again(tree, cal, tmp_path):
    run_batch(tree, cal, tmp_path / "out", table="csv")
    manifest, table = read_manifest(tmp_path / "out"), tmp_path / "out/frames.csv"
    assert problems_of_finish(tmp_path / "out", manifest) == []
    content = table.read_bytes()
    sheet = tmp_path / "out/sheet.png"
    drawn = sheet.read_bytes()
    sheet.write_bytes(drawn[:-1])
    assert problems_of_finish(tmp_path / "out", manifest) == [sheet]
    sheet.unlink()
    finish(tmp_path / "out", manifest, "csv", tree, again=False)
    assert sheet.read_bytes() == drawn
    table.unlink()
    assert problems_of_finish(tmp_path / "out", manifest) == [table]
    finish(tmp_path / "out", manifest, "csv", tree, again=False)
    assert table.read_bytes() == content


def test_where_the_touch_is_it_is_bright(tree, cal, tmp_path):
    run_batch(tree, cal, tmp_path / "out", BatchSettings(part_frames=2))
    sheet = cv2.imread(str(tmp_path / "out/sheet.png"))
    height = TILE_PX * 64 // 80
    assert sheet.shape == (2 * (height + LABEL_PX), 6 * TILE_PX, 3)  # eight frames
    tile = sheet[:height, :TILE_PX].sum(axis=2)
    assert tile[height * 30 // 64, TILE_PX // 2] > 2 * tile[5, 5]
    before = (tmp_path / "out/sheet.png").read_bytes()
    write_sheet(tmp_path / "out", read_manifest(tmp_path / "out"))
    assert (tmp_path / "out/sheet.png").read_bytes() == before


def test_none_where_no_depth_was_kept(tree, cal, tmp_path):
    run_batch(tree, cal, tmp_path / "out", BatchSettings(keep=("contact",)))
    assert not (tmp_path / "out/sheet.png").exists()


def test_unknown_pixels_are_dark(tmp_path, monkeypatch):
    depth = np.full((64, 80), np.nan, np.float32)
    row = {"sequence": "ä", "frame": "0", "deepest_mm": 0.0, "health": ""}
    monkeypatch.setattr("gelform.batch.finish._chosen", lambda *_: [(depth, row)])
    write_sheet(tmp_path, None)
    assert cv2.imread(str(tmp_path / "sheet.png"))[:100, :TILE_PX].max() < 90
