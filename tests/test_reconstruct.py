"""The Reconstructor: a pure function of the image, zero at rest, two doors, and honest about its input."""

import gc
import pickle
import shutil
import subprocess
import sys
import time
import tracemalloc
import weakref
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import replace
from multiprocessing import get_context

import cv2
import numpy as np
import pytest

import gelform
from gelform.depth.coarse import RestAnchor
from gelform.depth.sigma import DepthSigma
from gelform.image.view import Frame, View
from gelform.reconstruct import ON_FIRST_USE, FromCalibration
from gelform.result.maps import MAPS
from gelform.simulate import Ball, Punch, simulate_press
from made import small_gel
from made.images import grid, image_of_dots

FLIP_TOML = 'name = "turned"\nmm_per_px = {:.6f}\n[view]\nflip = "x"\n'


# What a result computes on first use; the errors of its shape come with the deviation of depth.
ON_DEMAND = [name for name in ON_FIRST_USE if name != "shape_errors"]


def assert_same(one, expected):
    """Two results of the same bytes."""
    for row in MAPS.values():
        np.testing.assert_array_equal(getattr(one, row.name), getattr(expected, row.name), row.name)
    assert (one.health, one.contacts, one.solver) == (expected.health, expected.contacts, expected.solver)
    assert (one.calibration_digest, one.mm_per_px) == (expected.calibration_digest, expected.mm_per_px)
    if expected.markers is not None:
        np.testing.assert_array_equal(one.markers.now_px, expected.markers.now_px)


def test_what_is_not_asked_for_is_not_computed(calibration, press, monkeypatch):
    """And what is asked for twice, by a copy or by another thread, is computed once."""
    made = []
    usual = DepthSigma.__call__
    monkeypatch.setattr(DepthSigma, "__call__", lambda self, *a: made.append(1) or usual(self, *a))
    result = gelform.Reconstructor(calibration).from_image(press.image)
    assert result.depth_mm.max() > 0.1
    assert not made
    copy = result.changed(index=7)
    with ThreadPoolExecutor(4) as pool:
        asked = list(pool.map(lambda k: (copy, result)[k % 2].depth_sigma_mm, range(16)))
    assert len(made) == 1
    assert all(one is asked[0] for one in asked)
    assert (copy.index, result.index) == (7, None)
    assert copy.contact is result.contact
    assert len(made) == 1


@pytest.mark.parametrize("asked", [ON_DEMAND, ON_DEMAND[::-1]], ids=["forward", "backward"])
def test_the_frame_goes_with_the_last_that_follows_from_it(asked):
    """A kept result keeps its maps; the image and the slopes are gone, differences have a sigma still."""
    reconstruct = gelform.Reconstructor(small_gel.calibration())  # of a model that gives the albedo
    image = small_gel.image_of(small_gel.Touch())
    wanted, wanted_record = reconstruct.from_image(image), reconstruct.record(image)
    maps = {name: getattr(wanted, name) for name in ON_DEMAND}
    record = reconstruct.record(image)
    result, gone = reconstruct.result(record), [weakref.ref(one) for one in (record, record.seen.raw)]
    copy = result.changed(index=7)
    del record
    for name in asked:
        assert all(one() is not None for one in gone), name
        np.testing.assert_array_equal(getattr(result, name), maps[name], err_msg=name)
    gc.collect()
    assert all(one() is None for one in gone)
    for one in (result, copy):
        sigma = wanted_record.shape_errors.difference_sigma(wanted.contact)
        np.testing.assert_array_equal(one.depth_difference_sigma(), sigma)
        np.testing.assert_array_equal(one.albedo, wanted.albedo)
        assert_same(one, wanted)


def test_a_kept_result_holds_what_its_pickle_does():
    """And the errors of depth on their coarse grid: less than one more map."""
    reconstruct = gelform.Reconstructor(small_gel.calibration())
    image, results = small_gel.image_of(small_gel.Touch()), []

    def one_more():
        results.append(result := reconstruct.from_image(image))
        assert all(getattr(result, name) is not None for name in (*ON_DEMAND, "albedo"))
        result.depth_difference_sigma()

    one_more()  # what is prepared once
    gc.collect()
    tracemalloc.start()
    for _ in range(4):
        one_more()
    gc.collect()
    held = tracemalloc.get_traced_memory()[0] / 4
    tracemalloc.stop()
    one_map = results[-1].albedo.nbytes
    assert held < len(pickle.dumps(results[-1])) + one_map + one_map


