"""Each fault is found and named, with its share; sound frames have none."""

import cv2
import numpy as np
import pytest

import gelform
from gelform._native import Kernel
from gelform.image import health as health_module
from gelform.image.health import DepthLimit, FrameHealth, Levels, Torn
from kernel_agreement import assert_kernel_agrees
from made.images import WORN_SHAPE, blocks_of, constant, gel, pressed, with_part

# The steps of `health_of_frame` behind its blocks, each by itself.
SIGNS = Kernel(
    "health_signs",
    "u8[bh,bw,3] means, u8[bh,bw] ranges, i64[h] digests, u8[bh,bw,3] dark_to, u8[bh,bw,3] saturated_from, "
    "out i32[n] work, out i32[3] signs, i32 flat",
)
SEAM = Kernel(
    "health_seam",
    "u16[h,n] sums, u16[h,n] rest, out f32[m] work, out f32[h] totals, f32 least, f32 factor, f32 spill",
)
BANDS = Kernel(
    "health_bands",
    "u16[h,n,3] sums, f32[h,3] gray, f32[h,4] smooth, out f32[h,3] flat, out f32[1] common",
)


@pytest.fixture(scope="module")
def health():
    return FrameHealth(gel().astype(np.float32))


def names(faults):
    return [finding.name for finding in faults.findings]


def assert_torn(faults, lost, share=None):
    """Nothing else is found, all of that is lost, and as large a share as is said."""
    (torn,) = faults.findings
    assert torn.name == "torn"
    assert torn.message.startswith(f"{100 * torn.figure:.0f} % of the frame is torn")
    assert faults.lost[lost].all()
    assert share is None or torn.figure == pytest.approx(share, abs=0.01)


def test_a_sound_frame_and_a_small_bright_spot_have_no_faults(health):
    spot = with_part(pressed(), np.s_[20:30, 20:30], 255)
    for faults in map(health, (gel(7), pressed(), spot)):
        assert (names(faults), faults.lost) == ([], None)


@pytest.mark.parametrize(
    ("level", "name"), [(0, "dark"), (3, "dark"), (255, "saturated"), (128, "torn"), ((90, 135, 90), "torn")]
)
def test_a_frame_of_one_color_says_nothing(health, level, name):
    faults = health(constant(level))
    assert names(faults) == [name]
    assert faults.findings[0].figure == pytest.approx(1.0, abs=0.03)


def test_darkness_with_noise_and_one_light_that_is_off_are_dark(health):
    noise = np.random.default_rng(5).integers(0, 5, (*WORN_SHAPE, 3), dtype=np.uint8)
    assert names(health(noise)) == ["dark"]
    frame = pressed()
    frame[..., 1] = 2
    faults = health(frame)
    assert names(faults) == ["dark"]
    assert "gray levels: green 100 %. Is a light off" in faults.findings[0].message


@pytest.mark.parametrize(
    ("part", "level"), [(np.s_[:24], 0), (np.s_[60:], 128), (np.s_[:, 70:], 0), (np.s_[80:], (0, 135, 0))]
)
def test_a_part_of_one_color_is_torn_and_lost(health, part, level):
    faults = health(with_part(pressed(), part, level))
    true = np.zeros(WORN_SHAPE, dtype=bool)
    true[part] = True
    assert_torn(faults, true)
    assert faults.findings[0].figure == pytest.approx(true.mean(), abs=0.08)
    assert np.count_nonzero(faults.lost & ~true) < 0.4 * true.size


def test_rows_that_repeat_a_good_one_or_a_band_are_torn_and_the_copy_is_lost(health):
    frame = pressed()
    frame[80:] = frame[79]
    faults = health(frame)
    assert_torn(faults, np.s_[80:])
    assert not faults.lost[:48].any()
    frame = gel(7)
    frame[64:80] = frame[64]  # as many equal rows as a block of JPEG has
    assert_torn(health(frame), np.s_[65:80], 15 / 96)
    frame = gel(7)
    frame[64:80] = frame[8:24]
    assert_torn(health(frame), np.s_[64:80], 16 / 96)
    faults = health(with_part(pressed(), np.s_[:7], 0))
    assert_torn(faults, np.s_[:7])
    assert not faults.lost[32:].any()


