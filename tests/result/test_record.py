"""What a result works out when asked, and which parts it refuses. A result comes back from its file to the bit; files
of every format are read. The one table of a result's maps: it says what a result, its file and the documents say.
"""

import base64
import copy
import pickle
import re
import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from dataclasses import fields, replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from gelform.errors import ConvergenceError, DataError, Finding, GelformError
from gelform.foundations.files import read_npz, write_npz
from gelform.foundations.pool import once
from gelform.image.markers import MarkerFlow
from gelform.reconstruct import FrameRecord
from gelform.result import KIND, Reconstruction, load_result, save_result
from gelform.result.maps import BESIDE_DEPTH, KEPT_MAPS, MAPS
from gelform.result.record import FORMAT_VERSION
from gelform.result.shape import ShapeErrors

SHAPE_ERRORS = ShapeErrors(
    np.linspace(1e-4, 3e-4, 48, dtype=np.float32).reshape(1, 6, 8),
    np.ones((1, 6, 8), np.float32),
    0.05,
    2.5,
    0.7,
    1.25,
)


@pytest.fixture
def result():
    """A result of random numbers, with two contacts."""
    rng = np.random.default_rng(0)
    shape = (24, 32)
    return Reconstruction(
        depth=rng.normal(0, 1, shape).astype(np.float32),
        depth_sigma_mm=None,
        gradients=rng.normal(0, 1, (*shape, 2)).astype(np.float32),
        gradients_sigma=rng.uniform(0, 1, (*shape, 2)).astype(np.float32),
        observed_gradients=rng.normal(0, 1, (*shape, 2)).astype(np.float32),
        confidence=rng.uniform(0, 1, shape).astype(np.float32),
        contact=two_contacts(shape),
        known=np.ones(shape, dtype=bool),
        mm_per_px=0.0634,
        mm_per_px_sigma=0.0009,
        zero="untouched",
        solver="dct",
        curl_rms=0.01,
        health=(Finding("background_ratio", "<b>darker</b> & older", 0.87),),
        index=3,
        time_s=1.5,
        wall_time_ns=1_700_000_000_123_456_789,
        calibration_digest="ab12",
    )


def two_contacts(shape):
    """A rectangle of 4x6 pixels, and one of 3x2 at the right border."""
    contact = np.zeros(shape, dtype=bool)
    contact[5:9, 4:10] = True
    contact[15:18, -2:] = True
    return contact


def test_normals_are_computed_when_asked_for(result):
    n = result.normals
    assert n.shape == (24, 32, 3)
    assert np.allclose(-n[..., :2] / n[..., 2:], result.gradients, atol=1e-5)
    assert result.normals is n


def test_contacts_are_those_of_the_mask_largest_first(result):
    large, small = result.contacts
    assert (large.area_px, small.area_px) == (24, 6)
    assert (large.centroid_px, small.centroid_px) == ((6.5, 6.5), (30.5, 16.0))
    assert large.area_mm2 == pytest.approx(24 * 0.0634**2)
    assert (large.cut_by_border, small.cut_by_border) == (False, True)
    assert [np.count_nonzero(result.contact_labels == one.label) for one in result.contacts] == [24, 6]
    assert np.array_equal(result.contact_labels > 0, result.contact)


def test_contacts_are_counted_and_without_a_scale_have_no_millimeters(result):
    assert "contacts: 2 of 0.1 mm^2 together" in repr(result)
    untouched = replace(result, contact=np.zeros_like(result.contact))
    assert untouched.contacts == ()
    assert "contacts: none" in repr(untouched)
    bare = replace(result, mm_per_px=None, mm_per_px_sigma=None)
    assert bare.contacts[0].area_px == 24
    assert bare.contacts[0].area_mm2 is bare.contacts[0].deepest_mm is None
    assert "contacts: 2 of 30 px together" in repr(bare)


def test_parts_of_other_shapes_are_refused(result):
    turned = np.moveaxis(result.gradients, -1, 0)
    for wrong, said in (
        ({"gradients": turned}, r"gradients of shape \(24, 32, 2\), as depth, got \(2, 24, 32\)"),
        ({"contact": result.contact[:-1]}, r"contact of shape \(24, 32\)"),
        ({"confidence": None}, "confidence"),
        ({"depth": result.depth_mm[None]}, r"depth of shape \(H, W\)"),
    ):
        with pytest.raises(ValueError, match=said):
            replace(result, **wrong)


