"""gelform evaluate, compare, explain and measure: errors of calibrations, reasons for confidence, figures of shapes."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from typer import BadParameter

import gelform
from gelform import DataError
from gelform.cli import options
from gelform.cli.console import ShownOption, figure, mistakes_in, say
from gelform.cli.files import Inputs, check_output, make_folder, named, new_pictures, other_size

if TYPE_CHECKING:
    from gelform.arrays import Image

COLUMNS = {  # of the table, which fits into 80 columns
    "normal_free_deg": "normals °",
    "cap_free_um": "contact um",
    "radius_percent": "radius %",
    "off_contact_um": "off contact um",
}
PRESSES = "Errors of each press: normals, depth in contact, ball radius, depth off contact"
WORSE = 1.5  # times the errors at calibration; folds of the real sets differ by up to a third
COMPARED = {  # {u}: the unit of depth
    "image": "image",
    "peak_a": "peak A ({u})",
    "peak_b": "peak B ({u})",
    "difference_rms": "RMS of B - A ({u})",
    "angle_deg": "angle of A and B (°)",
    "curl_rms_a": "curl A (1/px)",
    "curl_rms_b": "curl B (1/px)",
}


def evaluate(
    *,
    presses: Annotated[Path, options.argument("PRESSES", "Folder of ball presses.")],
    calibration: options.CalibrationFile,
    given: options.PressOptions,
    shown: ShownOption,
) -> None:
    """Measure a calibration's errors on presses of a ball.

    Angles are in degrees, depth in um, the ball's radius in percent.

    Presses that were used for the calibration are marked, because their errors say little about new presses.

    \b
    Examples:
      gelform evaluate new_presses/ -c cal.npz
      gelform evaluate new_presses/ -c cal.npz --json > errors.json
      gelform evaluate frames/ -c cal.npz --sensor gelsight-mini --ball-diameter-mm 6.35
    """
    from gelform.calibration.report.record import FIGURES

    loaded = gelform.load_calibration(calibration)
    with shown.progress() as progress:
        press_set = gelform.read_presses(presses, **vars(given), progress=progress)
        sizes = list(dict.fromkeys([loaded.image_shape, loaded.view.frame_shape or loaded.image_shape]))
        if press_set.image_shape not in sizes:
            raise DataError(
                f"{press_set.folder}: Expected images of {other_size(press_set.image_shape, sizes)}"
            )
        evaluation = gelform.evaluate(loaded, press_set, progress=progress)
    if evaluation.seen:
        say(
            f"warning: the calibration was made from {evaluation.seen} of these presses. Their errors say little about new "
            "presses. They may even be larger than the held-out errors of `calibrate`, which fits all circles together; "
            "here each circle is found in its own image."
        )
    whose = "the calibration's own" if evaluation.own_background else "not the calibration's own"
    shown.say(f"Background: {whose}.")
    for message in evaluation.findings:
        say(f"warning: {message}")
    shown.json(evaluation.to_dict())
    rows = [
        (
            f"{row['name']}{' (used)' if row['seen'] else ''}",
            f"{row['ball_diameter_mm']:g}",
            *(row["errors"][name] if row["reason"] is None else None for name in COLUMNS),
        )
        for row in evaluation.rows
    ]
    shown.table(PRESSES, ("press", "ball mm", *COLUMNS.values()), rows)
    left_out = [(row["name"], row["reason"]) for row in evaluation.rows if row["reason"] is not None]
    shown.table("Rejected presses", ("press", "reason"), left_out)
    summary = [(FIGURES[name], value) for name, value in evaluation.summary.items()]
    shown.table("Over all presses", ("error", "value"), summary)
    _show_where(evaluation.where, shown)
    shown.say(verdict_of(evaluation.summary, loaded.held_out))
    heights = []
    for flat in evaluation.flats:
        height, read = flat["height_mm"], flat["read_mm"]
        measured = (None, None) if read is None else (f"{read:.3f}", 100 * read / height)
        heights.append((flat["name"], f"{height:g}", *measured))
    shown.table("Flat punches", ("press", "height (mm)", "measured (mm)", "measured/height (%)"), heights)


def verdict_of(found: Mapping[str, float], held_out: Mapping[str, Any]) -> str:
    """What the errors on presses mean beside those at calibration, and what to do."""
    now, then = found["normal_free_deg"], held_out.get("normal_free_deg")
    if not then:
        return f"Normals are off by {now:.2g}°. The calibration states no errors of its own to compare them with."
    times = now / then
    if times < WORSE:
        return f"Normals are off by {now:.2g}°: {'as' if times > 1 / WORSE else 'less than'} at calibration ({then:.2g}°)."
    return (
        f"Normals are off by {now:.2g}°: {times:.2g} times as much as at calibration ({then:.2g}°). Check that gel, "
        "light and ball are the same, and calibrate again."
    )


def _show_where(where: dict[str, Any], shown: ShownOption) -> None:
    """Show normal errors by the ball's slope and by place: inside the contact edge and up to the visible rim."""
    to_rim = {b["slope_from"]: b for b in where["rim"]["by_slope"]}
    edge = f"{where['contact_radius_ratio']:.2f} of the visible radius"
    title = f"Normal error, degrees, by the ball's slope (contact edge at {edge})"
    rows = [
        (
            f"{b['slope_from']:g}-{b['slope_to']:g}",
            b["normal_deg"],
            b["gain"],
            to_rim.get(b["slope_from"], {}).get("normal_deg"),
            b["pixels"],
        )
        for b in where["contact"]["by_slope"]
    ]
    shown.table(title, ("slope", "in the contact", "slope gain", "up to the rim", "pixels"), rows)
    places = where["contact"]["by_place"]
    cells = [
        f"{figure(whole)} / {figure(part)}"
        for whole, part in zip(places["normal_deg"], where["rim"]["by_place"]["normal_deg"])
    ]
    columns = places["columns"]
    grid = [tuple(cells[k : k + columns]) for k in range(0, len(cells), columns)]
    title = "Normal error, degrees, by place in the image: in the contact / up to the rim"
    shown.table(title, tuple(f"column {k + 1}" for k in range(columns)), grid)


