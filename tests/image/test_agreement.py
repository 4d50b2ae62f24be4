"""Sixteen readings of an image: the right one is named, and none where nothing tells them apart.

Backgrounds that do not belong to an image, to a set of frames or to the sensor are refused with the figure.
"""

import re
from contextlib import suppress
from itertools import product

import numpy as np
import pytest

import gelform
from gelform.errors import CalibrationError
from gelform.image.agreement import (
    READINGS,
    UNLIKE,
    UPRIGHT,
    USUAL_ORDERS,
    background_digest,
    check_background_of_frames,
    check_own_background,
    check_viewed_image,
    compared,
    orientation_from_image,
    touch_in,
    touch_in_first,
)
from gelform.image.light import block_means, gain_from_blocks
from gelform.image.view import View, image_from_frame
from gelform.sensors.files import read_image
from made.images import TOUCHED_SHAPE, halved, scene, touched

SETS = ("mini-ball", "digit-ball", "gelslim", "mini-d", "gelslim-dots", "gelsight-ball-deep")


def check_background(image, background):
    """The findings of an image compared with a background."""
    return compared(block_means(image), block_means(background))[1]


def lying(image, reading):
    """An image as it is before the reading undoes it."""
    spoilt = image[..., ["RGB".index(one) for one in reading.order]]
    spoilt = spoilt[:: -1 if "y" in reading.flip else 1, :: -1 if "x" in reading.flip else 1]
    return np.ascontiguousarray(spoilt.transpose(1, 0, 2) if reading.transposed else spoilt)


@pytest.mark.parametrize("reading", READINGS)
def test_a_reading_is_told_by_its_light_and_its_words_and_remedy_undo_it(press, simulated, reading):
    assert orientation_from_image(lying(press.image, reading), simulated.background) == reading
    image = np.arange(24).reshape(2, 4, 3)
    spoilt = lying(image, reading)
    np.testing.assert_array_equal(reading.undone(spoilt), image)
    named = dict(re.findall(r'(flip|turn) "(\w+)"', reading.remedy))
    viewed = image_from_frame(spoilt.astype(np.uint8), View(**named))
    stored = (
        "BGR"
        if "--bgr" in reading.remedy
        else (re.findall("stored as ([RGB]{3})", reading.remedy) or ["RGB"])[0]
    )
    np.testing.assert_array_equal(viewed[..., [stored.index(one) for one in "RGB"]], image)
    assert (reading.order in reading.named) == (reading.order != "RGB")
    if reading.transposed and reading.flip in ("x", "y"):
        turns = -1 if "counter" not in reading.named else 1
        np.testing.assert_array_equal(np.rot90(image, turns), lying(image, reading._replace(order="RGB")))


def test_a_negative_is_no_reading(press, simulated):
    """Nor is it where the best wrong reading explains it better than a touch would."""
    noise = np.random.default_rng(0).normal(0, 2, press.image.shape)
    rest = np.clip(128 + 1.5 * (simulated.background - 128.0), 2, 253)
    for image in (press.image, rest + noise):
        assert orientation_from_image(np.clip(255.0 - image, 0, 255), simulated.background) is None


@pytest.fixture(params=[1.0, 0.9, 1.08, (0.95, 1.05)], ids=str)
def light(request, press):
    """Another exposure, or a lamp that has moved: factors of the columns."""
    return np.linspace(*np.broadcast_to(request.param, 2), press.image.shape[1])[:, None]


def test_another_exposure_and_a_tilted_lamp_are_no_orientation(press, simulated, light):
    assert orientation_from_image(np.clip(press.image * light, 0, 255), simulated.background) == UPRIGHT


def test_a_light_alike_from_all_sides_another_size_and_another_sensor_name_nothing(simulated):
    gray, ours = np.full((60, 80, 3), 120.0), simulated.background
    y, x = np.mgrid[: ours.shape[0], : ours.shape[1]]
    theirs = 120 + 60 * np.stack([np.sin(x / 30), np.cos(y / 25), np.sin((x + y) / 35)], axis=-1)
    noise = np.random.default_rng(1).uniform(40, 200, theirs.shape)
    for other, rest in ((gray[:, ::-1], gray), (gray[:50], gray), (theirs, ours), (noise, ours)):
        assert orientation_from_image(other, rest) is None


@pytest.mark.slow
@pytest.mark.parametrize("name", SETS)
def test_every_reading_of_real_presses_is_named(data, name):
    presses = gelform.read_presses(data / name)
    blocks, some, named = block_means(presses.background), presses.presses[::24], 0
    for press in some:
        negative = orientation_from_image(255 - press.image, presses.background)
        assert negative is None
        for reading in READINGS:
            image = lying(press.image, reading)
            told = orientation_from_image(image, presses.background)
            assert told in ((reading,) if reading.order in USUAL_ORDERS else (reading, None))
            named += told is not None
            if not reading.transposed and reading.order in USUAL_ORDERS:
                unlike = gain_from_blocks(block_means(image), blocks).least_change > UNLIKE
                assert unlike == (reading != UPRIGHT), "the cheap question first loses nothing"
    assert named > 0.6 * len(some) * len(READINGS)


