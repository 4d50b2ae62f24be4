"""What to do with files of other programs, by their names.

Whole files: what is no file, too large or unreadable is named before anything is read.

Picture files hold the pixels that were given, red first.

Tables: text comes back as it was, and no cell begins as a formula does.

Files are written whole or not at all, and an altered, cut or future one is refused with the reason.
"""

import csv
import errno
import io
import json
import os
import stat
import sys
import threading
import time
import zipfile
from concurrent.futures import ThreadPoolExecutor

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from gelform import __version__
from gelform.errors import CalibrationError, DataError
from gelform.foundations import files
from gelform.foundations.files import (
    FAST_PNG,
    LIVE_PNG,
    WAYS,
    bytes_of,
    check_free,
    kind_of_npz,
    locked_folder,
    npz_bytes,
    picture_bytes,
    plain_cell,
    present_file,
    read_npz,
    sweep,
    table_text,
    way_for,
    write_npz,
    written_file,
)


def test_other_kinds_have_no_way_and_names_stay_as_they_are():
    assert way_for("a.png") == way_for("folder") == ""
    assert "rosbags-convert --src {x} 1.bag --dst {x} 1_mcap" in way_for("day/{x} 1.bag")
    assert all(way_for(f"a{suffix}").startswith(" ") for suffix in WAYS)


def test_a_file_of_the_largest_size_is_read_and_a_larger_one_is_not(tmp_path):
    path = tmp_path / "a.bin"
    path.write_bytes(bytes(range(100)))
    assert bytes_of(path, "numbers", 100) == bytes(range(100))
    assert present_file(path, "numbers") == path
    said = r"Expected numbers of at most 9\.9e-05 MB, got .*a\.bin of 0\.0001 MB"
    with pytest.raises(CalibrationError, match=said):
        bytes_of(path, "numbers", 99, CalibrationError)


@pytest.mark.skipif(sys.platform == "win32", reason="no pipes with a name")
def test_what_is_no_file_is_named(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "link").symlink_to(tmp_path / "link")
    for name, said in (
        (".", "got the folder"),
        ("none", r"No file .*none: expected numbers"),
        ("pipe", "a pipe or a device"),
        ("link", r"Cannot read .*link: Too many levels"),
    ):
        with pytest.raises(DataError, match=said):
            bytes_of(tmp_path / name, "numbers", 100)


TEXT = st.text(st.sampled_from("=+-@'\t\r\n,\"ab1."), max_size=6)


@given(st.lists(st.lists(TEXT, min_size=2, max_size=4), min_size=1, max_size=4))
def test_text_comes_back_and_is_no_formula(rows):
    read = list(csv.reader(io.StringIO(table_text(rows), newline="")))
    assert [[plain_cell(cell) for cell in row] for row in read] == rows
    for cell in (cell for row in read for cell in row if cell[:1] and cell[0] in "=+-@\t\r"):
        float(cell)  # a number


def test_numbers_stay_numbers():
    row = ["=1+1", "-1.5", "-1e-3", -2, 0.25, "-x", None, "'a"]
    assert table_text([row]) == "'=1+1,-1.5,-1e-3,-2,0.25,'-x,,'a\n"


KIND = "gelform test file"
ARRAYS = {"depth_mm": np.arange(12, dtype=np.float32).reshape(3, 4), "known": np.eye(3, dtype=bool)}
META = {"sensor": "Gel é", "view": {"flip": "none"}, "sizes": [1, 2.5, None]}


def write(path, arrays=ARRAYS, meta=META, *, version=1, overwrite=False):
    write_npz(path, arrays, meta, kind=KIND, version=version, overwrite=overwrite)


def read(path, *, kind=KIND, newest_version=1, max_bytes=1 << 20, error=DataError):
    return read_npz(path, kind=kind, newest_version=newest_version, max_bytes=max_bytes, error=error)


def members(path):
    with zipfile.ZipFile(path) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def rewrite(path, changed):
    """The same file with some members' bytes replaced: what an editor or a bad disk would leave."""
    kept = members(path) | changed
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in kept.items():
            archive.writestr(name, content)


def npy(array):
    buffer = io.BytesIO()
    np.save(buffer, array)
    return buffer.getvalue()


@settings(max_examples=25, deadline=None)
@given(
    hnp.arrays(
        st.sampled_from([np.float32, np.float64, np.uint8, np.bool_, np.int64]),
        hnp.array_shapes(min_dims=0, max_dims=4, min_side=0, max_side=4),
    )
)
def test_what_is_written_comes_back_to_the_bit(tmp_path_factory, array):
    path = tmp_path_factory.mktemp("npz") / "x.npz"
    write(path, {"a": array, "f": np.array(array, order="F")})
    arrays, meta = read(path)
    for name in ("a", "f"):
        assert arrays[name].dtype == array.dtype
        assert arrays[name].shape == array.shape
        assert arrays[name].tobytes() == array.tobytes()
    assert {key: meta[key] for key in META} == META
    assert (meta["format"], meta["format_version"]) == (KIND, 1)


