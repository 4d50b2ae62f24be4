"""Each benchmark reads its command line with argparse, so `--help` says what it does and measures nothing.

The paper quotes the recorded results, and no other figure.

The integrators that gelform does not use: exact where their assumption holds, wrong as documented where not.

The border of a cube's faces is found in the color alone: of even faces whose color decays beside them.

The comparison of two commits notices one bit, says where it is, and passes over times of day alone.

The benchmark on a cube's edge finds the faces of a roof whose slopes are read too small, and states the truth.
"""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path

import numpy as np
import pytest

import edges_of_cube
import faces_of_cube
import gelform
import paper
from edges_of_cube import DATA
from gelform.depth.integrate import depth_from_gradients
from naive_integrators import depth_along_lines, depth_periodic, depth_zero_border
from same import differences, digest, lasting, of_file, of_frames
from scenes import BALLS, PLANE, QUADRATIC, polynomial, rmse_um, scene, waves

SCRIPTS = [
    path
    for path in sorted(Path(__file__).parents[2].joinpath("benchmarks").glob("*.py"))
    if "__main__" in path.read_text(encoding="utf-8")
]


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.stem)
def test_it_has_a_command_line(script):
    text = script.read_text(encoding="utf-8")
    assert "parse_args()" in text or "parts_asked(" in text


ROOT = Path(__file__).parents[2]
TEXT = (ROOT / "paper/paper.md").read_text(encoding="utf-8").split("---\n", 2)[2]
PLAIN = " ".join(TEXT.split())
NOT_MEASURED = (
    r"@\w+", r"!\[.*?\]\(.*?\)\{.*?\}", r"\|[:|-]+\|", "[Ff]igure 1", r"Tables? \d", "ROS 2", r"py3DCal", "3D printer",
    r"\(deg\)",
)  # fmt: skip


def without_quotes(text):
    """The text without the quotes, names and numbers of figures."""
    for quote in paper.quotes():
        text = text.replace(quote, "")
    for name in NOT_MEASURED:
        text = re.sub(name, "", text)
    return text


def test_each_quote_is_there():
    assert [quote for quote in paper.quotes() if quote not in PLAIN] == []


def test_there_is_no_other_figure():
    assert re.findall(r".{0,30}\d.{0,10}", without_quotes(PLAIN)) == []


@pytest.mark.parametrize("added", ["It takes 3 ms.", "Table 1 shows 12 %."])
def test_another_figure_is_found(added):
    assert re.search(r"\d", without_quotes(f"{PLAIN} {added}"))


def test_each_reference_is_cited_and_there():
    entries = set(re.findall(r"^@\w+\{(\w+),", (ROOT / "paper/paper.bib").read_text(encoding="utf-8"), re.M))
    assert set(re.findall(r"@(\w+)", TEXT)) == entries


PITCHES = [(0.0634, 0.0634), (0.05, 0.08)]


@pytest.mark.parametrize("pitch", PITCHES)
@pytest.mark.parametrize("shape", [(1, 1), (1, 9), (8, 1), (2, 3), (31, 24)])
def test_lines_are_exact_on_quadratics(shape, pitch):
    truth, gradients, _ = scene(QUADRATIC, shape, pitch)
    assert depth_along_lines(gradients, pitch) == pytest.approx(truth - truth.mean(), abs=1e-6)


@pytest.mark.parametrize("pitch", PITCHES)
@pytest.mark.parametrize("shape", [(3, 3), (3, 9), (24, 31)])
def test_zero_border_is_exact_on_a_parabolic_cap_over_the_frame(shape, pitch):
    """z = (a^2 - x^2)(b^2 - y^2) is 0 on the border and quadratic along rows and columns."""
    a, b = (shape[1] - 1) / 2 * pitch[0], (shape[0] - 1) / 2 * pitch[1]
    cap = polynomial({(0, 0): a**2 * b**2, (2, 0): -(b**2), (0, 2): -(a**2), (2, 2): 1.0})
    truth, gradients, _ = scene(cap, shape, pitch)
    assert depth_zero_border(gradients, pitch) == pytest.approx(truth, abs=2e-6 * np.ptp(truth))