def striped(seed, shift_px=0):
    """A gel that a fine relief, of random height from place to place, presses all over."""
    rng = np.random.default_rng(seed)
    relief = cv2.GaussianBlur(rng.normal(0, 300, (*WORN_SHAPE, 3)), (0, 0), 6)
    return np.clip(gel(seed + 50) + np.roll(relief, shift_px, axis=1), 0, 255).astype(np.uint8)


@pytest.mark.parametrize("row", [3, 37, 48, 92])
def test_a_part_of_another_moment_is_torn(health, row):
    """Of a press, over the gel at rest, in whichever part, and over another press."""
    one, other, rest = striped(1), striped(2), gel(7)
    for above, below, lost in ((one, rest, np.s_[:row]), (rest, one, np.s_[row:])):
        assert_torn(health(np.vstack([above[:row], below[row:]])), lost)
    assert names(health(np.vstack([one[:row], other[row:]]))) == ["torn"]
    for whole in (one, other):
        assert names(health(whole)) == []


def test_a_seam_is_one_row_and_an_edge_along_the_rows_is_none(health):
    """Both have the same height; optics blur the edge, by 0.7 pixels."""
    step = np.zeros((*WORN_SHAPE, 1), dtype=np.float32)
    step[40:, 20:90] = 60
    edge = cv2.GaussianBlur(step, (0, 0), 0.7)[..., None]
    found = [names(health(np.clip(gel(3) + one, 0, 255).astype(np.uint8))) for one in (step, edge)]
    assert ["torn" in one for one in found] == [True, False]


def test_compression_is_no_tear(health):
    for image in (striped(1), pressed()):
        for quality in (20, 50):
            _, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])
            assert "torn" not in names(health(cv2.imdecode(data, cv2.IMREAD_COLOR)))


def test_older_halves_of_real_frames_are_found(data):
    """Where neither half differs from the other at the seam, as when both show the gel at rest, nothing can be found."""

    presses = gelform.read_presses(data / "mini-ball")
    images, health = [press.image for press in presses.presses], FrameHealth(presses.background)
    halves = [np.vstack([images[i][:120], images[i - 1][120:]]) for i in range(0, 64, 4)]
    assert sum(names(health(half)) == ["torn"] for half in halves) >= 12


@pytest.mark.slow
def test_a_sharp_ridge_along_the_rows_of_a_real_video_is_no_tear(data):
    from gelform import Video

    frames = [frame.image for frame in Video(data / "slip" / "clips" / "cheese_tube_3.avi")]
    for rest in (frames[0], np.median(frames[::8], axis=0)):
        health = FrameHealth(rest.astype(np.float32))
        assert [k for k, frame in enumerate(frames) if "torn" in names(health(frame))] == []


def test_rows_that_the_untouched_image_repeats_too_are_sound():
    framed = gel()
    framed[:12] = framed[84:] = 0
    frame = pressed()
    frame[:12] = frame[84:] = 0
    assert names(FrameHealth(framed)(frame)) == []


def test_the_background_itself_is_frozen_and_a_second_look_is_not():
    health = FrameHealth(gel().astype(np.float32))
    assert names(health(gel())) == ["frozen"]
    changed = gel()
    changed[40, 60, 1] += 1
    assert names(health(changed)) == []


def test_a_quarter_that_saturates_is_found_and_only_it_is_lost(health):
    glare = np.zeros(WORN_SHAPE, dtype=np.float32)
    glare[:52, :68] = 255
    frame = np.clip(pressed() + cv2.GaussianBlur(glare, (0, 0), 3)[..., None], 0, 255)
    frame[:52, :68] -= np.random.default_rng(6).integers(0, 4, (52, 68, 3))
    faults = health(np.clip(frame, 0, 255).astype(np.uint8))
    assert names(faults) == ["saturated"]
    assert faults.findings[0].figure == pytest.approx(0.25)
    assert np.array_equal(np.argwhere(faults.lost).max(axis=0), [47, 63])