def test_numpy_opens_it_without_pickles_and_the_same_content_gives_the_same_bytes(tmp_path):
    write(tmp_path / "a.npz")
    write(tmp_path / "b.npz")
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()
    with np.load(tmp_path / "a.npz", allow_pickle=False) as file:
        assert np.array_equal(file["depth_mm"], ARRAYS["depth_mm"])
        assert json.loads(str(file["meta"]))["sensor"] == "Gel é"


def test_a_truncated_file_is_refused(tmp_path):
    for kept in (0, 1, 50, 0.3, 0.7, 0.99):
        path = tmp_path / "x.npz"
        write(path, overwrite=True)
        content = path.read_bytes()
        path.write_bytes(content[: kept if isinstance(kept, int) else int(kept * len(content))])
        with pytest.raises(DataError, match="truncated or damaged"):
            read(path)


def test_a_flipped_bit_anywhere_in_the_content_is_refused(tmp_path):
    path = tmp_path / "x.npz"
    write(path)
    content = path.read_bytes()
    for position in range(0, len(content), 97):
        broken = bytearray(content)
        broken[position] ^= 4
        path.write_bytes(bytes(broken))
        try:
            arrays, meta = read(path)
        except DataError:
            continue
        # What is left are bits that say nothing of the content, such as a member's time stamp.
        assert arrays["depth_mm"].tobytes() == ARRAYS["depth_mm"].tobytes()
        assert {key: meta[key] for key in META} == META


LYING = npy(np.zeros(1)).replace(b"(1,), }       ", b"(99999999,), }")
UNSIGNED = json.dumps({"format": KIND, "format_version": 1, "digest": ""})[:-1]
ALTERED = "altered after it was written"
CHANGED = [  # a member, its bytes or its settings, and what is said
    ("depth_mm", npy(ARRAYS["depth_mm"] + 1), ALTERED),
    ("depth_mm", npy(ARRAYS["depth_mm"].reshape(4, 3)), ALTERED),
    ("extra", npy(np.zeros(2)), ALTERED),
    ("meta", {"sensor": "another"}, ALTERED),
    ("depth_mm", npy(np.array([{"a": 1}], dtype=object)), "pickled objects"),
    ("depth_mm", LYING, r"an array of shape \(99999999,\) in 8 bytes"),
    *(
        ("meta", npy(np.array(f'{UNSIGNED}, "size": {number}}}')), "finite numbers in the settings")
        for number in ("1e400", "-1e400", "NaN")
    ),
]


@pytest.mark.parametrize(("member", "content", "said"), CHANGED)
def test_what_was_altered_and_what_no_file_holds_is_refused(tmp_path, member, content, said):
    path = tmp_path / "x.npz"
    write(path)
    if isinstance(content, dict):
        content = npy(np.array(json.dumps(json.loads(str(np.load(path)["meta"])) | content)))
    rewrite(path, {f"{member}.npy": content})
    with pytest.raises(DataError, match=said):
        read(path)


def test_a_future_file_names_the_version_to_install(tmp_path):
    write(tmp_path / "x.npz", version=3)
    with pytest.raises(DataError, match=r"format version 3.*up to version 2.*pip install 'gelform>="):
        read(tmp_path / "x.npz", newest_version=2)
    assert read(tmp_path / "x.npz", newest_version=3)[1]["format_version"] == 3


def test_sizes_are_checked_before_reading(tmp_path):
    path = tmp_path / "x.npz"
    write(path, {"big": np.zeros(100_000, dtype=np.uint8)})
    with pytest.raises(DataError, match=r"declares 0\.1012 MB; a gelform test file has at most 0\.05 MB"):
        read(path, max_bytes=50_000)


@pytest.mark.filterwarnings("ignore:Duplicate name")
def test_no_more_is_read_than_is_declared(tmp_path, monkeypatch):
    """A name may stand often: by its name, each entry would be the last one."""
    path, read_bytes = tmp_path / "x.npz", []
    write(path, {"big": np.zeros(10_000, np.uint8)})
    with zipfile.ZipFile(path, "a") as archive:
        for array in [np.zeros(0)] * 9 + [np.zeros(10_000, np.uint8)]:
            archive.writestr("more.npy", npy(array))
    monkeypatch.setattr(files, "_array", lambda content: read_bytes.append(len(content)) or np.array("{}"))
    with pytest.raises(DataError):
        read(path)
    with zipfile.ZipFile(path) as archive:
        assert read_bytes == [member.file_size for member in archive.infolist()]