def test_differences_are_of_the_contact_unless_a_region_is_given(result):
    with pytest.raises(GelformError, match="how errors of depth hang together"):
        result.depth_difference_sigma()
    deviation = np.full(result.shape, 2.0, np.float32)
    fresh = replace(result, shape_errors=SHAPE_ERRORS, depth_sigma_mm=deviation)
    of_contact = SHAPE_ERRORS.difference_sigma(fresh.contact)
    np.testing.assert_array_equal(fresh.depth_difference_sigma()[fresh.known], of_contact[fresh.known])
    region = np.zeros(result.shape, dtype=bool)
    region[2:4, 3:7] = True
    found = fresh.depth_difference_sigma(region)
    np.testing.assert_array_equal(found[fresh.known], SHAPE_ERRORS.difference_sigma(region)[fresh.known])
    unknown = replace(fresh, known=~region)
    assert (unknown.depth_difference_sigma(region)[region] == 2).all()
    with pytest.raises(ValueError, match="region"):
        fresh.depth_difference_sigma(~np.ones(result.shape, dtype=bool))


def test_what_differences_are_uncertain_by_is_saved(result, tmp_path):
    save_result(replace(result, shape_errors=SHAPE_ERRORS), tmp_path / "r.npz")
    again = load_result(tmp_path / "r.npz")
    for name, value in vars(SHAPE_ERRORS).items():
        np.testing.assert_array_equal(getattr(again.shape_errors, name), value)
    save_result(result, tmp_path / "without.npz")
    assert load_result(tmp_path / "without.npz").shape_errors is None


def test_a_notebook_shows_a_picture_and_the_figures(result):
    bump = np.zeros((24, 32), dtype=np.float32)
    bump[:, 24:] = 0.75
    shown = replace(result, depth=bump)._repr_html_()
    assert "&lt;b&gt;darker&lt;/b&gt; &amp; older" in shown
    assert "0.000 to 0.750 mm" in shown
    assert not re.search(r"https?://|<script", shown)
    picture = thumbnail(shown)
    assert picture.shape == (180, 240, 3)
    assert picture[90, 220].astype(int).sum() > picture[90, 20].astype(int).sum() + 200
    assert len(shown) < 100_000
    assert "0.750 mm" in repr(replace(result, depth=bump))
    assert "depth: unknown" in repr(replace(result, known=np.zeros_like(result.known)))


def test_what_is_not_known_is_no_zero_in_a_notebook(result):
    """Figures say unknown, the thumbnail is hatched there."""
    known = np.zeros_like(result.known)
    shown = replace(result, known=known)._repr_html_()
    assert shown.count("<td>unknown</td>") == 2  # depth and contacts
    assert "0.000" not in shown
    assert len(np.unique(thumbnail(shown).reshape(-1, 3), axis=0)) == 2
    known[:, : known.shape[1] // 2] = True
    half = thumbnail(replace(result, known=known)._repr_html_())
    gray = np.ptp(half.astype(int), axis=-1) == 0
    assert gray[:, 125:].all()
    assert not gray[:, :115].any()


def thumbnail(html):
    content = base64.b64decode(html.partition("base64,")[2].partition("'")[0])
    return cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_COLOR)


@pytest.fixture
def pressed(result):
    """Depth that grows to the right, deepest at a border pixel whose depth is not known, as in room light."""
    depth = np.tile(np.arange(32, dtype=np.float32) / 100, (24, 1))
    known = np.ones(result.shape, dtype=bool)
    depth[0, 0], depth[5, 20], depth[7, 9] = 3.77, 0.9, -0.2
    known[0, 0] = False
    return replace(result, depth=depth, known=known)


def test_depth_is_that_of_known_pixels(pressed):
    numbers = pressed.numbers
    assert (numbers.peak, numbers.lowest) == (np.float32(0.9), np.float32(-0.2))
    assert (numbers.x_px, numbers.y_px) == (20, 5)
    lower = replace(pressed, depth=pressed.depth - 9)
    assert (pressed.peak_mm, lower.peak_mm) == (numbers.peak, lower.numbers.peak)
    assert "3.77" not in repr(pressed)
    unknown = replace(pressed, known=np.zeros_like(pressed.known))
    assert unknown.numbers is None
    assert np.isnan(unknown.peak_mm)


@pytest.mark.parametrize("mm_per_px", [0.0634, (0.05, 0.08), None])
def test_area_and_volume_are_of_all_contacts(pressed, mm_per_px):
    numbers = replace(pressed, mm_per_px=mm_per_px).numbers
    pixel = np.prod(np.broadcast_to(mm_per_px or 1, 2))
    assert (numbers.contacts, numbers.contact_px) == (2, 30)
    assert numbers.area == pytest.approx(30 * pixel)
    assert numbers.volume == pytest.approx(pressed.depth[pressed.contact].sum(dtype=float) * pixel)
    assert numbers.over_time == {"peak": numbers.peak, "area": numbers.area, "volume": numbers.volume}