def test_frames_of_real_sensors_raise_no_false_alarm(data):
    from gelform import Video, read_image

    ball, objects = data / "mini-ball", data / "mini-objects"
    for folder, images in (
        (ball, sorted(ball.glob("*/*/gelsight.png"))),
        (objects, [objects / f"{name}.png" for name in ("bead", "key", "seed")]),
    ):
        health = FrameHealth(read_image(folder / "background.png"))
        assert images
        assert [path.name for path in images if health(read_image(path)).findings] == []
    video = list(Video(data / "mini-markers-video" / "mini_example.avi"))
    frames = [getattr(frame, "image", frame) for frame in video]
    health = FrameHealth(np.mean(frames[:20], axis=0).astype(np.float32))
    assert [k for k, frame in enumerate(frames) if health(frame).findings] == []


@pytest.mark.slow
@pytest.mark.parametrize(
    "folder", ["digit-ball", "gelslim", "gelslim-dots", "gelsight-ball-deep", "mini-d", "mini-edge"]
)
def test_presses_of_real_sensors_are_not_torn(data, folder):
    from gelform import read_image

    health = FrameHealth(read_image(data / folder / "background.png"))
    images = sorted((data / folder / "images").iterdir())
    assert images
    assert [path.name for path in images if "torn" in names(health(read_image(path)))] == []


def test_the_signs_of_faults_are_those_of_numpy():
    def counted(means, ranges, digests, dark_to, saturated_from, work, signs, flat):
        ended = (means < dark_to) | (means >= saturated_from)
        repeated = len(digests) - len(np.unique(digests))
        return np.array([np.sum(ranges <= flat), ended.sum(), repeated], np.int32)

    assert_kernel_agrees(SIGNS, counted)


def test_depth_is_bounded_by_the_gels_thickness_or_else_the_field_of_view():
    assert DepthLimit.of((240, 320), 0.05) == DepthLimit(pytest.approx(12.0), False)
    anything = np.random.default_rng(0).uniform(0, 6.0, 100_000)
    assert DepthLimit(6.0, True).ignorance_mm == pytest.approx(anything.std(), rel=0.01)
    limit = DepthLimit.of((240, 320), 0.05, thickness_mm=3.5)
    bounded, of_bounded, (finding,) = limit.bound(np.array([[1.0, 4.0], [-9.0, 0.0]], dtype=np.float32))
    np.testing.assert_array_equal(bounded, [[1.0, 3.5], [-3.5, 0.0]])
    assert of_bounded == (-3.5, 3.5)
    assert (finding.name, finding.figure) == ("beyond_gel", 9.0)
    assert "thickness of the gel (3.5 mm)" in finding.message
    within = np.array([[0.0, 3.0]], dtype=np.float32)
    assert limit.bound(within) == (within, (0.0, 3.0), ())


PRIME = np.uint64(0x9E3779B97F4A7C15)


def reference(image, means, ranges, digests, sums):
    h, w = means.shape[:2]
    seen = image[: 16 * h, : 16 * w].reshape(h, 16, w, 16, 3)[:, ::4].astype(int)
    means = (seen.sum(axis=(1, 3)) + 32) // 64
    ranges = np.ptp(seen, axis=(1, 3)).max(axis=-1)
    sums = image[:, : 16 * w].reshape(len(image), w, 16, 3).sum(axis=2, dtype=int)
    return means, ranges, np.array([digest(row.tobytes()) for row in image]), sums


