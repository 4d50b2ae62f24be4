"""Backgrounds: one for all sequences, or a table's, which has to name each of them."""

import numpy as np
import pytest

import gelform
from gelform.batch import run_batch
from gelform.batch.inputs.backgrounds import backgrounds_of
from gelform.batch.manifest import read_manifest
from gelform.errors import DataError
from made.small_gel import image_of, save

RED = np.array([1.1, 1, 1])


@pytest.fixture
def two_lights(tmp_path):
    """Two sequences of an untouched gel, the second under a brighter red light; their backgrounds lie among them."""
    for name, factor in (("a", 1), ("b", RED)):
        image = np.clip(image_of(None) * factor, 0, 255).astype(np.uint8)
        (tmp_path / "in" / name).mkdir(parents=True)
        for one in ("0.png", "rest.png"):
            save(tmp_path / "in" / name / one, image)
    return tmp_path / "in"


def table(folder, *rows):
    path = folder / "rest.csv"
    path.write_text("\n".join(("sequence,background", *rows)) + "\n")
    return path


def test_each_sequence_has_the_background_that_the_table_names(two_lights, cal, tmp_path):
    rest = table(two_lights, "a,a/rest.png", "b,b/rest.png")
    run_batch(two_lights, cal, tmp_path / "own", background=rest)
    assert len(list((tmp_path / "own/frames").rglob("*.npz"))) == 2  # the backgrounds are no frames
    for name in "ab":
        image = gelform.read_image(two_lights / name / "0.png")
        expected = gelform.Reconstructor(cal, background=image).from_image(image).depth_mm
        with np.load(tmp_path / "own/frames" / name / "0.npz") as file:
            np.testing.assert_array_equal(file["depth_mm"], expected)
    swapped = table(two_lights, "a,b/rest.png", "b,a/rest.png")
    with pytest.raises(DataError, match="begun with something else: the background"):
        run_batch(two_lights, cal, tmp_path / "own", background=swapped)


def test_a_table_that_names_one_file_for_all_is_that_file(two_lights, cal, tmp_path):
    one = two_lights / "a/rest.png"
    run_batch(two_lights, cal, tmp_path / "one", background=one)
    run_batch(
        two_lights,
        cal,
        tmp_path / "both",
        background=table(two_lights, "a,a/rest.png", "b,a/rest.png"),
        table="csv",
    )
    kept = [tmp_path / name / "frames/b/0.npz" for name in ("one", "both")]
    assert kept[0].read_bytes() == kept[1].read_bytes()
    digests = [read_manifest(tmp_path / name).background_digest for name in ("one", "both")]
    assert all(digests)


@pytest.mark.parametrize(
    ("rows", "said"),
    [
        (["a,a/rest.png"], "has no row for 'b'"),
        (["a,a/rest.png", "b,b/rest.png", "c,a/rest.png"], "the input lacks, 'c'"),
        (["a,a/rest.png", "b,b/none.png"], "The background .*none.png"),
        (["a,a/rest.png", "a,b/rest.png"], "each sequence once"),
        (["a"], "columns sequence and background"),
        ([], "columns sequence and background"),
    ],
)
def test_refused_before_anything_is_written(two_lights, cal, tmp_path, rows, said):
    with pytest.raises(DataError, match=said):
        run_batch(two_lights, cal, tmp_path / "out", background=table(two_lights, *rows))
    assert not (tmp_path / "out").exists()


def test_a_table_that_is_not_there(tmp_path):
    with pytest.raises(DataError, match="Cannot read the table"):
        backgrounds_of(tmp_path / "none.csv")