@pytest.mark.parametrize("shape", [(1, 5), (2, 7), (5, 1)])
def test_zero_border_of_a_frame_that_is_all_border_is_zero(shape):
    assert np.array_equal(depth_zero_border(np.ones((*shape, 2)), (0.1, 0.1)), np.zeros(shape))


@pytest.mark.parametrize("shape", [(24, 48), (25, 45), (1, 24)])
def test_periodic_is_exact_on_periodic_waves(shape):
    pitch = 2.4 / shape[1], 1.2 / shape[0]
    truth, gradients, _ = scene(waves(0.02, 0.6), shape, pitch)
    assert depth_periodic(gradients, pitch) == pytest.approx(truth - truth.mean(), abs=1e-6)


def test_assumptions_fail_where_the_border_cuts_a_contact():
    truth, gradients, pitch = scene(BALLS)
    assert rmse_um(depth_from_gradients(gradients, mm_per_px=pitch), truth) < 1.25
    assert rmse_um(depth_periodic(gradients, pitch), truth) > 40
    assert rmse_um(depth_zero_border(gradients, pitch), truth) > 40


def test_periodic_and_zero_border_lose_a_tilt():
    truth, gradients, pitch = scene(PLANE)
    for integrate in (depth_periodic, depth_zero_border):
        assert np.ptp(integrate(gradients, pitch)) < 0.3 * np.ptp(truth)
    depth = depth_from_gradients(gradients, mm_per_px=pitch)
    assert np.ptp(depth) == pytest.approx(np.ptp(truth), rel=1e-4)


SHAPE = (160, 240)
COLORS = np.array([[60.0, -30, 10], [-40, 10, 50]])  # gray levels of the change of both faces


def cube(widths_px, light=1.0, top=80.0):
    """Image, background and faces of an edge along x, whose faces' widths grow by a tenth of it, and the edge's ends."""
    rng = np.random.default_rng(0)
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)
    background = rng.uniform(90, 110, (*SHAPE, 3))
    change, faces = np.zeros((*SHAPE, 3)), np.zeros(SHAPE, bool)
    for sign, width, color in zip((1, -1), widths_px, COLORS):
        away, border = sign * (y - top), width + 0.1 * (x - 120)
        beyond = np.maximum(away - border, 0) + np.maximum(np.abs(x - 120) - 80, 0)
        change += (away > 0)[..., None] * color * np.exp(-beyond / 8)[..., None]
        faces |= (away > 0) & (away < border) & (np.abs(x - 120) < 80)
    image = light * (background + change) + rng.normal(0, 1, change.shape)
    ends = np.array([(40, top + 3), (200, top - 3)])
    return np.clip(image, 0, 255).astype(np.uint8), background, faces, ends


@pytest.mark.parametrize(
    ("widths", "light", "top"),
    [
        ((20, 20), 1.0, 80.0),
        ((12, 24), 1.0, 80.0),
        ((20, 20), 1.12, 80.0),
        ((30, 20), 1.0, 120.0),  # a face whose border is 10 px from the frame's
    ],
)
def test_faces_end_where_their_color_begins_to_decay(widths, light, top):
    image, background, faces, ends = cube(widths, light, top)
    found = faces_of_cube.touched_faces(image, background, ends)
    assert np.count_nonzero(found & faces) / np.count_nonzero(found | faces) > 0.9


def test_marks_are_moved_onto_the_edge():
    image, background, _, ends = cube((20, 20))
    moved = faces_of_cube.sharpest((image - background).astype(np.float32), ends.astype(float))
    np.testing.assert_allclose(moved[:, 1], 80, atol=0.8)


def test_every_marked_frame_exists(data):
    assert all((DATA / "mini-edge" / "images" / name).is_file() for name in faces_of_cube.ENDS)