def test_a_touch_is_found_at_its_place_under_any_light(press, simulated, light):
    found = touch_in(np.clip(press.image * light, 0, 255), simulated.background)
    off = np.subtract((found.x_px, found.y_px), press.center_px)
    assert np.hypot(*off) < press.contact_radius_px
    assert touch_in(np.clip(simulated.background * light, 0, 255), simulated.background) is None


def test_the_touched_one_of_two_images_is_told(press, simulated):
    untouched, touched = simulated.background, press.image.astype(np.float32)
    assert touch_in(untouched, touched) is not None
    assert touch_in_first(untouched, touched) is None
    assert touch_in_first(touched, untouched) is not None


def test_a_pressed_background_is_found_with_its_place(press, simulated):
    found = {one.name: one for one in check_own_background(press.image, simulated.background)}
    assert re.search(r"about \(\d+, \d+\) px", found["background_touched"].message)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["mini-ball", "mini-d", "digit-ball", "gelslim", "gelsight-ball-deep"])
def test_half_of_a_real_press_is_found_in_a_background(data, name):
    presses = gelform.read_presses(data / name)
    noise = np.random.default_rng(0).normal(0, 1, (2, *presses.background.shape))
    calibrated = presses.background + noise[0]
    for press in presses.presses[::5]:
        today = (presses.background + press.image) / 2 + noise[1]
        assert touch_in(today, calibrated) is not None, press.name
    assert touch_in(presses.background + noise[1], calibrated) is None


def test_own_background_gives_no_finding_with_a_third_of_the_frame_touched():
    image = scene(1)
    image[:, :27] += np.array([45, -35, 25], dtype=np.float32)
    for one in (touched(scene(1)), np.clip(image, 0, 255)):
        assert check_background(one, scene()) == ()


@pytest.mark.parametrize(
    ("gain", "name", "said"),
    [
        (0.86, "background_ratio", "Take a new background"),
        (1.15, "background_ratio", "Take a new background"),
        ((1.06, 1.06, 1.06), "exposure", "R +6 %, G +6 %"),
        ((1.0, 0.95, 1.0), "exposure", "R +0 %, G -5 %"),
    ],
)
def test_another_exposure_is_a_finding_with_its_figure(gain, name, said):
    (finding,) = check_background(np.clip(touched(scene(1)) * gain, 0, 255), scene())
    assert finding.name == name
    assert finding.figure == pytest.approx(
        np.broadcast_to(gain, 3)[1], abs=0.03 if name != "exposure" else 0.005
    )
    assert said in finding.message


def test_a_channel_too_dark_to_compare_is_said():
    """Its ratios would be those of noise."""
    rest = scene() * np.array([1, 1, 0.02])
    (finding,) = check_background(rest.astype(np.float32), rest.astype(np.float32))
    assert (finding.name, finding.figure) == ("exposure_unknown", 0)


@pytest.mark.parametrize("gain", [0.6, 1.5])
def test_other_exposure_is_refused_with_its_figure_and_blames_the_right_one(gain):
    """A new background would be refused again, for ever, where the calibration is of another light."""
    with pytest.raises(CalibrationError, match=rf"R {gain:.1f}\d, G [\d.]+, B [\d.]+ times as bright"):
        check_background(np.clip(touched(scene(1)) * gain, 0, 255), scene())
    with pytest.raises(
        CalibrationError, match=rf"R {gain:.1f}\d, .* as bright as in the calibration's"
    ) as one:
        check_own_background(np.clip(scene(1) * gain, 0, 255).astype(np.float32), scene())
    assert str(one.value).startswith("The calibration is not of the sensor that took this background")
    assert "Take a new background" not in str(one.value)


def test_another_scene_is_refused_and_not_as_bgr_if_it_fits_a_little_better_reversed():
    y, x = np.mgrid[: TOUCHED_SHAPE[0], : TOUCHED_SHAPE[1]]
    ours = np.stack([np.sin(0.4 * x), np.sin(0.3 * y), np.sin(0.5 * (x + y))], axis=-1)
    other = np.stack([np.sin(0.35 * (x - y)), np.cos(0.45 * x), np.sin(0.55 * y)], axis=-1)
    for theirs in (other, 0.6 * ours[..., ::-1] + 0.8 * other):
        with pytest.raises(CalibrationError, match=r"correlate by -?0\.\d"):
            check_background(100 + 20 * theirs, 100 + 20 * ours)