def compare(
    *,
    images: options.Images,
    calibrations: Annotated[
        list[Path], options.calibration("A calibration; give the option twice, for A and B.")
    ],
    output: options.PictureFolder = None,
    background: options.Background = None,
    bgr: options.Bgr = False,
    overwrite: options.Overwrite = False,
    shown: ShownOption,
) -> None:
    """Compare two calibrations on the same images.

    Compares depth, normals and curl, and draws a picture of both.

    Depths are in mm, or in pixels if one calibration has no scale. The angle is the mean angle between the normals in the
    contact of either result. With -o, DIR/<image>.png shows both depths on one scale, their difference, and the profile
    through the deepest point.

    \b
    Examples:
      gelform compare frame.png -c mine.npz -c imported.npz -o side-by-side
      gelform compare session/ -c before.npz -c after.npz --json
    """
    if len(calibrations) != 2:
        raise BadParameter(f"expected two, got {len(calibrations)}.", param_hint="--calibration")
    given = Inputs(background=background, bgr=bgr)
    images = given.images(images)
    pictures = new_pictures(images, output, overwrite=overwrite, read=[*calibrations, background])
    pair = [given.reconstructor(gelform.load_calibration(path)) for path in calibrations]
    from gelform.exchange.plots import compare_results, comparison_picture

    def compared(path: Path) -> tuple[dict[str, Any], Callable[[], Image]]:
        seen = [given.image(path, run.calibration) for run in pair]
        with named(path):
            a, b = (run.from_image(image) for run, image in zip(pair, seen))
        names = (calibrations[0].stem, calibrations[1].stem)
        return compare_results(a, b).figures(), lambda: comparison_picture(a, b, seen[0], names=names)

    rows = _rows_of_images(pictures, compared, "comparing", shown, overwrite=overwrite)
    columns = {name: column.format(u=rows[0]["unit"]) for name, column in COMPARED.items()}
    shown.table("Comparison", columns, rows)
    _say_pictures(rows, output, shown)
    shown.json({"a": str(calibrations[0]), "b": str(calibrations[1]), "images": rows})


def measure(
    *,
    results: Annotated[list[Path], options.argument("RESULT...", "Results (.npz), or folders of them.")],
    line: Annotated[
        list[str] | None,
        options.option(
            "X1,Y1,X2,Y2", "Across a groove or ridge, px, from shoulder to shoulder; may be repeated."
        ),
    ] = None,
    region: Annotated[
        list[str] | None,
        options.option(
            "X1,Y1,X2,Y2", "Opposite corners of a region, px; may be repeated. Default: the contact."
        ),
    ] = None,
    radius: Annotated[str | None, options.option("ball|cylinder", "Fit one to each region.")] = None,
    csv: Annotated[Path | None, options.option("FILE", "Write the figures as a table.")] = None,
    output: options.PictureFolder = None,
    overwrite: options.Overwrite = False,
    shown: ShownOption,
) -> None:
    """Measure steps, grooves, radii, angles, roughness.

    Each figure has a standard deviation, and says what it does not hold for. A line gives its length, how much deeper its
    second end is, and the groove or ridge across it: depth or height, width at half of it, and the angles of its flanks. A
    region gives its depth, flatness and roughness; each further region its step from the first one, and the angle that both
    faces enclose. With -o, DIR/<result>.png shows the depth and the profile of each line.

    \b
    Examples:
      gelform measure out/frame.npz --line 120,80,200,80 -o measured
      gelform measure out/frame.npz --region 60,60,110,180 --region 200,60,250,180
      gelform measure out/*.npz --region 120,80,200,160 --radius ball --csv radii.csv
      gelform measure out/ --line 120,80,200,80 --json
    """
    from gelform.foundations.files import table_text, written_file
    from gelform.result.measure import RADII

    form = "X1,Y1,X2,Y2"
    given: dict[str, Any] = {
        "lines": [options.numbers(one, form, "--line") for one in line or ()],
        "regions": [options.numbers(one, form, "--region") for one in region or ()],
        "radius": radius and options.one_of(radius, RADII, "--radius"),
    }
    paths = [one for path in results for one in (sorted(path.rglob("*.npz")) if path.is_dir() else [path])]
    if not paths:
        raise DataError(
            f"Expected results (.npz) in {results[0]}, found none. Reconstruct images into it first."
        )
    pictures = new_pictures(paths, output, overwrite=overwrite, read=[csv])
    if csv is not None:
        check_output(csv, overwrite=overwrite)

    def measured(path: Path) -> tuple[dict[str, Any], Callable[[], Image]]:
        from gelform.exchange.plots import measured_picture

        result = gelform.load_result(path)
        with named(path), mistakes_in(path):
            found = gelform.measure(result, **given)
        if not found.quantities:
            raise DataError(f"{path}: Nothing touches the gel. Give a --line or a --region.")
        return {"figures": [asdict(one) for one in found.quantities], "all": found}, lambda: measured_picture(
            result, found
        )

    rows = _rows_of_images(pictures, measured, "measuring", shown, overwrite=overwrite, of="result")
    for row in rows:
        every = row.pop("all").quantities
        shown.table(row["result"], ("figure", "value"), [(one.of, str(one)) for one in every])
        for one in every:
            for said in one.doubts:
                shown.say(f"{one.of}, {one.name}: {said}")
    if csv is not None:
        names = ("of", "name", "value", "sigma", "unit")
        table = [
            (row["result"], *map(one.get, names), " ".join(one["doubts"]))
            for row in rows
            for one in row["figures"]
        ]
        with written_file(csv, overwrite=overwrite) as handle:
            handle.write(table_text([("result", *names, "doubts"), *table]).encode())
    _say_pictures(rows, output, shown)
    shown.json({"results": rows})


