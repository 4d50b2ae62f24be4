"""A result comes back from its file to the bit; files of every format are read."""

from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from gelform.errors import DataError
from gelform.foundations.findings import Finding
from gelform.foundations.npz_files import read_npz, write_npz
from gelform.image.markers import MarkerFlow
from gelform.result import KIND, Reconstruction, load_result, save_result
from gelform.result.file import FORMAT_VERSION

DATA = Path(__file__).parents[1] / "data"


def same(first, second):
    for entry in fields(Reconstruction):
        a, b = getattr(first, entry.name), getattr(second, entry.name)
        if isinstance(a, np.ndarray):
            assert a.dtype == b.dtype, entry.name
            assert a.tobytes() == b.tobytes(), entry.name
        elif entry.name == "markers" and a is not None:
            assert a.mm_per_px == b.mm_per_px
            for name, values in a.arrays().items():
                assert values.dtype == b.arrays()[name].dtype, name
                np.testing.assert_array_equal(values, b.arrays()[name])
        else:
            assert a == b, entry.name
    assert first.contacts == second.contacts


def test_a_saved_result_comes_back_to_the_bit(tmp_path, result):
    save_result(result, tmp_path / "x.npz")
    same(result, load_result(tmp_path / "x.npz"))


def test_every_optional_part_comes_back(tmp_path, result):
    bare = replace(
        result, gradients_sigma=None, observed_gradients=None, mm_per_px=(0.06, 0.05), health=(), index=None
    )
    full = replace(result, depth_sigma_mm=result.confidence * 0.1, outside_change=0.25)
    dots = np.arange(8, dtype=np.float32).reshape(4, 2)
    flow = MarkerFlow(dots, dots + 1, np.arange(4) > 1, dots[:, 0] / 10, result.mm_per_px)
    marked = replace(result, markers=flow)
    for k, one in enumerate((bare, full, marked)):
        save_result(one, tmp_path / f"{k}.npz")
        same(one, load_result(tmp_path / f"{k}.npz"))


@pytest.mark.parametrize(
    ("name", "values", "said"),
    [
        ("markers_seen", np.ones(4, np.float32), "Expected markers_seen of another type, got float32"),
        ("markers_now_px", np.full((4, 2), np.nan, np.float32), "markers_now_px"),
        ("markers_sigma_px", np.ones(3, np.float32), "Expected sigma_px of shape"),
        ("markers_rest_px", None, "what it holds does not make a result"),
    ],
)
def test_damaged_markers_are_refused(tmp_path, result, name, values, said):
    dots = np.zeros((4, 2), dtype=np.float32)
    flow = MarkerFlow(dots, dots, np.ones(4, dtype=bool), dots[:, 0], result.mm_per_px)
    save_result(replace(result, markers=flow), tmp_path / "x.npz")
    arrays, meta = read_npz(tmp_path / "x.npz", kind=KIND, newest_version=1, max_bytes=1e6, error=DataError)
    kept = {key: array for key, array in {**arrays, name: values}.items() if array is not None}
    own = {key: value for key, value in meta.items() if not key.endswith(("format", "version", "digest"))}
    own["calibration_digest"] = ""
    write_npz(tmp_path / "y.npz", kept, own, kind=KIND, version=1)
    with pytest.raises(DataError, match=f"is damaged: .*{said}"):
        load_result(tmp_path / "y.npz")


def test_numpy_reads_the_maps_and_the_scale(tmp_path, result):
    save_result(result, tmp_path / "x.npz")
    with np.load(tmp_path / "x.npz", allow_pickle=False) as file:
        assert {"depth_mm", "gradients", "confidence", "contact", "known", "mm_per_px"} <= set(file.files)
        assert float(file["mm_per_px"]) == 0.0634
        assert np.array_equal(file["depth_mm"], result.depth_mm)


def test_albedo_only_where_the_model_gives_it(result, tmp_path):
    assert result.albedo is None
    known = replace(result, albedo_source=lambda: np.full((24, 32), 0.5, dtype=np.float32))
    assert known.albedo.mean() == 0.5
    save_result(known, tmp_path / "x.npz")
    assert load_result(tmp_path / "x.npz").albedo is None


def test_a_result_of_the_first_format_is_read():
    first = load_result(DATA / "result-version-1.npz")
    assert first.depth_mm.max() == np.float32(0.38049176)
    assert first.observed_gradients.shape == first.gradients.shape == (12, 16, 2)
    assert (first.mm_per_px, first.health) == (0.1, (Finding("exposure", "Exposure differs.", 1.05),))
    np.testing.assert_array_equal(first.markers.displacement_px, [[1, 1], [1, 1]])
    assert list(first.markers.seen) == [True, False]


def test_a_file_of_every_format_is_kept():
    """With a new format comes a file of the one before, written by the release that wrote it."""
    kept = {int(path.stem.rsplit("-", 1)[1]) for path in DATA.glob("result-version-*.npz")}
    assert kept == set(range(1, FORMAT_VERSION + 1))


def test_an_existing_result_stays(tmp_path, result):
    (tmp_path / "x.npz").write_text("mine")
    with pytest.raises(DataError, match="already there"):
        save_result(result, tmp_path / "x.npz")
    assert (tmp_path / "x.npz").read_text() == "mine"
    save_result(result, tmp_path / "x.npz", overwrite=True)
    same(result, load_result(tmp_path / "x.npz"))


def test_damaged_files_are_said_to_be(tmp_path, result):
    path = tmp_path / "x.npz"
    save_result(result, path)
    content = path.read_bytes()
    path.write_bytes(content[: len(content) // 2])
    with pytest.raises(DataError, match=r"truncated or damaged, or no gelform result"):
        load_result(path)
    broken = bytearray(content)
    broken[len(content) // 2] ^= 1
    path.write_bytes(bytes(broken))
    with pytest.raises(DataError, match=r"truncated or damaged|altered"):
        load_result(path)
    with pytest.raises(DataError, match="No file"):
        load_result(tmp_path / "missing.npz")


def test_a_future_and_an_incomplete_file(tmp_path):
    write_npz(tmp_path / "new.npz", {}, {}, kind=KIND, version=99)
    with pytest.raises(DataError, match=r"format version 99.*Install that release or a newer one"):
        load_result(tmp_path / "new.npz")
    write_npz(tmp_path / "part.npz", {"depth_mm": np.zeros((3, 4))}, {}, kind=KIND, version=1)
    with pytest.raises(DataError, match="is damaged: 'zero' is missing"):
        load_result(tmp_path / "part.npz")