def test_a_file_says_what_it_is_and_others_are_refused(tmp_path):
    write(tmp_path / "x.npz")
    np.savez(tmp_path / "plain.npz", a=np.zeros(3))
    (tmp_path / "text.npz").write_text("hello")
    assert kind_of_npz(tmp_path / "x.npz") == KIND
    with pytest.raises(CalibrationError, match="Expected a gelform calibration, got a gelform test file"):
        read(tmp_path / "x.npz", kind="gelform calibration", error=CalibrationError)
    for name, said in (
        ("plain.npz", "no member 'meta'"),
        ("text.npz", "no gelform test file at all"),
        ("missing.npz", "No file"),
    ):
        assert kind_of_npz(tmp_path / name) is None
        with pytest.raises(DataError, match=said):
            read(tmp_path / name)


def test_an_existing_file_stays_unless_overwritten_and_a_failed_write_leaves_nothing_behind(tmp_path):
    path = tmp_path / "x.npz"
    path.write_text("mine")
    with pytest.raises(DataError, match=r"already there.*overwrite=True"):
        write(path)
    with pytest.raises(KeyError), written_file(path, overwrite=True) as handle:
        handle.write(b"half" + {}["the other half"])
    assert path.read_text() == "mine"
    assert [entry.name for entry in tmp_path.iterdir()] == ["x.npz"]
    write(path, overwrite=True)
    assert read(path)


@pytest.mark.skipif(sys.platform == "win32", reason="no pipes with a name")
def test_only_files_are_replaced(tmp_path):
    """A rename over a device takes the device from everyone."""
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "circle").symlink_to("circle")
    (tmp_path / "to_pipe").symlink_to("pipe")
    (tmp_path / "to_folder").symlink_to(tmp_path)
    cases = ("pipe", "pipe"), ("to_pipe", "pipe"), ("circle", "circle of"), ("to_folder", "folder")
    for overwrite in (False, True):
        for name, said in cases:
            with pytest.raises(DataError, match=f"Expected a file.*got the {said}"):
                write(tmp_path / name, overwrite=overwrite)
        with pytest.raises(DataError, match=r"got the device /dev/null\. Choose another name"):
            check_free("/dev/null", overwrite=overwrite)
        with pytest.raises(CalibrationError, match=r"Cannot write .*: File name too long"):
            check_free(tmp_path / ("\u00e9" * 200), overwrite=overwrite, error=CalibrationError)
    assert stat.S_ISFIFO(os.lstat(tmp_path / "pipe").st_mode)
    assert sorted(one.name for one in tmp_path.iterdir()) == ["circle", "pipe", "to_folder", "to_pipe"]


def test_a_link_stays_and_its_target_is_replaced(tmp_path):
    (tmp_path / "far").mkdir()
    target, link, second = tmp_path / "far" / "x.npz", tmp_path / "link.npz", tmp_path / "second.npz"
    try:
        link.symlink_to("far/x.npz")
        second.symlink_to("link.npz")
    except OSError:
        pytest.skip("this system makes no symbolic links")
    for there in (False, True):
        with pytest.raises(DataError, match="already there"):
            write(second)
        assert target.exists() == there
        write(second, {"a": np.array(there)}, overwrite=True)
        assert (os.readlink(link), os.readlink(second)) == ("far/x.npz", "link.npz")
        assert read(target)[0]["a"] == there
    assert [one.name for one in target.parent.iterdir()] == ["x.npz"]


def refuses(*_):
    raise OSError(errno.EPERM, "Operation not permitted")


@pytest.mark.parametrize("links", [True, False], ids=["hard links", "none"])
def test_one_of_all_who_write_is_told_so(tmp_path, monkeypatch, links):
    if not links:
        monkeypatch.setattr(os, "link", refuses)
    tries, threads = 40, 3
    together, refused = threading.Barrier(threads, timeout=60), []

    def checked_by_all(*given, **settings):
        """All have seen a free name before anyone takes it."""
        target = check_free(*given, **settings)
        together.wait()
        return target

    monkeypatch.setattr(files, "check_free", checked_by_all)

    def told(number):
        done = set()
        for k in range(tries):
            try:
                with written_file(tmp_path / f"{k}", flushed=False) as handle:
                    handle.write(b"%d" % number)
                done.add(k)
            except DataError as problem:
                refused.append(str(problem))
        return done

    with ThreadPoolExecutor(threads) as pool:
        done = list(pool.map(told, range(threads)))
    assert sorted(k for one in done for k in one) == list(range(tries))
    assert len(refused) == tries * (threads - 1)
    assert all("already there" in one for one in refused)
    for number, of in enumerate(done):
        assert {(tmp_path / f"{k}").read_bytes() for k in of} <= {b"%d" % number}
    assert len(list(tmp_path.iterdir())) == tries


