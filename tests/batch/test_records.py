"""Settings, manifest and records: read back unchanged, invalid ones are refused, damage is found; table and sheet."""

import csv
import dataclasses
import json
import os
from contextlib import nullcontext

import cv2
import numpy as np
import pytest

from gelform.batch import KEPT, BatchSettings, run_batch, verify_output
from gelform.batch.outputs.files import OutputFile
from gelform.batch.records import (
    COLUMNS,
    Manifest,
    PartRecord,
    begin,
    done_records,
    only_run,
    outputs_there,
    read_manifest,
    read_record,
    record_path,
    table_form,
    write_record,
    write_table,
)
from gelform.batch.run import GAP_PX, LABEL_PX, TILE_PX, contact_sheet, sheet_bytes
from gelform.errors import DataError
from made.small_gel import save


def rows_of(folder):
    """The rows of the table as CSV."""
    with (folder / "frames.csv").open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def shown(sheet):
    """The pixels of a contact sheet."""
    return cv2.imdecode(np.frombuffer(sheet, np.uint8), cv2.IMREAD_COLOR)


def test_no_cell_of_the_table_is_a_formula(tmp_path):
    names = {"sequence": "=cmd|' /C calc'!A0", "frame": "@x", "index": 0, "deepest_mm": -0.5}
    write_record(tmp_path, 0, PartRecord("digest", (dict.fromkeys(COLUMNS, "") | names,)))
    write_table(tmp_path, 1, "csv")
    (line,) = rows_of(tmp_path)
    assert (line["sequence"], line["frame"], line["deepest_mm"]) == ("'=cmd|' /C calc'!A0", "'@x", "-0.5")


def test_refused():
    for wrong, said in [
        ({"form": "jpg"}, "Expected a format among npz, png, zarr, hdf5, lerobot, got 'jpg'"),
        ({"keep": ("depht",)}, "Expected maps to keep among depth, depth_sigma"),
        ({"keep": ()}, "Expected maps to keep"),
        ({"keep": ("all", "depth")}, "Expected maps to keep"),
        ({"form": "png", "keep": ("depth", "contact")}, "Expected depth alone in 16 bits"),
        ({"background_frames": -1}, "Expected 0 to 200 frames"),
        ({"part_frames": 0}, "at least one frame"),
    ]:
        with pytest.raises(ValueError, match=said):
            BatchSettings(**wrong)


def test_every_map_can_be_kept():
    facts = BatchSettings(keep=KEPT).facts()
    assert json.loads(json.dumps(facts)) == facts
    assert facts["keep"] == list(KEPT)


THERE = Manifest(BatchSettings().facts(), "c", "b", "l", 3, 700)


@pytest.fixture
def output(tmp_path):
    begin(tmp_path, THERE, overwrite=False)
    return tmp_path


def test_the_same_goes_on_and_anything_else_is_refused_by_name(output):
    begin(output, THERE, overwrite=False)
    assert read_manifest(output) == THERE
    for field, value, said in [
        ("calibration_digest", "other", "the calibration"),
        ("background_digest", "other", "the background"),
        ("listing_digest", "other", "the list of input files"),
        ("gelform_version", "9.9", "the version of gelform"),
        ("settings", BatchSettings(form="png").facts(), r"the setting form \(npz then, png now\)"),
        ("settings", BatchSettings(keep=("depth",)).facts(), r"keep \(depth,known then, depth now\)"),
    ]:
        wanted = dataclasses.replace(THERE, **{field: value})
        with pytest.raises(DataError, match=said):
            begin(output, wanted, overwrite=False)
        assert read_manifest(output) == THERE
        (output / "frames").mkdir()
        (output / "frames" / "0.npz").write_bytes(b"old")
        begin(output, wanted, overwrite=True)
        assert read_manifest(output) == wanted
        assert not (output / "frames").exists()
        begin(output, THERE, overwrite=True)


def test_a_folder_of_something_else_is_left_alone(tmp_path):
    (tmp_path / "thesis.tex").write_text("")
    for overwrite in (False, True):
        with pytest.raises(DataError, match=r"holds thesis\.tex, but no manifest"):
            begin(tmp_path, THERE, overwrite=overwrite)
    assert (tmp_path / "thesis.tex").exists()


def test_a_manifest_that_cannot_be_read_says_what_to_do(output):
    for content, said in (
        ("", "is damaged. Give another output folder, or start again with --overwrite"),
        ('{"format": "gelform batch", "format_ver', "is damaged"),
        ("[]", "is damaged"),
        ('{"format": "gelform batch", "format_version": 1}', "is damaged"),
        ('{"format": "a web app", "format_version": 1}', "is no manifest of a batch"),
        ('{"format": "gelform batch", "format_version": 9, "gelform_version": "7"}', "of gelform 7. Install"),
    ):
        (output / "manifest.json").write_text(content)
        with pytest.raises(DataError, match=said):
            begin(output, THERE, overwrite=False)