def test_reversed_channels_are_named_unless_they_fit_about_as_well_as_they_are():
    """Channels nearly alike: on untouched blocks they correlate by 0.963 as they are, by 0.960 reversed."""
    with pytest.raises(CalibrationError, match="is BGR compared with the background"):
        check_background(touched(scene(1))[..., ::-1], scene())
    y, x = np.mgrid[: TOUCHED_SHAPE[0], : TOUCHED_SHAPE[1]]
    gray = 100 + 20 * np.sin(0.2 * x + 0.1 * y)[..., None]
    ours = gray + 2 * np.stack([np.sin(0.3 * x), np.cos(0.25 * y), 0 * x], axis=-1)
    theirs = ours + 10 * np.cos(0.31 * x - 0.27 * y)[..., None]
    check_background(theirs.astype(np.float32), ours.astype(np.float32))


@pytest.mark.parametrize("at_rest", [0.6, 0.1])
def test_an_exposure_that_few_pixels_tell_is_compensated(at_rest):
    rest = scene()
    change = np.random.default_rng(2).uniform(-0.3, 0.3, rest.shape)
    change[:, : round(at_rest * TOUCHED_SHAPE[1])] = 0
    findings = {one.name: one for one in check_background(rest * 1.05 * (1 + change), rest)}
    assert findings["exposure"].figure == pytest.approx(1.05, abs=0.006)


def tilted(background, amount):
    """The light of another unit: a slope of brightness, another one for each channel."""
    x = np.linspace(-1, 1, TOUCHED_SHAPE[1])[None, :, None] * np.array([1, -0.5, 0.3])
    return (background * (1 + amount * x)).astype(np.float32)


def test_own_background_of_another_moment_or_another_unit_is_found():
    assert check_own_background(scene(1), scene()) == ()
    (finding,) = check_own_background(tilted(scene(1), 0.07), scene())
    assert finding.name == "background_pattern"
    assert 0.02 < finding.figure < 0.06
    (finding,) = check_own_background(tilted(scene(1), 0.3), scene())
    assert "or it is another unit" in finding.message
    assert finding.figure > 0.06


def presses_of(background, count):
    rng, images = np.random.default_rng(5), []
    for row, column in rng.integers(0, [TOUCHED_SHAPE[0] - 20, TOUCHED_SHAPE[1] - 20], (count, 2)):
        image = background.copy()
        image[row : row + 20, column : column + 20] += np.array([40, -30, 20], dtype=np.float32)
        images.append(np.clip(image, 0, 255))
    return images


def test_the_background_of_other_frames_is_refused_and_one_that_drifted_is_said():
    """The light of `scene` tilts by 7 % over the image: depth far from contacts would be of it."""
    assert check_background_of_frames(presses_of(scene(1), 10), scene()) == ()
    with pytest.raises(
        CalibrationError, match=r"not of these images\. .* a quarter of their median differs by"
    ):
        check_background_of_frames(presses_of(tilted(scene(1), 0.3), 10), scene())
    check_background_of_frames(presses_of(tilted(scene(1), 0.3), 7), scene())  # too few to judge
    (finding,) = check_background_of_frames(presses_of(tilted(scene(1), 0.07), 10), scene())
    assert finding.name == "background_drift"
    assert 0.02 < finding.figure < 0.06
    assert f"{100 * finding.figure:.1f} %" in finding.message


def test_a_frame_in_an_images_place_is_told_the_way():
    image = np.zeros((4, 6, 3), dtype=np.uint8)
    rest = image.astype(np.float32)
    assert check_viewed_image(rest, (8, 12), image) is image
    with pytest.raises(ValueError, match=r"Expected background of 4x6.*image_from_frame"):
        check_viewed_image(rest, (8, 12), np.zeros((8, 12, 3), dtype=np.uint8), "background")
    with pytest.raises(ValueError, match="got 9x12") as other:
        check_viewed_image(rest, (8, 12), np.zeros((9, 12, 3), dtype=np.uint8))
    assert "image_from_frame" not in str(other.value)


def test_the_digest_is_of_the_values_and_the_shape():
    rest, other = scene(), scene()
    other[3, 4, 1] += 1
    assert background_digest(rest.astype(np.uint8)) == background_digest(np.floor(rest))
    assert len({background_digest(one) for one in (rest, scene(), other, rest.transpose(1, 0, 2))}) == 3


def test_reconstructor_says_whose_background(calibration, simulated):
    assert repr(gelform.Reconstructor(calibration)).endswith(", 132x176 px, the calibration's background)")
    assert gelform.Reconstructor(calibration).own_background
    assert gelform.Reconstructor(calibration, simulated.background).own_background
    today = np.clip(simulated.background.astype(np.float32) * 0.95, 0, 255)
    other = gelform.Reconstructor(calibration, today)
    assert not other.own_background
    assert [finding.name for finding in other.findings] == ["exposure"]
    assert calibration.describe()["background_digest"] == background_digest(simulated.background)