def test_the_order_of_questions_and_what_the_caller_writes_change_nothing(calibration, press):
    """A result's other maps follow from the frame, not from arrays that its caller may write to."""
    reconstruct, image = gelform.Reconstructor(calibration), press.image.copy()
    forward, backward = (reconstruct.from_image(image) for _ in range(2))
    wanted = {name: getattr(forward, name) for name in ON_DEMAND}
    image[:] = 0
    backward.depth_mm[:] = 9
    for name in reversed(ON_DEMAND):
        np.testing.assert_array_equal(getattr(backward, name), wanted[name], err_msg=name)
    with pytest.raises(ValueError, match="read-only"):
        backward.observed_gradients[:] = 0


def test_a_first_frame_loads_no_part_of_scipy(calibration, press, tmp_path):
    """Importing scipy.spatial or scipy.special would take longer than all else of it."""
    calibration.save(tmp_path / "cal.npz")
    np.save(tmp_path / "image.npy", press.image)
    code = (
        "import sys, gelform, numpy; gelform.Reconstructor(sys.argv[1]).from_image(numpy.load(sys.argv[2])).contacts;"
        "print(*(name for name in sys.modules if name.startswith('scipy.') and name.count('.') == 1 and name[6] != '_'))"
    )
    command = [sys.executable, "-c", code, tmp_path / "cal.npz", tmp_path / "image.npy"]
    said = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    assert set(said.split()) <= {"scipy.version"}


@pytest.mark.parametrize("spoilt", [None, "clipped", "torn", "dotted"])
def test_floats_of_whole_levels_are_those_levels(calibration, press, spoilt):
    image = press.image.copy()
    if spoilt == "torn":
        image[200:] = 255
    elif spoilt == "clipped":
        image[60:80, 60:80] = 255
    elif spoilt == "dotted":
        shape = image.shape[:2]
        dots = image_of_dots(grid(24.0, shape), shape=shape) / image_of_dots([], shape=shape)
        image = (image * dots).astype(np.uint8)
        calibration = replace(calibration, background=(calibration.background * dots).astype(np.float32))
    reconstruct = gelform.Reconstructor(calibration)
    assert bool(len(reconstruct.markers)) == (spoilt == "dotted")
    whole = reconstruct.from_image(image)
    for dtype in (np.float32, np.float64):
        result = reconstruct.from_image(image.astype(dtype))
        np.testing.assert_array_equal(result.depth_mm, whole.depth_mm)
        np.testing.assert_array_equal(result.depth_sigma_mm, whole.depth_sigma_mm)
        assert result.health == whole.health
    resized = replace(calibration, view=View(frame_shape=(300, 400), image_shape=image.shape[:2]))
    frame = cv2.resize(image, (400, 300))
    whole, result = (gelform.Reconstructor(resized)(one) for one in (frame, frame.astype(np.float32)))
    np.testing.assert_array_equal(result.depth_mm, whole.depth_mm)


def test_it_is_a_pure_function_of_the_image_that_threads_share(calibration, simulated):
    """Which it does not write to."""
    reconstruct = gelform.Reconstructor(calibration)
    images = [p.image for p in simulated.presses[:6]]
    alone, kept = [reconstruct(image) for image in images], [image.copy() for image in images]
    with ThreadPoolExecutor(10) as pool:
        for i, found in enumerate(pool.map(reconstruct, images * 5)):
            assert_same(found, alone[i % len(images)])
    np.testing.assert_array_equal(images, kept)


def test_slopes_are_those_of_the_depth_and_better_than_those_read(calibration, sensor):
    """A surface cannot follow errors that have curl. At the rim, where the slope jumps, differences of depth blur it."""
    read, solved = [], []
    for seed, center in enumerate([(1.0, -0.5), (-2.0, 1.0), (2.5, 1.5)]):
        rng = np.random.default_rng(seed)
        made = simulate_press(sensor, Ball(3.0), depth_mm=0.6, center_mm=center, rng=rng)
        result = gelform.Reconstructor(calibration)(made.image)
        of_depth = gelform.gradients_from_depth(result.depth_mm, mm_per_px=result.mm_per_px)
        np.testing.assert_allclose(result.gradients, of_depth, atol=2e-4)
        y, x = np.mgrid[: sensor.shape[0], : sensor.shape[1]]
        inside = np.hypot(x - made.center_px[0], y - made.center_px[1]) < 0.85 * made.contact_radius_px
        read.append(np.square(result.observed_gradients - made.gradients)[inside].mean())
        solved.append(np.square(result.gradients - made.gradients)[inside].mean())
    assert np.mean(solved) < 0.95 * np.mean(read)
    assert result.curl_rms > 0