@pytest.fixture
def asked(result):
    """A result whose confidence and curl are computed on first use, and what was computed."""
    made = []

    def make(name):
        made.append(name)
        return getattr(result, name)

    later = {name: once(lambda name=name: make(name)) for name in ("confidence", "curl_rms")}
    return result.changed(**later), made


def test_a_value_is_computed_on_first_use_and_shared_by_copies(result, asked):
    fresh, made = asked
    other = fresh.changed(index=9)
    assert fresh.depth_mm.max() == other.depth_mm.max()
    assert not made
    assert other.confidence is result.confidence is fresh.confidence
    assert made == ["confidence"]
    assert fresh.changed().curl_rms == result.curl_rms
    assert fresh.changed(index=1).curl_rms == fresh.curl_rms == result.curl_rms
    assert made == ["confidence", "curl_rms"]
    assert (other.index, fresh.index) == (9, result.index)


def test_a_value_that_is_replaced_is_never_computed(result, asked):
    fresh, made = asked
    assert fresh.changed(confidence=result.confidence / 2).confidence.max() < 0.5
    assert fresh.changed(curl_rms=once(lambda: 3.0)).curl_rms == 3.0
    assert not made
    with pytest.raises(ValueError, match="confidence of shape"):
        fresh.changed(confidence=result.confidence[1:])


def test_threads_that_ask_at_once_get_one_value():
    entered, release, made = threading.Event(), threading.Event(), []

    def make():
        entered.set()
        assert release.wait(30)
        made.append(1)
        return np.zeros(3)

    later = once(make)
    with ThreadPoolExecutor(4) as pool:
        values = [pool.submit(later) for _ in range(4)]
        assert entered.wait(30)
        assert not any(value.done() for value in values)
        release.set()
        values = [value.result(30) for value in values]
    assert len(made) == 1
    assert all(value is values[0] for value in values)


def test_values_of_one_lock_may_need_each_other(result):
    """As the contact needs the sigma of depth, in a thread that holds the lock of both."""
    lock = threading.RLock()
    first = once(lambda: 2.0, lock)
    assert result.changed(curl_rms=once(lambda: first() + 1, lock)).curl_rms == 3.0


@pytest.mark.parametrize("of", [lambda one: pickle.loads(pickle.dumps(one)), copy.copy, copy.deepcopy])
def test_a_pickle_and_a_copy_hold_every_value(result, asked, of):
    fresh, made = asked
    again = of(fresh)
    assert sorted(made) == ["confidence", "curl_rms"]
    assert np.array_equal(again.confidence, result.confidence)
    assert again.curl_rms == result.curl_rms
    assert again.contacts == result.contacts
    assert np.array_equal(again.changed(index=4).gradients, result.gradients)


def test_a_value_that_cannot_be_computed_says_so_each_time(result):
    def fail():
        raise ConvergenceError("no")

    bad = result.changed(confidence=once(fail))
    for _ in range(2):
        with pytest.raises(ConvergenceError, match="no"):
            bad.confidence  # noqa: B018 - computed when asked for
    with pytest.raises(AttributeError, match="'Reconstruction' object has no attribute 'nothing'"):
        bad.nothing  # noqa: B018


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


