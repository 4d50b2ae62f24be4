"""gelform verify as a command."""

import json

import pytest

from hostile.commands import make_work


@pytest.fixture
def output(run, tmp_path):
    work = make_work(tmp_path)
    images = str(work / "image*.png")
    assert run("batch", images, "-c", work / "cal.npz", "-o", tmp_path / "out", "--quiet") == (0, "", "")
    return tmp_path / "out"


def test_whole(run, run_json, output):
    code, _, err = run("verify", output)
    assert code == 0
    assert "3 frames are whole, 0 have an error, 0 problems." in err
    assert run_json("verify", output) == {"frames": 3, "errors": 0, "problems": []}


def test_what_is_wrong_is_listed_and_the_status_is_1(run, output):
    (output / "frames" / "image1.npz").unlink()
    code, _, err = run("verify", output)
    assert code == 1
    assert "image1.npz: is missing. Run the same command again." in err
    code, out, _ = run("verify", output, "--json")
    assert code == 1
    assert json.loads(out)["frames"] == 2


def test_no_output_of_a_batch(fails, tmp_path):
    assert "Expected the output folder of gelform batch" in fails("verify", tmp_path / "absent")