def test_a_step_takes_the_depth_of_what_is_not_hidden(calibration, press):
    """Slopes of hidden pixels would be in the depth of the whole frame, and that in all steps."""
    fixed, read = (
        FromCalibration(calibration),
        gelform.Reconstructor(calibration)(press.image).gradients,
    )
    change, hidden = calibration.color_from_gradients(read), np.zeros(read.shape[:2], dtype=bool)
    hidden[40:60, 50:80] = True
    garbled = np.where(hidden[..., None], np.float32(3), read)
    plain, guarded, open_ = (
        fixed.stepped(change, slopes, where, None)[0]
        for slopes, where in ((read, hidden), (garbled, hidden), (garbled, None))
    )
    np.testing.assert_array_equal(guarded[~hidden], plain[~hidden])
    assert np.abs(open_ - plain)[~hidden].max() > 0.01
    flat = fixed.step(change, read, np.zeros(hidden.shape, np.float32), None).gradients
    assert np.abs(fixed.stepped(change, read, None, None)[0] - flat).max() > 0.01
    unstepped = replace(calibration, forward=replace(calibration.forward, step_sigma=None))
    assert FromCalibration(unstepped).stepped(change, read, None, None) == (read, None, None, None)


def test_new_background_takes_a_larger_drift(calibration, press, simulated):
    today = np.clip(simulated.background * 1.08, 0, 255)
    image = np.clip(press.image * 1.08, 0, 255)
    result = gelform.Reconstructor(calibration, background=today)(image)
    plain = gelform.Reconstructor(calibration)(press.image)
    assert np.sqrt(np.mean((result.depth_mm - plain.depth_mm) ** 2)) < 0.01
    (finding,) = gelform.Reconstructor(calibration)(np.clip(press.image * 0.85, 0, 255)).health
    assert (finding.name, finding.figure) == ("background_ratio", pytest.approx(0.85, abs=0.02))


def test_frame_times_pass_through(calibration, press):
    frame = Frame(press.image, time_s=time.monotonic(), wall_time_ns=time.time_ns(), index=7)
    result = gelform.Reconstructor(calibration)(frame)
    assert (result.index, result.time_s, result.wall_time_ns) == (7, frame.time_s, frame.wall_time_ns)
    assert result.calibration_digest == calibration.digest
    unscaled = gelform.Reconstructor(replace(calibration, mm_per_px=None))(frame)
    assert unscaled.index == 7


@pytest.mark.parametrize(
    ("spoil", "error", "message"),
    [
        (lambda image: image[..., 0], ValueError, "gray image"),
        (lambda image: image[:-2], ValueError, "132x176"),
        (lambda image: image / 255, ValueError, "0-1 range"),
        (lambda image: image.astype(float) * 2, ValueError, "within 0-255"),
        (lambda image: np.where(image > 90, np.nan, image), ValueError, "within 0-255"),
        (lambda image: np.moveaxis(image, -1, 0), ValueError, "axis of the channels last"),
        (lambda image: np.dstack([image, image[..., 0]]), ValueError, "alpha"),
        (lambda image: image.astype(np.uint16), TypeError, "uint16"),
        (lambda image: image[..., ::-1], gelform.CalibrationError, "is BGR compared"),
        (lambda image: np.repeat(image[..., :1], 3, axis=2), gelform.CalibrationError, "The image is gray"),
        (lambda image: image[:, ::-1], gelform.CalibrationError, "is mirrored left to right compared"),
        (lambda image: np.rot90(image, -1), gelform.CalibrationError, "turned by 90 degrees clockwise"),
    ],
)
def test_bad_images_are_refused(calibration, press, spoil, error, message):
    with pytest.raises(error, match=message):
        gelform.Reconstructor(calibration)(spoil(press.image))


