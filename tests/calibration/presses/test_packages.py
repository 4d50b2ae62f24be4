"""Other packages' folders give the same presses as a press folder of the same images."""

import io
import json
import shutil
import zipfile

import cv2
import numpy as np
import pytest

import gelform
from gelform.calibration.presses.folder import kind_of_presses

HOW = {"mm_per_px": 0.1, "ball_diameter_mm": 5}


@pytest.fixture
def py3dcal(folder, simulated, tmp_path):
    """The simulated presses of the first ball as py3DCal lays them out."""
    target = tmp_path / "py3dcal"
    for name in ("annotations", "blank_images", "probe_images"):
        (target / name).mkdir(parents=True)
    shutil.copy(folder / "background.png", target / "blank_images" / "blank.png")
    first = simulated.presses[0].ball_diameter_mm
    rows = ["img_name,x_mm,y_mm,penetration_depth_mm,x_px,y_px"]
    for k, press in enumerate(simulated.presses):
        if press.ball_diameter_mm == first:
            bgr = cv2.cvtColor(press.image, cv2.COLOR_RGB2BGR)
            cv2.imwrite(str(target / "probe_images" / f"{k}_X1Y2.png"), bgr)
            x, y = press.center_px
            rows.append(f"{k}_X1Y2.png,1.0,2.0,0.5,{x},{y}")
    (target / "annotations" / "annotations.csv").write_text("\n".join(rows) + "\n")
    facts = {"px_per_mm": 1 / simulated.sensor.mm_per_px, "probe_radius_mm": first / 2}
    (target / "annotations" / "metadata.json").write_text(json.dumps(facts))
    return target


@pytest.fixture
def pack(simulated, tmp_path):
    """The simulated presses as Taxim's dataPack.npz, as arrays to be spoiled and the path to save them at."""
    arrays = {
        "f0": simulated.background[..., ::-1],
        "imgs": np.stack([press.image[..., ::-1] for press in simulated.presses]),
        "touch_center": np.array([press.center_px for press in simulated.presses]),
        "touch_radius": np.array([round(press.contact_radius_px) for press in simulated.presses]),
        "names": np.array([f"frame_{k}.jpg" for k in range(len(simulated.presses))]),
    }
    return arrays, tmp_path / "dataPack.npz"


def test_py3dcal_folder(py3dcal, simulated):
    assert kind_of_presses(py3dcal) == "py3DCal folder"
    read = gelform.read_presses(py3dcal)
    truth = simulated.presses[::2]
    assert len(read.presses) == len(truth)
    for press, true in zip(read.presses, truth):
        np.testing.assert_array_equal(press.image, true.image)
        assert press.ball_diameter_mm == pytest.approx(true.ball_diameter_mm)
        assert press.center_px == pytest.approx(true.center_px)
        assert press.label is None  # the stage knows where, not how wide
    assert read.mm_per_px == pytest.approx(simulated.sensor.mm_per_px)
    np.testing.assert_array_equal(read.background, simulated.background)


def test_py3dcal_before_its_annotation_says_what_is_missing(py3dcal):
    (py3dcal / "annotations" / "annotations.csv").rename(py3dcal / "annotations" / "probe_data.csv")
    with pytest.raises(
        gelform.DataError, match=r"annotations\.csv.* is missing\. probe_data\.csv .*Run py3DCal's annotate"
    ):
        gelform.read_presses(py3dcal)
    shutil.move(py3dcal / "annotations" / "probe_data.csv", py3dcal / "probe_data.csv")
    shutil.rmtree(py3dcal / "annotations")
    with pytest.raises(gelform.DataError, match=r"is missing\. probe_data\.csv .*Run py3DCal's annotate"):
        gelform.read_presses(py3dcal)


def test_py3dcal_metadata_beside_the_folders_and_what_is_given_goes_first(py3dcal):
    shutil.move(py3dcal / "annotations" / "metadata.json", py3dcal / "metadata.json")
    read = gelform.read_presses(py3dcal, mm_per_px=0.2, ball_diameter_mm=4)
    assert (read.mm_per_px, read.presses[0].ball_diameter_mm) == (0.2, 4)


