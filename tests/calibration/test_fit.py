"""calibrate: from a folder to depth, never with the simulator's own constants."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest

import gelform
from gelform.calibration.circles.edge import contact_radius_ratio
from gelform.calibration.circles.find import ContactCircle
from gelform.calibration.circles.locate import Located, Refined, check_places, refine
from gelform.calibration.circles.samples import USUAL_EDGE
from gelform.result.metrics import press_errors
from gelform.simulate import Ball, simulate_ball_presses, simulate_press
from gelform.slopes.color_models import COLOR_MODELS
from made.halved import halved


def test_held_out_errors_are_those_of_new_presses(calibration, simulated):
    """What the report promises, fresh presses keep: within a factor, on balls that nobody has seen."""
    reconstruct = gelform.Reconstructor(calibration)
    rng = np.random.default_rng(11)
    degrees = []
    for center in ((0.0, 0.0), (3.0, 2.0), (-3.5, 1.5)):
        press = simulate_press(simulated.sensor, Ball(3.2), depth_mm=0.6, center_mm=center, rng=rng)
        errors = press_errors(
            reconstruct(press.image).depth_mm,
            reconstruct(press.image).gradients,
            circle_px=(*press.center_px, press.contact_radius_px),
            ball_radius_mm=3.2,
            mm_per_px=simulated.sensor.mm_per_px,
            contact_radius_ratio=calibration.settings["contact_radius_ratio"],
        )
        degrees.append(errors.normal_deg)
        assert abs(errors.radius_percent) < 8
    assert np.mean(degrees) < 1.5 * calibration.held_out["normal_free_deg"]
    assert np.mean(degrees) < 2


def test_forward_response_renders_what_the_sensor_shows(calibration, simulated):
    press = simulated.presses[0]
    expected = calibration.color_from_gradients(press.gradients)
    seen = gelform.color_change_from_image(press.image, calibration.background, calibration.change)
    inside = press.contact & (np.linalg.norm(press.gradients, axis=-1) < 0.5)
    error = np.sqrt(np.mean((expected - seen)[inside] ** 2))
    assert error < 0.35 * np.sqrt(np.mean(seen[inside] ** 2))


def test_one_model_can_be_asked_for(presses, lambertian_calibration):
    assert lambertian_calibration.color_model.name == "lambertian"
    assert lambertian_calibration.held_out["normal_free_deg"] < 6
    with pytest.raises(ValueError, match=r"auto, lambertian, .*polynomial, .*got 'magic'"):
        gelform.calibrate(presses, color_model="magic")


@pytest.mark.slow
def test_two_calibrations_in_two_threads_are_those_of_each_alone(presses):
    halves = [presses.subset(range(start, len(presses.presses), 2)) for start in (0, 1)]
    with ThreadPoolExecutor(2) as pool:
        together = list(pool.map(gelform.calibrate, halves))
    for half, found in zip(halves, together):
        alone = replace(gelform.calibrate(half), created_utc="")
        assert replace(found, created_utc="").digest == alone.digest


def test_same_folder_same_calibration_and_progress_in_words(presses):
    calls, few = [], presses.subset(range(5))
    silent = gelform.calibrate(few, color_model="lambertian")
    told = gelform.calibrate(few, color_model="lambertian", progress=lambda *call: calls.append(call))
    first, second = (replace(calibration, created_utc="").digest for calibration in (silent, told))
    assert first == second
    assert {what for _, _, what in calls} >= {"finding contact circles", "measuring on held-out presses"}
    assert all(0 < done <= total for done, total, _ in calls)


@pytest.mark.parametrize("wrong", [None, [1, 2], np.zeros((3, 4))])
def test_what_is_no_presses_is_said(wrong):
    with pytest.raises(TypeError, match=r"Expected presses, from gelform.read_presses\(path\)"):
        gelform.calibrate(wrong)


def test_folder_without_a_ball_is_refused_with_counts(presses):
    rng, rest = np.random.default_rng(0), presses.background
    images = [np.clip(rest + rng.normal(0, 1, rest.shape), 0, 255).astype(np.uint8) for _ in range(4)]
    blank = tuple(replace(press, image=image) for press, image in zip(presses.presses, images))
    with pytest.raises(gelform.CalibrationError, match=r"at least 3 presses .* got 0 of 4 .* found"):
        gelform.calibrate(replace(presses, presses=blank))


def test_reasons_are_counted_together_and_the_first_is_given_in_full(presses):
    """They differ by their figures; what to do about them stands at their end."""
    names = [press.name for press in presses.presses]
    reasons = [f"contact radius {k}.5 px is too wide: ball diameter is wrong" for k in range(len(names) - 1)]
    contact = ContactCircle(60, 50, 20, 1, 1)
    refined = Refined((contact,) * len(names), (*reasons, "no ball found"), None)
    first = (
        rf"{len(reasons)} like {names[0]}: contact radius 0.5 px is too wide: ball diameter is wrong; 1 like"
    )
    noted = r"; 1 like .* no ball found\. The ball is twice as large\. Press a ball"
    for notes, message in (((), first), (("The ball is twice as large.",), noted)):
        with pytest.raises(gelform.CalibrationError, match=message):
            check_places(Located(presses, [], [], refined, notes=notes))


@pytest.mark.slow
def test_presses_train_up_to_the_measured_edge(calibration, presses, prepared, found):
    """That of the presses that fit; fewer than 12 are taken to have the usual one."""
    accepted = refine(prepared, found).of_accepted(prepared)
    assert calibration.settings["contact_radius_ratio"] == contact_radius_ratio(*accepted) != USUAL_EDGE
    few = gelform.calibrate(presses.subset(range(7)))
    assert few.settings["contact_radius_ratio"] == USUAL_EDGE


@pytest.mark.slow
def test_all_color_models_can_be_compared_and_the_choice_stays(presses, monkeypatch):
    """Beside the trials of what was asked for, those of all others, on the same folds; what cannot be tried is named."""
    slow = ("near_light", "interpolation", "lookup")
    quick = {name: model for name, model in COLOR_MODELS.items() if name not in slow}
    monkeypatch.setattr("gelform.calibration.fitted.COLOR_MODELS", quick)

    def refuse(*samples, **settings):
        raise gelform.GelformError("Training needs what is not installed.")

    monkeypatch.setattr(COLOR_MODELS["mlp"], "fit", refuse)
    few = presses.subset(range(0, 14, 2))
    plain = gelform.calibrate(few)
    compared = gelform.calibrate(few, compare=True)
    tried = [row["candidate"] for row in compared.report.candidates]
    assert {name.split()[0] for name in tried} == {"lambertian", "polynomial", "hierarchical"}
    assert "mlp was not compared: Training needs what is not installed." in compared.report.notes
    assert len(tried) == len(set(tried))
    (chosen,) = (row for row in compared.report.candidates if row["chosen"])
    assert chosen in plain.report.candidates
    assert {row["candidate"] for row in plain.report.candidates} < set(tried)
    same = [replace(one, report=None, created_utc="").digest for one in (plain, compared)]
    assert same[0] == same[1]
    assert compared.held_out == plain.held_out


@pytest.mark.slow
@pytest.mark.parametrize("name", ["lambertian", "near_light"])
def test_pixels_that_the_untouched_image_shows_black_do_not_train(presses, lambertian_calibration, name):
    """A law of light is divided by the untouched image: where that is 0 nothing is said, elsewhere all is as it was."""
    few = presses.subset(range(0, 14, 2))
    background = few.background.copy()
    background[40:43, 60:63] = 0
    images = [press.image.copy() for press in few.presses]
    for image in images:
        image[40:43, 60:63] = 0
    black = tuple(replace(press, image=image) for press, image in zip(few.presses, images))
    spotted = gelform.calibrate(replace(few, presses=black, background=background), color_model=name)
    assert spotted.color_model.name == name
    assert spotted.held_out["normal_free_deg"] < 1.1 * lambertian_calibration.held_out["normal_free_deg"]
    result = gelform.Reconstructor(spotted).from_image(images[0])
    assert np.isfinite(result.depth_mm).all()


@pytest.mark.slow
def test_ten_real_presses_are_enough_to_start(data):
    """Every sixth press of a real sensor, at half its size: the held-out errors stay within what ten presses can give."""
    few = halved(gelform.read_presses(data / "mini-ball").subset(range(0, 67, 6)))
    calibration = gelform.calibrate(few, color_model="hierarchical")
    assert (
        calibration.held_out["normal_free_deg"] < 2.5
    )  # recorded: 2.39, with the press that the border cuts
    assert calibration.held_out["normal_rim_deg"] < 3.3  # recorded: 2.81
    assert all(row.accepted for row in calibration.report.presses)


@pytest.fixture(scope="module")
def second_unit(sensor):
    """Another unit: its lights stand up to 3 mm elsewhere and are up to 30 % brighter or dimmer."""
    rng = np.random.default_rng(5)

    def moved(led):
        place = np.array(led.position_mm) + rng.normal(0, 2, 3) * (1, 1, 0.5)
        color = np.array(led.color) * rng.uniform(0.7, 1.3)
        return replace(led, position_mm=tuple(place), color=tuple(color))

    return replace(sensor, leds=tuple(moved(led) for led in sensor.leds), name="second unit")


@pytest.mark.slow
def test_a_second_unit_needs_five_presses(calibration, second_unit, tmp_path):
    """Started from the first unit's, it comes near its own full calibration, and is better than five alone.

    Errors are counted inside one edge, that which is assumed of five presses.
    """

    def presses_of(count, seed, name):
        rng = np.random.default_rng(seed)
        made = simulate_ball_presses(
            second_unit, ball_diameters_mm=[5.0, 8.0], count=count, rng=rng, oversample=1
        )
        gelform.save_simulated_presses(tmp_path / name, made)
        with (tmp_path / name / "sensor.toml").open("a") as settings:
            settings.write("gel_thickness_mm = 2.5\n")
        return gelform.read_presses(tmp_path / name)

    five, many, test = presses_of(5, 3, "five"), presses_of(12, 2, "many"), presses_of(4, 4, "test")
    calibration.save(tmp_path / "first.npz")
    started = gelform.calibrate(str(tmp_path / "five"), start=tmp_path / "first.npz")  # paths are read
    full = gelform.calibrate(many, color_model="hierarchical")
    alone = gelform.calibrate(five, color_model="hierarchical")
    edge = {"contact_radius_ratio": USUAL_EDGE}
    assert edge.items() <= started.settings.items()
    full = replace(full, settings={**full.settings, **edge})
    error, own, few = (gelform.evaluate(c, test).summary["normal_free_deg"] for c in (started, full, alone))
    assert error < 1.7 * own
    assert error < 0.8 * few
    assert started.settings["start"] == calibration.digest
    started.save(tmp_path / "second.npz")
    assert gelform.load_calibration(tmp_path / "second.npz").digest == started.digest
    assert gelform.load_calibration(tmp_path / "second.npz").settings["gel_thickness_mm"] == 2.5


def test_what_cannot_be_started_from_is_said(calibration, presses):
    with pytest.raises(ValueError, match=r"--model hierarchical"):
        gelform.calibrate(presses, start=calibration, color_model="lambertian")
    other = replace(calibration, color_model=replace(calibration.color_model, shape=(10, 10)))
    with pytest.raises(ValueError, match=r"10x10 px"):
        gelform.calibrate(presses, start=other)