def test_the_flat_face_of_a_punch_keeps_its_depth(calibration, sensor):
    """Its color is that of rest: an anchor that goes by color alone would pull it to 0."""
    where = {"depth_mm": 0.3, "center_mm": (-1.0, 0.5)}
    punch = simulate_press(sensor, Punch(4.0), **where, rng=np.random.default_rng(6))
    reconstruct = gelform.Reconstructor(calibration)
    depth, slopes = reconstruct(punch.image).depth_mm, reconstruct.record(punch.image).slopes
    plain = gelform.depth_from_gradients(
        slopes.gradients, mm_per_px=calibration.mm_per_px, zero=slopes.at_rest, solver="dct"
    )
    face = punch.depth_mm > 0.295
    assert face.sum() > 300
    assert depth[face].mean() == pytest.approx(plain[face].mean(), abs=0.015)
    far = punch.depth_mm < 1e-3
    assert np.sqrt(np.mean(depth[far] ** 2)) < np.sqrt(np.mean(plain[far] ** 2))


def test_what_all_slopes_share_moves_depth_in_proportion(calibration, press):
    alike = replace(calibration, slope_sigma=replace(calibration.slope_sigma, gain_sigma=0.5))
    alone = replace(calibration, slope_sigma=replace(calibration.slope_sigma, gain_sigma=0.0))
    one, other = (gelform.Reconstructor(c)(press.image) for c in (alike, alone))
    expected = np.hypot(other.depth_sigma_mm, 0.5 * other.depth_mm)
    deep = other.depth_mm > 0.2  # by a coarse integral
    np.testing.assert_allclose(one.depth_sigma_mm[deep], expected[deep], rtol=0.16)
    np.testing.assert_array_equal(one.contact, other.contact)


@pytest.fixture(scope="module")
def mounted(folder, tmp_path_factory):
    """Eight presses as mounted, and the same seen in a mirror by a camera whose view turns them back."""
    few = gelform.read_presses(folder)
    few = few.subset(range(8))
    mirror = tmp_path_factory.mktemp("mirror") / "folder"
    shutil.copytree(folder, mirror)
    for path in mirror.rglob("*.png"):
        cv2.imwrite(str(path), cv2.imread(str(path))[:, ::-1])
    (mirror / "sensor.toml").write_text(FLIP_TOML.format(few.mm_per_px))
    return few, gelform.read_presses(mirror).subset(range(8))


@pytest.mark.slow
def test_turned_frames_calibrate_as_mounted_ones_do(mounted):
    """One size for frames and images: whoever guesses from the shape turns the presses once more."""
    calibrations = [gelform.calibrate(one, color_model="polynomial") for one in mounted]
    straight, turned = calibrations
    np.testing.assert_array_equal(mounted[0].presses[0].image, mounted[1].presses[0].image)
    assert turned.view == View(flip="x")
    assert turned.held_out == straight.held_out
    np.testing.assert_array_equal(turned.color_model.coefficients, straight.color_model.coefficients)
    one, other = (gelform.evaluate(c, p).summary for c, p in zip(calibrations, mounted))
    assert one == other


def test_a_frame_is_always_turned_and_an_image_never(calibration, press):
    reconstruct = gelform.Reconstructor(replace(calibration, view=View(flip="x")))
    expected = gelform.Reconstructor(calibration)(press.image).depth_mm
    np.testing.assert_array_equal(reconstruct(press.image[:, ::-1]).depth_mm, expected)
    np.testing.assert_array_equal(reconstruct.from_image(press.image).depth_mm, expected)
    with pytest.raises(gelform.CalibrationError, match="is mirrored left to right"):
        reconstruct(press.image)


def test_each_door_names_the_other(calibration, simulated):
    """A view that halves the frame: an image passes the door of frames, and a frame is sent there."""
    height, width = calibration.image_shape
    halved = View((2 * height, 2 * width), image_shape=(height, width))
    reconstruct = gelform.Reconstructor(replace(calibration, view=halved))
    image = simulated.presses[0].image
    frame = cv2.resize(image, (2 * width, 2 * height), interpolation=cv2.INTER_NEAREST)
    for given in (frame, image):
        np.testing.assert_array_equal(reconstruct(given).depth_mm, reconstruct.from_image(image).depth_mm)
    with pytest.raises(ValueError, match=r"image of 132x176 px .*, got 264x352.*frame.*image_from_frame"):
        reconstruct.from_image(frame)
    with pytest.raises(ValueError, match=r"background of 132x176 px .*, got 264x352.*image_from_frame"):
        gelform.Reconstructor(replace(calibration, view=halved), background=frame)