def test_a_name_that_is_taken_is_given_back_if_the_rename_fails(tmp_path, monkeypatch):
    monkeypatch.setattr(os, "link", refuses)
    monkeypatch.setattr(os, "replace", refuses)
    with pytest.raises(DataError, match=r"Operation not permitted\. Nothing of it was kept"):
        write(tmp_path / "x.npz")
    assert list(tmp_path.iterdir()) == []


def test_a_full_disk_is_said_and_leaves_nothing(tmp_path):
    resource = pytest.importorskip("resource", reason="a limit on the size of files stands for a full disk")
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1 << 16, hard))
    try:
        with pytest.raises(DataError, match="Nothing of it was kept"):
            write(tmp_path / "x.npz", {"big": np.zeros(1 << 18, dtype=np.uint8)})
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert list(tmp_path.iterdir()) == []


def test_missing_folders_and_folders_for_names_are_refused(tmp_path):
    with pytest.raises(DataError, match="does not exist"):
        write(tmp_path / "no" / "x.npz")
    with pytest.raises(DataError, match="got the folder"):
        write(tmp_path)


def test_what_json_or_npz_cannot_hold_is_refused(tmp_path):
    with pytest.raises(ValueError, match="JSON"):
        write(tmp_path / "x.npz", meta={"value": float("nan")})
    with pytest.raises(TypeError, match="array of objects"):
        write(tmp_path / "x.npz", {"a": np.array([None])})
    with pytest.raises(ValueError, match="reserved digest"):
        write(tmp_path / "x.npz", meta={"digest": "1"})
    assert list(tmp_path.iterdir()) == []


def test_bytes_are_those_of_a_file_but_for_the_digest(tmp_path):
    arrays = {"a": np.arange(6.0).reshape(2, 3)}
    path = tmp_path / "x.npz"
    path.write_bytes(npz_bytes(arrays, {"name": "y"}, kind="k", version=3))
    with np.load(path) as file:
        np.testing.assert_array_equal(file["a"], arrays["a"])
        meta = json.loads(str(file["meta"]))
    assert meta == {"format": "k", "format_version": 3, "gelform_version": __version__, "name": "y"}
    with pytest.raises(DataError, match="digest"):
        read_npz(path, kind="k", newest_version=3)
    with pytest.raises(ValueError, match="reserved"):
        npz_bytes(arrays, {"format": "other"}, kind="k", version=1)


def aged(path):
    """Make a path as it was left an hour ago."""
    os.utime(path, (time.time() - 3600,) * 2)


def test_what_killed_runs_left_is_swept_and_nothing_else(tmp_path):
    pytest.importorskip("fcntl")
    left, first, second, young = (
        tmp_path / f"{name}.tmp"
        for name in (
            ".gelform-0123456789ab",
            ".gelform-mine",
            "gelform-0123456789ab",
            ".gelform-0123456789ac",
        )
    )
    for path in (left, first, second, young):
        path.write_text("x")
    targets = (".out.partial-abcd_012", ".out.partial-77", ".other.partial-abcd_012", ".out.partial-mine")
    folders = [tmp_path / name for name in targets]
    for folder in folders:
        (folder / "images").mkdir(parents=True)
    for path in (left, first, second, *folders):
        aged(path)
    with written_file(tmp_path / "new.npz") as handle:
        (held,) = set(tmp_path.glob(".gelform-*.tmp")) - {left, first, young}
        handle.flush()
        aged(held)
        sweep(tmp_path)
        assert held.exists()
    assert not left.exists()
    assert all(path.exists() for path in (first, second, young, *folders))
    with locked_folder(folders[1]):
        sweep(tmp_path, "out")
        assert [folder.exists() for folder in folders] == [False, True, True, True]
    sweep(tmp_path, "out")
    assert [folder.exists() for folder in folders] == [False, False, True, True]


IMAGE = np.random.default_rng(0).integers(0, 256, (7, 9, 3)).astype(np.uint8)


def decoded(content):
    return cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED)


@pytest.mark.parametrize("settings", [(), FAST_PNG, LIVE_PNG])
def test_images_come_back_with_red_first(settings):
    np.testing.assert_array_equal(decoded(picture_bytes(IMAGE, settings=settings))[..., ::-1], IMAGE)


def test_maps_keep_their_type():
    levels = IMAGE[..., 0].astype(np.uint16) * 257
    np.testing.assert_array_equal(decoded(picture_bytes(levels)), levels)
    depth = levels.astype(np.float32) / 7
    np.testing.assert_array_equal(decoded(picture_bytes(depth, ".tiff")), depth)


def test_what_no_picture_holds_is_refused():
    with pytest.raises(DataError, match="cannot encode a picture of 0x4 px as PNG"):
        picture_bytes(np.zeros((0, 4, 3), np.uint8))