BACKGROUNDS = {
    "mini A": "mini-ball/background.png",
    "mini C": "mini-objects/background.png",
    "mini d": "mini-d/background.png",
    "mini edge": "mini-edge/background.png",
    "digit": "digit-ball/background.png",
    "bright": "gelsight-ball-deep/background.png",
}


def lying_check(image):
    return image if image.shape[0] < image.shape[1] else np.ascontiguousarray(np.rot90(image))


def test_real_backgrounds_of_other_sensors_are_refused_and_of_other_units_found(data):
    """All pairs of six sensors, four of them of one model; a later moment of the same one passes, warned of."""
    rests = {name: lying_check(read_image(data / path)) for name, path in BACKGROUNDS.items()}
    for (ours, background), (theirs, other) in product(rests.items(), repeat=2):
        if ours == theirs:
            assert check_own_background(other, background) == ()
            continue
        found = {"refused"}
        with suppress(CalibrationError):
            found = {one.name for one in check_own_background(other, background)}
        # Of one unit, a channel is beyond the gains that an exposure has.
        assert found & ({"refused", "background_pattern"} if ours[:4] == theirs[:4] else {"refused"})
        assert ours[:4] == theirs[:4] or found == {"refused"}
    later = lying_check(read_image(data / "digit-ball/background_other_moment.png"))
    assert "background_pattern" in [one.name for one in check_own_background(later, rests["digit"])]


@pytest.mark.parametrize("ours", ["mini A", "mini C", "digit", "bright"])
def test_real_frames_of_another_sensor_are_refused_or_warned_of(data, ours):
    """Another model is refused; another unit of the same model is warned of. Own frames are neither."""
    frames = {
        "mini A": sorted((data / "mini-ball").rglob("gelsight.png"))[::20],
        "mini C": [data / "mini-objects" / f"{name}.png" for name in ("bead", "key", "seed")],
        "digit": sorted((data / "digit-ball" / "images").iterdir())[::14],
    }
    background = lying_check(read_image(data / BACKGROUNDS[ours]))
    for theirs, paths in frames.items():
        for path in paths:
            frame = lying_check(read_image(path))
            if theirs[:4] != ours[:4]:
                with pytest.raises(CalibrationError, match=r"not of this image|compared with the background"):
                    check_background(frame, background)
                continue
            warned = "background_differs" in [finding.name for finding in check_background(frame, background)]
            assert warned == (theirs != ours), path


def test_real_presses_know_their_background(data):
    images = [read_image(path) for path in sorted((data / "mini-ball").rglob("gelsight.png"))[::4]]
    assert check_background_of_frames(images, read_image(data / "mini-ball" / "background.png")) == ()
    with pytest.raises(CalibrationError, match="not of these images"):
        check_background_of_frames(images, read_image(data / "mini-objects" / "background.png"))


@pytest.mark.slow
def test_another_exposure_gives_the_same_depth_of_real_presses(data):
    """Rounded again, on a GelSight Mini, within 4 um; without compensation it is 120 um."""
    presses = halved(gelform.read_presses(data / "mini-ball"))
    calibration = gelform.calibrate(presses.subset(range(0, 67, 11)), color_model="polynomial")
    reconstruct = gelform.Reconstructor(calibration)
    for press in presses.presses[1::20]:
        brighter = np.clip(np.rint(press.image * 1.08), 0, 255).astype(np.uint8)
        plain, other = reconstruct(press.image), reconstruct(brighter)
        assert np.sqrt(np.mean((plain.depth_mm - other.depth_mm) ** 2)) < 0.004


def test_slopes_are_less_sure_where_too_few_pixels_tell_the_exposure(calibration, simulated):
    """Light that changes everywhere: 1 % of exposure is not known, and each slope may be wrong by what it does."""
    press = simulated.presses[0].image
    y, x = (np.linspace(-1, 1, n) for n in press.shape[:2])
    waves = np.sin(
        5 * x[None, :, None] * np.array([1, -0.7, 0.8]) + 6 * y[:, None, None] * np.array([-0.6, 1, -0.9])
    )
    uneven = np.clip(np.rint(press * (1 + 0.2 * waves)), 0, 255).astype(np.uint8)
    reconstruct = gelform.Reconstructor(calibration)
    plain, unsure = (reconstruct(image) for image in (press, uneven))
    expected = 0.01 * calibration.forward.slope_per_change
    assert plain.gradients_sigma.min() < expected < unsure.gradients_sigma.min()
    found = next(one for one in unsure.health if one.name == "exposure_unknown")
    assert re.search(r"cannot tell the exposure well: its standard deviation is \d", found.message)
    assert "at rest" not in found.message, "a share of the image would contradict other findings"
    assert "exposure_unknown" not in [one.name for one in plain.health]