def test_a_path_is_a_calibration(calibration, simulated, tmp_path):
    calibration.save(tmp_path / "cal.npz")
    image = simulated.presses[0].image
    known, *others = (
        gelform.Reconstructor(one)(image).depth_mm
        for one in (calibration, tmp_path / "cal.npz", str(tmp_path / "cal.npz"))
    )
    for again in others:
        np.testing.assert_array_equal(again, known)
    for given, error, said in (
        ((tmp_path / "nothing.npz",), gelform.CalibrationError, r"No file .*nothing\.npz"),
        (({},), TypeError, "Expected a Calibration or the path of one, got dict"),
    ):
        with pytest.raises(error, match=said):
            gelform.Reconstructor(*given)


def test_a_frame_has_the_usual_solver_and_no_other(calibration, press):
    """Its sigma is that of weighted slopes with an anchor."""
    made = gelform.Reconstructor(calibration)
    record = made.record(press.image)
    slopes, sigma = record.slopes, calibration.slope_sigma.full_confidence_sigma
    rest = RestAnchor(slopes.at_rest.shape, calibration.mm_per_px, sigma)
    how = {"weights": slopes.weights(sigma), "anchor": rest(slopes.gradients, slopes.at_rest)}
    expected = gelform.integrate(slopes.gradients, mm_per_px=calibration.mm_per_px, **how)
    result = made(press.image)
    assert result.solver == expected.solver == "multigrid"
    np.testing.assert_array_equal(result.depth_mm, expected.depth_mm)
    with pytest.raises(TypeError, match="solver"):
        gelform.Reconstructor(calibration, solver="dct")


def test_another_state_of_the_same_gel(calibration, simulated):
    """As if it had been given from the start, down to health, causes and noise; and the first one is not touched."""
    image, before = simulated.presses[0].image, gelform.Reconstructor(calibration)
    image = image.astype(np.float32)
    image[50:65, 30:] += np.random.default_rng(0).normal(0, 9, image[50:65, 30:].shape)
    other = np.clip(calibration.background * np.linspace(1.03, 0.9, 176)[:, None], 0, 255).astype(np.float32)
    other[:20, :30] = 0.5  # a corner where today's image says nothing
    changed, known = before.with_background(other), replace(calibration, background=other)
    given = gelform.Reconstructor(known, other)
    for frame in (np.clip(image, 0, 255), other):
        one, expected = changed.from_image(frame), given.from_image(frame)
        assert_same(replace(one, calibration_digest=known.digest), expected)
        why, wanted = changed.explain(frame), given.explain(frame)
        for name, added in wanted.maps.items():
            np.testing.assert_array_equal(why.maps[name], added, name)
    assert [finding.name for finding in one.health] == ["frozen"]
    assert before.background is calibration.background
    assert (before.own_background, changed.own_background) == (True, False)


def test_a_result_can_be_pickled(calibration, press):
    """As it is saved: without what works out the albedo when asked."""
    result = gelform.Reconstructor(calibration).from_image(press.image)
    again = pickle.loads(pickle.dumps(result))
    assert_same(again, result)
    np.testing.assert_array_equal(again.depth_difference_sigma(), result.depth_difference_sigma())


def _prepared(calibration, kind):
    today = np.clip(calibration.background * np.float32(1.03), 0, 255)
    if kind == "given background":
        return gelform.Reconstructor(calibration, today)
    made = gelform.Reconstructor(calibration)
    return made.with_background(today) if kind == "taken background" else made


@pytest.mark.parametrize("kind", ["own", "given background", "taken background"])
def test_a_reconstructor_can_be_pickled(calibration, press, kind):
    made = _prepared(calibration, kind)
    again = pickle.loads(pickle.dumps(made))
    assert_same(again.from_image(press.image), made.from_image(press.image))
    assert (again.own_background, again.findings) == (made.own_background, made.findings)
    assert len(pickle.dumps(again)) < 1.1 * len(pickle.dumps(made))


def test_a_pool_of_processes_takes_a_reconstructor(calibration, simulated):
    """Its bytes are those of this process, though each worker starts anew."""
    made, images = gelform.Reconstructor(calibration), [press.image for press in simulated.presses[:3]]
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as pool:
        for image, result in zip(images, pool.map(made, images)):
            assert_same(result, made(image))