def explain(
    *,
    images: options.Images,
    given: Inputs,
    output: options.PictureFolder = None,
    overwrite: options.Overwrite = False,
    shown: ShownOption,
) -> None:
    """Explain the confidence of each pixel of an image.

    Lists the share of the slopes' variance from the usual noise of each slope, and from each cause: CAUSES. With -o,
    DIR/<image>.png shows the confidence, and the share of each cause, pixel by pixel.

    \b
    Examples:
      gelform explain frame.png -c cal.npz -o why
      gelform explain session/*.png -c cal.npz --json
      gelform explain frame.png --sensor digit --background rest.png -o why
      gelform explain frame.png -c cal.npz --background today_rest.png -o why --overwrite
    """
    images = given.images(images)
    read = (given.calibration, given.background)
    pictures = new_pictures(images, output, overwrite=overwrite, read=read)
    run = given.reconstructor(given.calibration_of(images, shown.silent))

    def explained(path: Path) -> tuple[dict[str, Any], Callable[[], Image]]:
        from gelform.exchange.plots import explanation_picture

        image = given.image(path, run.calibration)
        with named(path):
            explanation = run.explain(image)
        return explanation.to_dict(), lambda: explanation_picture(explanation, image)

    rows = _rows_of_images(pictures, explained, "explaining", shown, overwrite=overwrite)
    for row in rows:
        for finding in row["findings"]:
            say(f"{row['image']}: {finding['message']}", shown.silent)
    names = [name for name in rows[0]["variance_shares"] if any(row["variance_shares"][name] for row in rows)]
    table = [
        (
            row["image"],
            100 * row["trusted_share"],
            row["median_sigma"],
            *(100 * row["variance_shares"][name] for name in names),
        )
        for row in rows
    ]
    causes = ["usual noise" if name == "law" else name for name in names]
    columns = ("trusted pixels (%)", "median slope sigma (mm/mm)", *(f"{cause} (%)" for cause in causes))
    shown.table("Share of the slopes' variance", ("image", *columns), table)
    _say_pictures(rows, output, shown)
    shown.json({"calibration": given.calibration and str(given.calibration), "images": rows})


explain.__doc__ = (explain.__doc__ or "").replace("CAUSES", ", ".join(options.CAUSES))


def _rows_of_images(
    pictures: Sequence[tuple[Path, Path | None]],
    of_image: Callable[[Path], tuple[dict[str, Any], Callable[[], Image]]],
    what: str,
    shown: ShownOption,
    *,
    overwrite: bool,
    of: str = "image",
) -> list[dict[str, Any]]:
    """The figures of each image (or `of` another kind), and the path of its picture, which is drawn if there is one."""
    rows = []
    with shown.progress() as progress:
        for done, (image, picture) in enumerate(pictures):
            progress(done, len(pictures), what)
            figures, draw = of_image(image)
            if picture is not None:
                from gelform.exchange.plots import save_picture

                make_folder(picture.parent)
                save_picture(picture, draw(), overwrite=overwrite)
            rows.append({of: str(image), "picture": picture and str(picture), **figures})
        progress(len(pictures), len(pictures), what)
    return rows


def _say_pictures(rows: Sequence[Any], output: Path | None, shown: ShownOption) -> None:
    if output is not None:
        say(f"Wrote {len(rows)} {'picture' if len(rows) == 1 else 'pictures'} to {output}.", shown.silent)