def test_who_may_run_together(tmp_path, monkeypatch):
    monkeypatch.setattr("gelform.batch.records.WAIT_S", 0.05)
    whole = (1, 1)
    for first, second, together in (
        (whole, whole, False),
        (whole, (1, 2), False),
        ((1, 2), whole, False),
        ((1, 2), (2, 2), True),
        ((1, 2), (1, 2), False),
    ):
        refused = nullcontext() if together else pytest.raises(DataError, match=r"now\. Wait for it")
        with only_run(tmp_path, first), refused, only_run(tmp_path, second):
            pass
        with only_run(tmp_path, second) as alone:  # the lock is let go
            assert alone == (second == whole)


def row(frame, error="", **more):
    return {"output": "", "sequence": "a", "frame": frame, "error": error, **more}


FILE = OutputFile("0.h5", 3, "abc")
RECORD = PartRecord("digest", (row("0"), row("1", "it is empty, so")), (FILE,))


def test_as_written_and_outputs_that_went_or_shrank(tmp_path):
    assert read_record(tmp_path, 1234) is None
    write_record(tmp_path, 1234, RECORD)
    assert read_record(tmp_path, 1234) == RECORD
    assert RECORD.errors == 1
    record = PartRecord("", (row("0", output="0.npz", bytes=3, sha256="a"), row("1", "no output")))
    assert not outputs_there(tmp_path, record)
    for content in (b"abc", b"ab"):
        (tmp_path / "0.npz").write_bytes(content)
        assert outputs_there(tmp_path, record) == (content == b"abc")


def test_damage_and_parts_that_are_not_done_are_noticed(tmp_path):
    write_record(tmp_path, 0, RECORD)
    assert list(done_records(tmp_path, 1)) == [RECORD]
    with pytest.raises(DataError, match=r"Part 1 .* is not done"):
        list(done_records(tmp_path, 2))
    whole = record_path(tmp_path, 0).read_bytes()
    for damaged in (whole[:-9], whole.replace(b'"1"', b'"2"'), b""):
        record_path(tmp_path, 0).write_bytes(damaged)
        with pytest.raises(DataError, match="Delete it and run the same command"):
            read_record(tmp_path, 0)


PARTS = 203


@pytest.fixture
def recorded(tmp_path):
    empty = dict.fromkeys(COLUMNS, "")
    for number in range(PARTS):
        facts = {"deepest_mm": 0.25, "contacts": 1, "wall_time_ns": 1 << 60, "output": "x"}
        good = empty | row("0", index=2 * number) | facts
        bad = empty | row("\udcff", "it is empty, so", index=2 * number + 1)
        write_record(tmp_path, number, PartRecord("", (good, bad), (OutputFile("x", 1, ""),)))
    return tmp_path


def test_csv(recorded):
    write_table(recorded, PARTS, "csv")
    rows = rows_of(recorded)
    assert [int(one["index"]) for one in rows] == list(range(2 * PARTS))
    assert rows[1]["error"] == "it is empty, so"
    with pytest.raises(DataError, match=rf"Part {PARTS} .* is not done"):
        write_table(recorded, PARTS + 1, "csv")


def test_parquet(recorded):
    parquet = pytest.importorskip("pyarrow.parquet", reason="the extra data is not installed")
    write_table(recorded, PARTS, "parquet")
    read = parquet.read_table(recorded / "frames.parquet")
    assert read.column_names == list(COLUMNS)
    assert read["index"].to_pylist() == list(range(2 * PARTS))
    first, second = read.slice(0, 2).to_pylist()
    assert (first["deepest_mm"], first["wall_time_ns"], first["error"]) == (0.25, 1 << 60, None)
    assert (second["deepest_mm"], second["frame"], second["error"]) == (None, "\\udcff", "it is empty, so")


def test_which_is_written(monkeypatch):
    monkeypatch.setattr("gelform.batch.records.find_spec", lambda name: None)
    assert table_form() == "csv"
    with pytest.raises(DataError, match=r"gelform\[data\]"):
        table_form("parquet")
    monkeypatch.setattr("gelform.batch.records.find_spec", lambda name: name)
    assert table_form() == "parquet"
    with pytest.raises(ValueError, match="Expected a table among"):
        table_form("xlsx")


def test_what_went_is_written_again(tree, cal, tmp_path):
    out = tmp_path / "out"
    run_batch(tree, cal, out, table="csv")
    for path in (out / "frames.csv", out / "sheet.png", record_path(out, None)):
        whole = path.read_bytes()
        path.unlink()
        assert [problem.path for problem in verify_output(out)[2]] == [path]
        assert run_batch(tree, cal, out, table="csv").complete
        assert path.read_bytes() == whole