def test_spoilt_py3dcal(py3dcal):
    facts = py3dcal / "annotations" / "metadata.json"
    spoilt = ['{"px_per_mm": 0, "probe_radius_mm": 2}', "{not json", "[" * 100_000]
    for text in (*spoilt, '{"px_per_mm": 1' + "0" * 400 + ', "probe_radius_mm": 2}'):
        facts.write_text(text)
        with pytest.raises(gelform.DataError, match="px_per_mm and probe_radius_mm > 0"):
            gelform.read_presses(py3dcal)
    facts.unlink()
    with pytest.raises(gelform.DataError, match=r"No file .*metadata\.json"):
        gelform.read_presses(py3dcal)
    (py3dcal / "blank_images" / "blank.png").unlink()
    with pytest.raises(gelform.DataError, match=r"No background in .*blank_images"):
        gelform.read_presses(py3dcal)


def test_py3dcal_without_annotated_columns(py3dcal):
    (py3dcal / "annotations" / "annotations.csv").write_text("img_name,x_mm,y_mm\na.png,1,2\n")
    with pytest.raises(gelform.DataError, match="x_px, y_px missing"):
        gelform.read_presses(py3dcal)


@pytest.mark.parametrize("where", ["file", "folder"])
def test_taxim_pack_is_turned_to_rgb(pack, simulated, where):
    arrays, path = pack
    np.savez(path, **arrays)
    place = path if where == "file" else path.parent
    assert kind_of_presses(place) == "Taxim dataPack"
    read = gelform.read_presses(place, mm_per_px=0.1, ball_diameter_mm=5)
    np.testing.assert_array_equal(read.background, simulated.background)
    for k, (press, true) in enumerate(zip(read.presses, simulated.presses)):
        np.testing.assert_array_equal(press.image, true.image)
        assert press.name == f"frame_{k}.jpg"
        assert press.label == pytest.approx((*true.center_px, round(true.contact_radius_px)))


def test_what_counts_as_a_taxim_pack(pack, tmp_path):
    np.savez(tmp_path / "renamed.npz", **pack[0])
    assert kind_of_presses(tmp_path / "renamed.npz") == "Taxim dataPack"
    np.savez(tmp_path / "else.npz", depth=np.zeros(3))
    assert kind_of_presses(tmp_path / "else.npz") is None
    (tmp_path / "text.npz").write_text("no archive")
    with pytest.raises(gelform.DataError, match="a file of another kind"):
        gelform.read_presses(tmp_path / "text.npz")


class Trap:
    def __reduce__(self):
        return (pytest.fail, ("unpickled",))


@pytest.mark.parametrize(
    ("changed", "how", "message"),
    [
        ({}, {"mm_per_px": 0.1}, "which ball pressed"),
        ({}, {"ball_diameter_mm": 5}, "No scale"),
        ({"imgs": np.array([Trap()], dtype=object)}, HOW, r"Python objects.*refused"),
        ({"touch_radius": np.ones(3)}, HOW, r"touch_radius \(N,\)"),
        ({"f0": None}, HOW, "f0 missing"),
    ],
)
def test_spoilt_taxim_packs_are_refused_and_never_unpickled(pack, changed, how, message):
    arrays, path = pack
    np.savez(path, **{name: one for name, one in {**arrays, **changed}.items() if one is not None})
    with pytest.raises(gelform.DataError, match=message):
        gelform.read_presses(path, **how)
    path.write_bytes(path.read_bytes()[:2000])
    with pytest.raises(gelform.DataError, match="truncated or damaged"):
        gelform.read_presses(path, **HOW)


def test_real_taxim_pack(data):
    read = gelform.read_presses(data / "taxim-ball-lowres", mm_per_px=0.1, ball_diameter_mm=4)
    assert len(read.presses) == 49
    assert read.image_shape == (120, 160)
    assert all(press.label is not None for press in read.presses)


@pytest.mark.parametrize("name", ["f0", "imgs", "touch_center", "touch_radius"])
def test_a_member_of_a_taxim_pack_that_is_no_array_of_numbers_is_refused(pack, name):
    arrays, path = pack
    with zipfile.ZipFile(path, "w") as archive:
        for other, array in arrays.items():
            stream = io.BytesIO()
            np.save(stream, array)
            archive.writestr(*((other, b"raw") if other == name else (f"{other}.npy", stream.getvalue())))
    with pytest.raises(gelform.DataError, match=f"Expected {name} as an array of numbers"):
        gelform.read_presses(path, mm_per_px=0.1, ball_diameter_mm=5.0)
    np.savez(path, **{**arrays, name: np.array(["a", "b"])})
    with pytest.raises(gelform.DataError, match=f"Expected {name} as an array of numbers"):
        gelform.read_presses(path, mm_per_px=0.1, ball_diameter_mm=5.0)