MM_PER_PX, READ = 0.0625, 0.5
SHAPE_EDGES_OF_CUBE = (120, 240)


def roof(roll_deg, turn_deg, read=READ, length_px=160):
    """Depth (mm) of a roof of 90 degrees on flat gel, its slopes as a bad model reads them, and the true ones."""
    y, x = np.mgrid[: SHAPE_EDGES_OF_CUBE[0], : SHAPE_EDGES_OF_CUBE[1]].astype(float)
    turn = np.radians(turn_deg)
    u = np.array([-np.sin(turn), np.cos(turn)])  # across the edge
    x, y = x - SHAPE_EDGES_OF_CUBE[1] / 2, y - SHAPE_EDGES_OF_CUBE[0] / 2
    away, along = x * u[0] + y * u[1], x * u[1] - y * u[0]
    slopes = np.tan(np.radians(45 + np.array([roll_deg, -roll_deg])))
    on = (np.abs(along) < length_px / 2) & (away > -20) & (away < 20)
    true = np.where(away < 0, slopes[0], -slopes[1])
    gradients = read * np.where(on, true, 0)[..., None] * u
    depth = MM_PER_PX * read * np.minimum(away * slopes[0], -away * slopes[1])
    return depth, gradients, slopes, u


@pytest.mark.parametrize(("roll_deg", "turn_deg"), [(0, 0), (8, 5), (-8, 30)])
def test_the_faces_of_a_roof_are_found_and_made_perpendicular(roll_deg, turn_deg):
    _, gradients, slopes, u = roof(roll_deg, turn_deg)
    edge = edges_of_cube.edge_in(gradients, MM_PER_PX)
    np.testing.assert_allclose(edge.true_gradients[0], slopes[0] * u, atol=0.02)
    np.testing.assert_allclose(edge.true_gradients[1], -slopes[1] * u, atol=0.02)
    assert edge.angle_deg == pytest.approx(np.degrees(np.arctan(READ * slopes).sum()), abs=1)
    away = (np.argwhere(edge.faces[0])[:, ::-1] - np.array(SHAPE_EDGES_OF_CUBE[::-1]) / 2) @ u
    assert -20 <= away.min() < -18
    assert -5.5 < away.max() <= -edges_of_cube.FROM_EDGE_PX + 0.5


def test_half_the_rise_is_missing_where_slopes_are_read_at_half():
    depth, gradients, slopes, _ = roof(5, 10)
    edge = edges_of_cube.edge_in(gradients, MM_PER_PX)
    missing = edges_of_cube.crest_error_mm(edge, depth, MM_PER_PX, slopes)
    assert missing == pytest.approx((1 - READ) * 19.5 * MM_PER_PX * slopes.mean(), rel=0.05)


def test_a_shorter_edge_is_cut():
    assert edges_of_cube.edge_in(roof(0, 0, length_px=120)[1], MM_PER_PX) is None
    assert edges_of_cube.edge_in(np.zeros((*SHAPE_EDGES_OF_CUBE, 2)), MM_PER_PX) is None