def test_a_second_form_of_the_table_leaves_the_first(tree, cal, tmp_path):
    pytest.importorskip("pyarrow", reason="the extra data is not installed")
    for form in ("csv", "parquet"):
        run_batch(tree, cal, tmp_path / "out", table=form)
    assert (tmp_path / "out/frames.csv").exists()
    assert verify_output(tmp_path / "out") == (8, 0, [])
    (tmp_path / "out/frames/frame1.npz").unlink()
    run_batch(tree, cal, tmp_path / "out", table="parquet")  # the CSV would say what was
    assert not (tmp_path / "out/frames.csv").exists()
    assert verify_output(tmp_path / "out") == (8, 0, [])


def test_a_run_that_ended_before_its_table_leaves_none_of_the_parts_before(tree, cal, images, tmp_path):
    out = tmp_path / "out"
    run_batch(tree, cal, out, table="csv")
    before = (out / "frames.csv").read_bytes()
    os.utime(tree / "frame1.png", (1, 1))
    save(tree / "frame1.png", np.ascontiguousarray(images[3]))

    def ends(summary):
        if summary.parts_done == summary.parts:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_batch(tree, cal, out, table="csv", progress=ends)
    (problem,) = verify_output(out)[2]
    assert problem.path == record_path(out, None)
    assert run_batch(tree, cal, out, table="csv").frames == 0
    assert (out / "frames.csv").read_bytes() != before
    assert verify_output(out) == (8, 0, [])


def test_where_the_touch_is_it_is_bright(tree, cal, tmp_path):
    run_batch(tree, cal, tmp_path / "out", BatchSettings(part_frames=2))
    content = (tmp_path / "out/sheet.png").read_bytes()
    sheet = shown(content)
    height = TILE_PX * 64 // 80
    assert sheet.shape == (2 * (height + LABEL_PX + GAP_PX), 6 * (TILE_PX + GAP_PX), 3)  # eight frames
    tile = sheet[:height, :TILE_PX].sum(axis=2)
    assert tile[height * 30 // 64, TILE_PX // 2] > 2 * tile[5, 5]
    assert sheet_bytes(tmp_path / "out", read_manifest(tmp_path / "out"), cal.mm_per_px) == content


def test_a_sheet_has_gaps_a_color_bar_and_a_scale():
    """A map of 20 mm, drawn 200 px wide: the longest round length that fits is 2 mm, of 20 px."""
    depth = np.linspace(0, 0.8, 100 * 40).reshape(40, 100)
    sheet = shown(contact_sheet([(depth, "a", "b")] * 2, 0.2))
    assert (sheet[:, TILE_PX : TILE_PX + GAP_PX] == 90).all()
    assert (sheet[-GAP_PX:] == 90).all()
    bar = sheet[80 + 10, 14 : 14 + 60].astype(int)
    assert np.abs(bar[0] - sheet[0, 0]).max() <= 3
    assert np.abs(bar[-1] - sheet[79, TILE_PX - 1]).max() <= 12
    scale = (sheet[80 + 9, 140:TILE_PX] == 255).all(axis=1)
    assert scale.sum() == 20
    texts = sheet[:, :100].min(axis=2) > 150  # numbers, name, note; nothing on the depth
    assert [texts[a:b].any() for a, b in ((0, 80), (84, 96), (96, 112), (112, 126))] == [False] + [True] * 3
    none = shown(contact_sheet([(depth, "a", "b")]))
    assert not (none[80 + 9, 140:TILE_PX] == 255).all(axis=1).any()


def test_no_sheet_where_no_depth_was_kept_and_unknown_pixels_are_dark(tree, cal, tmp_path):
    run_batch(tree, cal, tmp_path / "out", BatchSettings(keep=("contact",)))
    assert not (tmp_path / "out/sheet.png").exists()
    depth = np.full((64, 80), np.nan, np.float32)
    assert shown(contact_sheet([(depth, "ä/0", "")]))[:100, :TILE_PX].max() < 90


def test_a_frame_of_which_nothing_is_known_has_no_figures(tree, cal, tmp_path, monkeypatch):
    save(tree / "frame1.png", np.full((64, 80, 3), 255, np.uint8))
    tally = run_batch(tree, cal, tmp_path / "out", table="csv").tally
    assert (tally.frames, tally.unknown, tally.doubtful, tally.findings["saturated"]) == (8, 1, 1, 1)
    first, second, *_ = rows_of(tmp_path / "out")
    assert first["frame"] == "frame1"
    assert not first["deepest_mm"] + first["contact_mm2"] + first["error"]
    assert first["health"]
    assert float(second["deepest_mm"]) > 0.1
    texts = []
    monkeypatch.setattr(cv2, "putText", lambda *arguments: texts.append(arguments[1]))
    sheet_bytes(tmp_path / "out", read_manifest(tmp_path / "out"))
    assert len([text for text in texts if text.startswith("unknown")]) == 1
    assert not [text for text in texts if text.startswith("0.000")]