def test_a_saved_result_comes_back_to_the_bit_with_every_optional_part(tmp_path, result):
    nothing = dict.fromkeys(("gradients_sigma", "observed_gradients", "index"))
    bare = replace(result, **nothing, mm_per_px=(0.06, 0.05), health=())
    full = replace(result, depth_sigma_mm=result.confidence * 0.1, outside_change=0.25)
    dots = np.arange(8, dtype=np.float32).reshape(4, 2)
    flow = MarkerFlow(dots, dots + 1, np.arange(4) > 1, dots[:, 0] / 10, result.mm_per_px)
    marked = replace(result, markers=flow)
    for k, one in enumerate((result, bare, full, marked)):
        save_result(one, tmp_path / f"{k}.npz")
        same(one, load_result(tmp_path / f"{k}.npz"))


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [
        ("markers_seen", np.ones(4, np.float32), "Expected markers_seen of another type, got float32"),
        ("markers_now_px", np.full((4, 2), np.nan, np.float32), "markers_now_px"),
        ("markers_sigma_px", np.ones(3, np.float32), "Expected sigma_px of shape"),
        ("markers_rest_px", None, "what it holds does not make a result"),
        ("zero", 3, "Expected zero as text, got int"),
        ("curl_rms", -1.0, "Expected curl_rms between 0 and inf"),
        ("index", "3", "Expected index as a number"),
        ("outside_change", "1", "Expected outside_change as a number"),
        (
            "health",
            [{"name": 3, "message": "", "figure": 0.0}],
            "Expected findings with a name and a message",
        ),
        ("health", [{"name": "", "message": "", "figure": "0"}], "Expected figure as a number"),
    ],
)
def test_damaged_parts_are_refused(tmp_path, result, name, value, said):
    dots = np.zeros((4, 2), dtype=np.float32)
    flow = MarkerFlow(dots, dots, np.ones(4, dtype=bool), dots[:, 0], result.mm_per_px)
    save_result(replace(result, markers=flow), tmp_path / "x.npz")
    arrays, meta = read_npz(tmp_path / "x.npz", kind=KIND, newest_version=1, max_bytes=1e6, error=DataError)
    own = {key: one for key, one in meta.items() if not key.endswith(("format", "version", "_digest"))}
    own["calibration_digest"] = ""
    (arrays if name in arrays else own)[name] = value
    kept = {key: array for key, array in arrays.items() if array is not None}
    write_npz(tmp_path / "y.npz", kept, own, kind=KIND, version=1)
    with pytest.raises(DataError, match=f"is damaged: .*{said}"):
        load_result(tmp_path / "y.npz")


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
    # With a new format comes a file of the one before, written by the release that wrote it.
    kept = {int(path.stem.rsplit("-", 1)[1]) for path in DATA.glob("result-version-*.npz")}
    assert kept == set(range(1, FORMAT_VERSION + 1))


def test_an_existing_result_stays(tmp_path, result):
    (tmp_path / "x.npz").write_text("mine")
    with pytest.raises(DataError, match="already there"):
        save_result(result, tmp_path / "x.npz")
    assert (tmp_path / "x.npz").read_text() == "mine"
    save_result(result, tmp_path / "x.npz", overwrite=True)
    same(result, load_result(tmp_path / "x.npz"))


def test_a_file_of_another_format_or_of_no_result_is_refused(tmp_path, result):
    """How files are altered and cut: tests/foundations."""
    depth = {"depth_mm": np.zeros((3, 4))}
    for arrays, version, said in (
        ({}, 99, r"format version 99.*Install that release or a newer one"),
        (depth, 1, "is damaged: 'zero' is missing"),
    ):
        write_npz(tmp_path / "x.npz", arrays, {}, kind=KIND, version=version, overwrite=True)
        with pytest.raises(DataError, match=said):
            load_result(tmp_path / "x.npz")
    save_result(result, tmp_path / "x.npz", overwrite=True)
    (tmp_path / "x.npz").write_bytes((tmp_path / "x.npz").read_bytes()[:-900])
    with pytest.raises(DataError, match="truncated or damaged, or no gelform result"):
        load_result(tmp_path / "x.npz")


DOCS = Path(__file__).parents[2] / "docs"


def test_the_table_has_every_map_of_a_result_and_its_file(result, tmp_path):
    """A row of the table is the field, and a Reconstructor's result has what its record makes of that name."""
    maps = {"Map", "Slopes", "Mask"}
    held = [entry.name for entry in fields(Reconstruction) if entry.type.split()[0] in maps]
    assert held == ["depth", *(row.name for row in BESIDE_DEPTH)]
    given = {"depth", "known", "observed_gradients"}  # with the depth
    assert set(held) - given == {name for name in held if hasattr(FrameRecord, name)}
    for row in MAPS.values():
        values = getattr(result, row.name)
        if values is not None:
            assert (values.shape, values.dtype) == ((*result.shape, *row.axes), np.dtype(row.dtype)), row.name
    save_result(result, tmp_path / "x.npz")
    with np.load(tmp_path / "x.npz") as file:
        derived = {row.name for row in MAPS.values() if row.derived}
        assert MAPS.keys() - derived - {"depth_sigma_mm"} <= set(file.files)
        assert float(file["mm_per_px"]) == 0.0634
        assert np.array_equal(file["depth_mm"], result.depth_mm)


def test_the_documents_list_what_a_batch_keeps_and_help_reads_the_table_without_numpy():
    assert f"any of {', '.join(KEPT_MAPS)} |" in (DOCS / "batch.md").read_text(encoding="utf-8")
    program = "import sys, gelform.result.maps; sys.exit('numpy' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", program], check=False).returncode == 0