def digest(row):
    step = max(len(row) // 16, 8)
    even, odd = np.uint64(1), np.uint64(2)
    with np.errstate(over="ignore"):
        for count, at in enumerate(range(0, len(row), step)):
            word = np.uint64(int.from_bytes(row[at : at + 8], "little"))
            if count % 2:
                odd = (odd ^ word) * PRIME
            else:
                even = (even ^ word) * PRIME
        return (even + np.uint64(3) * odd).astype(np.int64)


def test_the_kernel_agrees_with_numpy():
    assert_kernel_agrees(health_module._blocks, reference)


def without_the_step(sums, rest, work, totals, least, factor, spill):
    """The total of each row once the largest step is taken out of all rows below it."""
    change = sums.astype(float) - rest

    def steps(change):
        found = np.zeros_like(change)
        found[2:-1] = 3 * (change[2:-1] - change[1:-2]) - (change[3:] - change[:-3])
        return found

    weights = 1 / np.maximum((steps(change) ** 2).sum(axis=0) / len(change), least**2)
    totals = steps(change) ** 2 @ weights
    row = int(np.argmax(totals))
    if row:
        change[row:] -= steps(change)[row] / 2
        for y in range(max(row - 2, 2), min(row + 3, len(change) - 1)):
            totals[y] = steps(change)[y] ** 2 @ weights
    return totals


@pytest.mark.parametrize("shape", [(240, 60), (9, 3), (4, 1), (3, 6), (40, 0)])
def test_the_steps_of_rows_are_those_of_numpy(shape):
    rng = np.random.default_rng(5)
    sums, rest = rng.integers(0, 4081, (2, *shape), dtype=np.uint16)
    sums[shape[0] // 2 :] //= 2
    work, totals = np.empty(3 * shape[1], np.float32), np.zeros(shape[0], np.float32)
    assert_kernel_agrees(SEAM, without_the_step, sums, rest, work, totals, 8.0, 3.0, 0.1)


def test_blocks_are_of_levels_rounded_as_a_camera_would_and_reach_the_border():
    image = np.random.default_rng(4).uniform(0, 255, (32, 32, 3)).astype(np.float32)
    np.testing.assert_array_equal(blocks_of(image).means, blocks_of(np.rint(image).astype(np.uint8)).means)
    found = blocks_of(np.zeros((40, 60, 3), dtype=np.uint8))
    last = np.zeros((2, 3), dtype=bool)
    last[1, 2] = True
    expected = np.zeros((40, 60), dtype=bool)
    expected[16:, 32:] = True
    np.testing.assert_array_equal(found.pixels(last, 60), expected)
    small = blocks_of(np.zeros((5, 7, 3), dtype=np.uint8))
    assert small.means.shape == (0, 0, 3)
    assert not small.pixels(np.zeros((0, 0), dtype=bool), 7).any()


@pytest.mark.parametrize(
    ("rest", "level", "found"),
    [
        *((gel(), 7, ["dark"]), (gel(), 9, []), (gel(), 251, []), (gel(), 253, ["saturated"])),
        # Which the untouched image is itself.
        *((np.minimum(gel(), 12), 0, []), (constant(250), 255, [])),
    ],
)
def test_the_levels_that_count(rest, level, found):
    findings, blocks = Levels(blocks_of(rest))(blocks_of(constant(level)))
    assert [finding.name for finding in findings] == found
    assert (blocks is not None) == bool(found)


def torn_of(background):
    return Torn(background.astype(np.float32), blocks_of(background))


def test_flat_blocks_of_the_rest_image_s_color_or_of_many_are_a_picture():
    rest, corner = gel(), np.s_[:48, :48]
    own = rest[corner].mean(axis=(0, 1)).round().astype(np.uint8)
    flat, other = (torn_of(rest).flat(blocks_of(with_part(rest, corner, color))) for color in (own, 20))
    assert flat is None or np.count_nonzero(flat) < 9
    assert np.count_nonzero(other) == 9
    colors = np.random.default_rng(3).integers(0, 256, (6, 8, 3), dtype=np.uint8)
    many = torn_of(rest).flat(blocks_of(np.kron(colors, np.ones((16, 16, 1), np.uint8))))
    assert many is None or many.mean() < 0.1


def banded(image, levels, period, *, multiplies, along=0):
    wave = np.sin(2 * np.pi * np.arange(image.shape[along]) / period + 0.3)
    wave = wave[:, None, None] if along == 0 else wave[None, :, None]
    changed = image * (1 + levels / image.mean() * wave) if multiplies else image + levels * wave
    return np.clip(np.rint(changed), 0, 255).astype(np.uint8)


@pytest.mark.parametrize("along", [0, 1])
@pytest.mark.parametrize("multiplies", [True, False])
@pytest.mark.parametrize(("levels", "period"), [(3, 16), (10, 60), (30, 30)])
def test_bands_along_the_cameras_rows_are_named_and_taken_out(levels, period, multiplies, along):
    y, x = np.mgrid[:240, :320][..., None]
    rest = 110 + 20 * np.sin(x / 70 + np.arange(3)) + 10 * np.cos(y / 90)
    noise = np.random.default_rng(0).normal(0, 1, rest.shape)
    pressed = rest.copy()
    pressed[80:160, 100:200] += np.array([25, -20, 10])
    health = FrameHealth(rest, is_turned=along == 1)
    for true in (rest, pressed):
        assert names(health(np.rint(true + noise).astype(np.uint8))) == []
        found = health(banded(true + noise, levels, period, multiplies=multiplies, along=along))
        (finding,) = found.findings
        assert (finding.name, finding.figure) == ("bands", pytest.approx(levels, rel=0.35))
        left = (found.image - true - noise)[8:-8, 8:-8].mean(axis=(1 - along, 2))
        assert np.sqrt(np.mean(np.square(left - left.mean()))) < 0.3 * levels / np.sqrt(2)


def test_what_is_no_band_is_none():
    """An object from edge to edge has colors, one that ends has another place, light is smooth, noise is nothing."""
    y, x = np.mgrid[:240, :320][..., None]
    rest = 110 + 20 * np.sin(x / 70 + np.arange(3))
    bar = np.exp(-np.square((y - 120) / 20)) * (y - 120) / 20 * np.array([40, -30, -5])
    half = bar * (x < 160) + 20 * np.exp(-np.square((y - 60) / 15)) * (x > 200)
    for change in (bar, half, 0.1 * (y - 120), 20 * np.square(y / 120 - 1)):
        assert names(FrameHealth(rest)(np.clip(np.rint(rest + change), 0, 255).astype(np.uint8))) == []


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", ["mini-ball", "mini-d", "digit-ball", "gelslim", "gelslim-dots", "gelsight-ball-deep", "digit-c"]
)
def test_real_presses_have_no_bands(data, name):
    presses = gelform.read_presses(data / name)
    for is_turned in (False, True):
        health = FrameHealth(presses.background, is_turned)
        assert not any("bands" in names(health(press.image)) for press in presses.presses)


def test_what_thirds_have_in_common_is_that_of_numpy():
    def in_thirds(sums, gray, smooth, flat, common):
        each, smooth = sums.shape[1] // 3, smooth.astype(float)
        rows = sums[:, : 3 * each].reshape(len(sums), 3, -1).mean(axis=2) / health_module.BLOCK_PX
        change = rows * gray.mean() / max(rows.mean(), 1) - gray
        change = change - smooth @ (smooth.T @ change)
        products = (change.T @ change)[[0, 1, 2], [1, 2, 0]] / len(sums)
        return change, np.array([products.min()])

    assert_kernel_agrees(BANDS, in_thirds)


def test_the_signs_of_a_frame_are_those_of_its_steps():
    def by_steps(image, dark_to, saturated_from, rest, gray, smooth, *out_and_numbers):
        *blocks, _, _, flat, _, _, _ = out_and_numbers
        means, ranges, digests, sums = blocks
        health_module._blocks(image, *blocks)
        counts, common = np.empty(3, np.int32), np.full(1, np.inf, np.float32)
        places = np.empty(1 << len(image).bit_length(), np.int32)
        SIGNS(means, ranges, digests, dark_to, saturated_from, places, counts, flat)
        if gray is not None and smooth is not None:
            BANDS(sums, gray, smooth, np.empty_like(gray), common)
        return *blocks, np.array([*counts, common[0]])

    assert_kernel_agrees(health_module._health, by_steps)
