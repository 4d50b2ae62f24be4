"""Imported networks give their own packages' answers, with gelform's signs."""

import cv2
import numpy as np
import pytest

import gelform
from gelform.importers.networks import read_gs_sdk, read_gsrobotics, read_gsrobotics_web
from made.networks import network_arrays, torch_file

SHAPE = (12, 16)
BACKGROUND = np.random.default_rng(0).uniform(60, 160, (*SHAPE, 3)).astype(np.float32)


def image_and_change(seed=1, background=BACKGROUND):
    image = np.random.default_rng(seed).integers(1, 255, (*SHAPE, 3)).astype(np.float32)
    return image, (image - background) / np.float32(255)


def slopes_of(model, change, background=BACKGROUND):
    return model.prepare(background, background.shape[:2]).gradients_from_color(change)[0]


def answered(arrays, image, position):
    """The network in plain numpy: B, G, R and two positions in, two numbers out."""
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    places = {"xy": (x / SHAPE[1], y / SHAPE[0]), "yx": (y / SHAPE[0], x / SHAPE[1]), "zeros": (0 * x, 0 * y)}
    values = np.stack([image[..., 2] / 255, image[..., 1] / 255, image[..., 0] / 255, *places[position]], -1)
    for k in range(1, 5):
        values = values @ arrays[f"fc{k}.weight"].T.astype(float) + arrays[f"fc{k}.bias"]
        values = np.maximum(values, 0) if k < 4 else values
    return values


def test_gs_sdk_angles_go_down_where_pressed(tmp_path):
    arrays = network_arrays((5, 32, 32, 32, 2))
    model = read_gs_sdk(torch_file(tmp_path / "nnmodel.pth", arrays), BACKGROUND)
    image, change = image_and_change()
    found = slopes_of(model, change)
    theirs = np.tan(answered(arrays, image, "xy")) - np.tan(answered(arrays, BACKGROUND, "xy"))
    np.testing.assert_allclose(found, -theirs, atol=2e-5)


@pytest.mark.parametrize(("position", "places"), [("zeros", "zeros"), ("true", "yx")])
def test_gsrobotics_normals(tmp_path, position, places):
    arrays = {name: 0.6 * a for name, a in network_arrays((5, 64, 64, 64, 2)).items()}
    model = read_gsrobotics(torch_file(tmp_path / "n.pt", arrays, nested=True), BACKGROUND, position=position)
    image, change = image_and_change()
    found = slopes_of(model, change)

    def slopes(seen):
        n = answered(arrays, seen, places)
        return -n / np.sqrt(1 - np.sum(n**2, axis=-1, keepdims=True))

    np.testing.assert_allclose(found, slopes(image) - slopes(BACKGROUND), atol=2e-5)


def test_another_background_is_rest_too(tmp_path):
    model = read_gs_sdk(torch_file(tmp_path / "n.pth", network_arrays((5, 32, 32, 32, 2))), BACKGROUND)
    today, differences = BACKGROUND + 3, []
    assert np.abs(slopes_of(model, np.zeros_like(today), today)).max() == 0
    for seed in (1, 7):  # the same image, so only the answer at rest differs
        now = slopes_of(model, image_and_change(seed, today)[1], today)
        differences.append(now - slopes_of(model, image_and_change(seed)[1]))
    np.testing.assert_allclose(*differences, atol=1e-5)


def test_normals_that_are_too_long_stay_finite(tmp_path):
    arrays = network_arrays((5, 64, 64, 64, 2))
    arrays["fc4.bias"] = np.array([2.0, 0.0], dtype=np.float32)
    model = read_gsrobotics(torch_file(tmp_path / "n.pt", arrays), BACKGROUND, position="true")
    found = slopes_of(model, image_and_change()[1])
    assert np.isfinite(found).all()
    assert np.abs(found).max() <= 10.0 + 1e-5