@pytest.mark.parametrize("turn_deg", [-7, 4])
def test_the_line_in_the_image_is_where_its_colors_change(turn_deg):
    """Faces 40 gray levels redder or bluer, of unequal shade, their border blurred over a pixel, in noise."""
    rng, turn, beside = np.random.default_rng(3), np.radians(turn_deg), (0.3, -0.4)
    u = np.array([-np.sin(turn), np.cos(turn)])
    y, x = np.mgrid[: SHAPE_EDGES_OF_CUBE[0], : SHAPE_EDGES_OF_CUBE[1]].astype(float)
    x, y = x - SHAPE_EDGES_OF_CUBE[1] / 2 - beside[0], y - SHAPE_EDGES_OF_CUBE[0] / 2 - beside[1]
    away, along = x * u[0] + y * u[1], x * u[1] - y * u[0]
    on = (np.abs(along) < 80) & (np.abs(away) < 20)
    face = np.where(on, -np.tanh(away) * (30 + along / 8) - 0.2 * away, 0)
    background = np.full((*SHAPE_EDGES_OF_CUBE, 3), 120.0)
    image = background + face[..., None] * (1, 0.2, -1) + rng.normal(0, 2, (*SHAPE_EDGES_OF_CUBE, 3))
    line = edges_of_cube.line_in(image, background, MM_PER_PX)
    assert np.degrees(np.arcsin(line.across[0] * u[1] - line.across[1] * u[0])) == pytest.approx(0, abs=0.05)
    off = (line.middle - np.array(SHAPE_EDGES_OF_CUBE[::-1]) / 2 - beside) @ u
    assert off == pytest.approx(0, abs=0.08)
    assert line.apart_px < 0.1
    assert np.degrees(line.apart_rad) < 0.05
    assert edges_of_cube.line_in(background, background, MM_PER_PX) is None


@pytest.fixture
def depth():
    return np.linspace(0, 1, 12, dtype=np.float32).reshape(3, 4)


def test_one_bit_of_an_array_is_noticed(depth):
    changed = depth.copy()
    changed.view(np.uint32)[1, 2] ^= 1
    assert digest(depth) == digest(depth.copy()) != digest(changed)


def test_type_and_shape_are_noticed(depth):
    others = [depth.astype(np.float64), depth.view(np.int32), depth.T, depth.ravel(), depth.tolist()]
    assert len({digest(one) for one in (depth, *others)}) == 1 + len(others)


def test_a_value_deep_in_a_record_is_noticed():
    @dataclasses.dataclass
    class Record:
        rows: list

    assert digest(Record([{"a": (1, 2.0)}])) != digest(Record([{"a": (1, np.nextafter(2.0, 3))}]))
    assert digest([1, 2]) != digest([12]) != digest(["12"])
    with pytest.raises(TypeError, match="got object"):
        digest(object())


def test_the_member_of_a_file_is_named_and_the_time_of_its_writing_does_not_count(tmp_path, depth):
    files = [tmp_path / "a.npz", tmp_path / "b.npz"]
    np.savez(files[0], depth=depth, known=depth > 0)
    depth[0, 0] = 1e-30
    np.savez(files[1], depth=depth, known=depth > 1e-20)
    old, new = (dict(of_file(file)) for file in files)
    assert differences(old, new) == ["changed  , depth.npy"]


def test_what_only_one_has_is_listed():
    assert differences({"a": "1", "b": "2"}, {"b": "2", "c": "3"}) == ["gone     a", "added    c"]


@pytest.mark.parametrize(
    ("first", "second", "alike"),
    [
        (b'"created_utc": "2026-11-28T08:04:11Z"', b'"created_utc": "2026-11-29T18:14:01Z"', True),
        (b'"seconds": 1.25, "peak_mm": 0.5', b'"seconds": 2, "peak_mm": 0.5', True),
        (b'"seconds": 1.25, "peak_mm": 0.5', b'"seconds": 1.25, "peak_mm": 0.51', False),
    ],
)
def test_times_alone_do_not_count(first, second, alike):
    assert (lasting(first) == lasting(second)) is alike


def test_all_of_a_result_counts(calibration, presses):
    """Also what is computed on first use, and no attribute before."""
    reconstruct, image = gelform.Reconstructor(calibration), presses.presses[0].image
    old, again = (of_frames("presses", calibration, [image]) for _ in range(2))
    names = {name.partition(": ")[2] for name in old}
    fields = {one.name for one in dataclasses.fields(reconstruct(image))}
    assert names >= fields | {
        "normals",
        "contacts",
        "depth_difference_sigma",
        "row of a batch",
        "page, depth",
    }
    assert differences(old, again) == []
    darker = image.copy()
    darker[tuple(size // 2 for size in image.shape[:2])] -= 1
    assert "changed  presses: curl_rms" in differences(old, of_frames("presses", calibration, [darker]))
