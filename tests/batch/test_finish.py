"""What is written at the end comes back where it went, and is found where it is wrong."""

from gelform.batch.finish import finish, problems_of_finish
from gelform.batch.manifest import read_manifest
from gelform.batch.run import run_batch


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