def test_the_browser_port_holds_the_same_network(tmp_path):
    arrays = network_arrays((5, 64, 64, 64, 2))
    numbers = np.concatenate([array.ravel() for array in arrays.values()]).astype("<f4")
    assert numbers.size == 8834
    numbers.tofile(tmp_path / "weights.bin")
    a = read_gsrobotics_web(tmp_path / "weights.bin", BACKGROUND, position="true")
    b = read_gsrobotics(torch_file(tmp_path / "n.pt", arrays), BACKGROUND, position="true")
    change = image_and_change()[1]
    np.testing.assert_array_equal(slopes_of(a, change), slopes_of(b, change))
    (tmp_path / "weights.bin").write_bytes(numbers.tobytes()[:-4])
    with pytest.raises(gelform.DataError, match="Expected 35336 bytes"):
        read_gsrobotics_web(tmp_path / "weights.bin", BACKGROUND, position="true")


def test_frames_equal_scattered_pixels_and_saved_models(tmp_path):
    model = read_gs_sdk(torch_file(tmp_path / "n.pth", network_arrays((5, 32, 32, 32, 2))), BACKGROUND)
    change = image_and_change()[1]
    frame = slopes_of(model, change)
    rows, columns = np.array([0, 3, 11]), np.array([15, 4, 0])
    scattered = model.gradients_at(change[rows, columns], columns, rows)
    np.testing.assert_allclose(scattered, frame[rows, columns], atol=1e-6)
    again = type(model).from_arrays(*model.to_arrays())
    np.testing.assert_array_equal(slopes_of(again, change), frame)
    with pytest.raises(ValueError, match="as imported, got 10x10"):
        model.prepare(np.zeros((10, 10, 3)), (10, 10))


def test_networks_of_another_kind_are_refused(tmp_path):
    touchnet = {"conv1.weight": np.zeros((4, 5, 3, 3), np.float32), "bn1.weight": np.zeros(4, np.float32)}
    spoilt = network_arrays((5, 32, 8, 8, 2))
    spoilt["fc2.weight"][0, 0] = np.nan
    for arrays, said in (
        (touchnet, "298 GMAC"),
        (network_arrays((5, 32, 2)), "Expected the layers fc1 to fc4"),
        (network_arrays((3, 32, 8, 8, 2)), "5 inputs and 2 outputs"),
        (network_arrays((5, 64, 64, 64, 2)), r"32 units .* is it gsrobotics's\?"),
        (spoilt, "finite"),
    ):
        with pytest.raises(gelform.DataError, match=said):
            read_gs_sdk(torch_file(tmp_path / "net.pth", arrays), BACKGROUND)


def read_rgb(path):
    return cv2.imread(str(path))[..., ::-1].astype(np.float32)


@pytest.mark.parametrize("name", ["bead", "key", "seed"])
def test_real_gs_sdk_answers_as_published(data, name):
    reference = np.load(data / "peer-calibrations" / "reference_outputs.npz")[f"gs_sdk_{name}_gradients"]
    background = read_rgb(data / "mini-objects" / "background.png")
    change = (read_rgb(data / "mini-objects" / f"{name}.png") - background) / np.float32(255)
    model = read_gs_sdk(data / "peer-calibrations" / "gs_sdk-mini-c-nnmodel.pth", background)
    np.testing.assert_allclose(slopes_of(model, change, background), -reference, atol=2e-5)


@pytest.mark.parametrize("position", ["zeros", "true"])
def test_real_gsrobotics_answers_as_published(data, position):
    normals = np.load(data / "peer-calibrations" / "reference_outputs.npz")[
        f"gsrobotics_key_normals_xy_{position}"
    ].astype(float)
    background = read_rgb(data / "mini-objects" / "background.png")
    image = read_rgb(data / "mini-objects" / "key.png")
    model = read_gsrobotics(
        data / "peer-calibrations" / "gsrobotics-nnmini.pt", background, position=position
    )
    black = np.zeros_like(background)
    prepared = model.prepare(black, black.shape[:2])
    found = prepared.gradients_from_color(image / np.float32(255))[0] + prepared._rest.reshape(
        (*image.shape[:2], 2)
    )
    theirs = -normals / np.sqrt(1 - np.sum(normals**2, axis=-1, keepdims=True))
    np.testing.assert_allclose(found, theirs, atol=1e-4, rtol=1e-4)
