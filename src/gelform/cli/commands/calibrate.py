"""gelform calibrate: presses of a ball to a calibration; gelform starter: one without a press.

gelform scale, lens and crosstalk measure before, from objects of known size, and from the gel under single LEDs.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from typer import BadParameter, Option

import gelform
from gelform import DataError
from gelform.cli import options
from gelform.cli.console import ShownOption, figure, mistakes_in, only_writer, say
from gelform.cli.files import (
    REPORT_FILES,
    check_output,
    check_results,
    content_of,
    starter_calibration,
    write_report,
)
from gelform.cli.options import argument, listed, number, numbers, one_of, option

if TYPE_CHECKING:
    from gelform.calibration.report.record import PressReport

Place = Annotated[Path, argument("PLACE", "Press folder, or its sensor.toml, to write into.")]
MODELS = ("auto", *options.COLOR_MODELS)


def calibrate(
    *,
    presses: Annotated[Path, argument("PRESSES", "Ball presses: a folder, a video or a recording.")],
    output: options.NewCalibration,
    model: Annotated[str, option("NAME", f"Color model: {listed(MODELS)}.")] = "auto",
    start: Annotated[
        str,
        option(
            "CAL.npz",
            "Start from another unit's calibration: then 5 presses read slopes as 10 alone. auto: a known make's "
            "starter; none.",
        ),
    ] = "auto",
    given: options.PressOptions,
    crop: Annotated[
        str | None, option("L,T,W,H", "Part of the frame as image: left,top,width,height, px.")
    ] = None,
    report: Annotated[Path | None, option("DIR", "Folder for a report on quality and next steps.")] = None,
    compare: Annotated[
        bool, Option("--compare", help="Also try every color model on these presses, for the report's table.")
    ] = False,
    verbose: Annotated[
        bool, Option("--verbose", "-v", help="Also show rejected presses, models, held-out errors and notes.")
    ] = False,
    fresh: Annotated[
        bool, Option("--fresh", help="Neither use circles that an earlier try found, nor keep them.")
    ] = False,
    overwrite: options.Overwrite = False,
    shown: ShownOption,
) -> None:
    """Calibrate a sensor from presses of a ball.

    PRESSES contains background.png (the gel at rest), images, presses.csv (columns image,ball_diameter_mm) and
    sensor.toml (name, mm_per_px). These also work: a plain folder of images, with --ball-diameter-mm and --mm-per-px
    or --sensor; a video or a recording (*.mcap) that begins with the gel at rest; gs_sdk's and py3DCal's folders; Taxim's
    dataPack.npz. Take 20 presses all over the gel (angle error about 2 degrees). With a start, 5 do (about 2.5).
    Measure scale, lens and crosstalk first, with `gelform scale`, `gelform lens` and `gelform crosstalk`.
    The circle found in each image is kept in your cache (gelform/circles) for a month, so that a next try, as after
    Ctrl-C, starts behind them.

    \b
    Examples:
      gelform calibrate presses/ -o cal.npz
      gelform calibrate presses/ -o cal.npz --report report/
      gelform calibrate presses/ -o cal.npz --report report/ --compare
      gelform calibrate frames/ -o cal.npz --sensor gelsight-mini --ball-diameter-mm 6.35
      gelform calibrate presses.avi -o cal.npz --sensor gelsight-mini --ball-diameter-mm 6.35
      gelform calibrate frames/ -o cal.npz --mm-per-px 0.05 --ball-diameter-mm 4 --crop 20,10,600,450
      gelform calibrate five_presses/ -o second.npz --start first.npz
      gelform calibrate presses/ -o alone.npz --start none
    """
    began = time.monotonic()
    one_of(model, MODELS, "--model")
    box = None if crop is None else numbers(crop, "LEFT,TOP,WIDTH,HEIGHT", "--crop")
    check_output(output, overwrite=overwrite)
    if report is not None:
        check_output(report / REPORT_FILES[0], overwrite=True)
        check_results([report / name for name in REPORT_FILES], overwrite=overwrite)
    from gelform.calibration.circles.find import circles_kept
    from gelform.calibration.library import cache_folder
    from gelform.calibration.report.record import used_in_words

    kept = circles_kept(None if fresh else cache_folder("circles"))
    with only_writer(output), kept, shown.progress() as progress:
        found = gelform.read_presses(presses, **vars(given), crop=box, progress=progress)  # type: ignore[arg-type]
        given_start = None if start == "none" else start
        calibration = gelform.calibrate(
            found, color_model=model, start=given_start, compare=compare, progress=progress
        )
        calibration.save(output, overwrite=overwrite)
        content = content_of(found, calibration, progress, with_learning=report is not None)
        if report is not None:
            try:
                write_report(content, found, calibration, report, overwrite)
            except DataError as problem:
                raise DataError(f"Wrote {output}, but not its report. {problem}") from problem
    for finding in calibration.findings:
        say(f"warning: {finding.message}")
    verdict = content["verdict"]
    if verbose:
        _show(calibration, shown)
    for note in (
        calibration.report.notes if verbose or verdict["level"] == "poor" else ()
    ):  # it may be the cause
        say(f"note: {note}", shown.silent)
    shown.say(f"{verdict['headline']}.")
    shown.say(f"Next: {_with_places(verdict['next'], content['coverage']['next'])}")
    shown.say(f"Checks: {verdict['checks']}.")
    made = calibration.report
    in_contact, off_contact = (figure(made.held_out.get(name)) for name in ("cap_free_um", "off_contact_um"))
    more = "" if verbose else " (all tables: --verbose)"
    shown.say(
        f"{calibration.sensor_name}: {used_in_words(made.presses)} ({_lying(made.presses, calibration)}); depth on held-out "
        f"presses is off by {in_contact} um in the contact, {off_contact} um off it{more}."
    )
    wrote = f"{output}{f' and {report / REPORT_FILES[0]}' if report else ''}"
    shown.say(f"Wrote {wrote} in {time.monotonic() - began:.0f} s.")
    serial = "" if calibration.serial else " --serial SERIAL"
    shown.say(f"To let commands find it without -c: gelform calibrations add {output}{serial}")
    shown.json({"calibration": str(output), **made.to_dict(), "verdict": verdict})


def _with_places(advice: str, places: Sequence[Mapping[str, Any]]) -> str:
    """Advice for a terminal, where no map shows the places that the report marks 1, 2, 3: with their pixels."""
    at = [f"{place['name']} ({place['x_px']:.0f}, {place['y_px']:.0f})" for place in places]
    where = f"at pixels (x, y) {', '.join(at)}" if at else "all over the gel"
    return advice.replace("at the places marked 1, 2, 3", where).replace("at places 1, 2, 3", where)


def _lying(rows: Sequence[PressReport], calibration: gelform.Calibration) -> str:
    """How many of the used presses lie in each ninth of the image, most first."""
    from gelform.calibration.coverage import name_of_place

    shape = calibration.image_shape
    names = Counter(name_of_place(r.center_x_px, r.center_y_px, shape) for r in rows if r.accepted)
    return ", ".join(f"{name} {count}" for name, count in names.most_common())


def _show(calibration: gelform.Calibration, shown: ShownOption) -> None:
    from gelform.calibration.report.record import FIGURES

    report = calibration.report
    rejected = [(row.name, row.reason) for row in report.presses if row.reason and not row.repeats]
    shown.table("Rejected presses", ("press", "reason"), rejected)
    tried = [
        (one["candidate"] + (" (chosen)" if one["chosen"] else ""), one["normal_free_deg"])
        for one in report.candidates
    ]
    shown.table("Color models tried", ("model", "held-out normal error (°)"), tried)
    saved = report.held_out_saved.items()
    held_out = [(FIGURES[name], error, report.held_out[name]) for name, error in saved]
    columns = ("held-out error", "saved model", "whole procedure")
    shown.table("Errors on held-out presses", columns, held_out)


def starter(
    *,
    sensor: Annotated[str, argument("SENSOR", f"Make of the sensor: {listed(options.STARTERS)}.")],
    background: Annotated[
        Path, option("IMG|DIR", "The unit's gel at rest: an image, or a folder of several.")
    ],
    output: options.NewCalibration,
    bgr: options.Bgr = False,
    mm_per_px: options.MmPerPx = None,
    serial: Annotated[str | None, option("TEXT", "Serial number of the unit.")] = None,
    gel: Annotated[str | None, option("TEXT", "Name of its gel.")] = None,
    overwrite: options.Overwrite = False,
    shown: ShownOption,
) -> None:
    """Make a calibration of a sensor without any press.

    A starter is a general calibration of a make. The image of this unit's gel at rest adapts it to the unit's light.
    Slopes and depth may be off by some percent. Every result says so, and its standard deviations include it.
    For a better calibration, press a ball: gelform calibrate.

    \b
    Examples:
      gelform starter gelsight-mini --background rest.png -o unit.npz
      gelform starter digit --background rest/ -o unit.npz --serial D20123
      gelform reconstruct frame.png -c unit.npz -o out
    """
    one_of(sensor, options.STARTERS, "SENSOR")
    check_output(output, overwrite=overwrite)
    calibration = starter_calibration(
        sensor, background, bgr=bgr, mm_per_px=mm_per_px, serial=serial, gel_id=gel
    )
    calibration.save(output, overwrite=overwrite)
    for finding in calibration.findings:
        say(f"note: {finding.message}", shown.silent)
    shown.say(f"Wrote {output}.")
    described = calibration.describe()
    kept = ("sensor_name", "serial", "gel_id", "image_shape", "mm_per_px", "settings", "digest")
    shown.json({"calibration": str(output), **{key: described[key] for key in kept}})


def scale(
    *,
    place: Annotated[Path, argument("PLACE", "Press folder, its sensor.toml, or an imported calibration.")],
    points: Annotated[
        list[str] | None,
        option("X1,Y1,X2,Y2,MM", "Two marked points of the image, px, and their distance; may be repeated."),
    ] = None,
    stage: Annotated[
        list[str] | None,
        option("A,B,MM", "Two images of one object, and the stage's step between them; may be repeated."),
    ] = None,
    sensor: options.Sensor = None,
    background: options.Background = None,
    shown: ShownOption,
) -> None:
    """Measure mm per pixel, for `calibrate`.

    Writes the scale into the folder's sensor.toml, where `calibrate` reads it.

    The images are camera frames, read through the existing [view]. Several measurements are averaged, weighted by their
    uncertainty. If they contradict each other, nothing is written. Measure along x and along y: they show pixels that are
    not square.

    \b
    Examples:
      gelform scale presses/ --points 20,31.5,290,28,17.1
      gelform scale presses/ --points 20,31,290,31,17.1 --points 100,20,100,210,12
      gelform scale presses/ --stage left.png,right.png,4 --background rest.png
      gelform scale imported.npz --points 20,31.5,290,28,17.1
    """
    if not points and not stage:
        raise BadParameter("expected --points, --stage or both.", param_hint="scale")
    marked = [numbers(text, "X1,Y1,X2,Y2,MM", "--points") for text in points or ()]
    pressed = []
    for text in stage or ():
        *paths, length = text.split(",")
        if len(paths) != 2:
            raise BadParameter(f"expected A,B,MM, got {text!r}.", param_hint="--stage")
        pressed.append((map(Path, paths), numbers(length, "MM", "--stage")[0]))
    from gelform.calibration.geometry.files import read_setup, save_scale, stated_scale, width_note

    with mistakes_in("--points"):
        scales = [gelform.scale_from_points((x1, y1), (x2, y2), mm) for x1, y1, x2, y2, mm in marked]
    if pressed:
        setup = read_setup(place, background=background, sensor=sensor)
        with mistakes_in("--stage"):
            for images, step_mm in pressed:
                first, second = map(setup.image, images)
                scales.append(gelform.scale_from_stage(first, second, setup.background, step_mm))
    found = gelform.combined_scale(scales)
    before = stated_scale(place)
    written = save_scale(found, place)
    if doubt := width_note(found.mm_per_px, place):
        shown.say(f"note: {doubt}")
    shown.say(f"{found.mm_per_px:.5g} +- {found.sigma:.2g} mm per pixel, from {found.source}.")
    shown.say(f"Wrote {written}{'' if before is None else f', in the place of {before:.5g}'}.")
    measured = {"mm_per_px": found.mm_per_px, "mm_per_px_sigma": found.sigma}
    shown.json({"file": written, **measured, "source": found.source})


def lens(
    *,
    place: Place,
    images: Annotated[
        list[Path], Option("--image", metavar="IMG", help="Whole frame with the grid; may be repeated.")
    ],
    grid: Annotated[str, option("CxR", "Inner corners of the grid, such as 9x6; or its dots.")],
    pitch_mm: Annotated[float, number("Pitch of the grid, mm.")],
    dots: Annotated[bool, Option("--dots", help="The grid has dots, not a checkerboard.")] = False,
    background: Annotated[
        Path | None,
        Option("--background", metavar="IMG", help="Gel at rest, for --dots: the dots are imprints of pins."),
    ] = None,
    shown: ShownOption,
) -> None:
    """Measure the lens, so that `calibrate` undoes it.

    Measures distortion, perspective and scale. The first image shows a grid on the gel, printed or of pins that are pressed
    in. Further images, tilted or moved, improve the distortion only. The results are added to sensor.toml.

    \b
    Examples:
      gelform lens presses/ --image grid.png --grid 9x6 --pitch-mm 1
      gelform lens presses/sensor.toml --image flat.png --image tilted.png --grid 12x9 --pitch-mm 0.8 --dots
      gelform lens presses/ --image pins.png --background rest.png --grid 9x7 --pitch-mm 2 --dots
    """
    try:
        columns, rows = (int(count) for count in grid.split("x"))
    except ValueError:
        raise BadParameter(f"expected COLUMNSxROWS, got {grid!r}.", param_hint="--grid") from None
    from gelform.calibration.geometry.files import save_grid_view

    frames = [gelform.read_image(path) for path in images]
    rest = None if background is None else gelform.read_image(background)
    with mistakes_in("--image, --background, --grid"):
        found = gelform.view_from_grid(
            frames,
            pattern=(columns, rows),
            pitch_mm=pitch_mm,
            kind="dots" if dots else "checkerboard",
            background=rest,
        )
    file = save_grid_view(found, place)
    shown.say(f"{found.describe()}.")
    shown.say(f"Wrote {file}.")
    known = {"mm_per_px": found.scale.mm_per_px, "mm_per_px_sigma": found.scale.sigma}
    shown.json({"file": file, "lens": found.describe(), **known, "residual_px": found.residual_px})


def crosstalk(
    *,
    place: Place,
    led_frames: Annotated[
        tuple[Path, Path, Path], argument("R G B", "Gel at rest under the red, green, blue LEDs alone.")
    ],
    bgr: options.Bgr = False,
    shown: ShownOption,
) -> None:
    """Measure the crosstalk of the colors, for `calibrate`.

    Each of three images shows the gel at rest under the LEDs of one color only. Their light in the other channels is
    added to sensor.toml.

    \b
    Examples:
      gelform crosstalk presses/ red.png green.png blue.png
      gelform crosstalk presses/sensor.toml red.png green.png blue.png --json
    """
    from gelform.calibration.geometry.files import save_crosstalk
    from gelform.sensors.files import read_sensor_toml

    settings = read_sensor_toml(place / "sensor.toml" if place.is_dir() else place)
    with mistakes_in("R G B"):
        frames = [gelform.read_image(path, bgr=bgr) for path in led_frames]
        found = gelform.crosstalk_from_frames(frames, response=settings.response)
    file = save_crosstalk(found, place)
    shown.say(f"{found.describe()}.")
    shown.say(f"Wrote {file}.")
    shown.json({"file": file, "crosstalk": found.describe(), "matrix": found.matrix})
