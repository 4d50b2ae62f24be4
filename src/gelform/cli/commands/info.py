"""gelform info: what a file or folder is and what is missing, and facts of the machine for a bug report."""

from __future__ import annotations

import os
import platform
import re
import sys
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from importlib.metadata import PackageNotFoundError, requires, version
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from typer import BadParameter, Option

import gelform
from gelform import DataError, GelformError, result
from gelform.cli import options
from gelform.cli.console import in_options, print_json, show
from gelform.cli.options import Json, argument
from gelform.errors import counted

if TYPE_CHECKING:
    from gelform.sensors.playback import Film


def system_facts() -> dict[str, Any]:
    """Versions, processor, instruction set, extras and cameras of this machine."""
    core, extras = _requirements()
    of_speed = ("GELFORM_ISA", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS")  # or of the kernels
    return {
        "kind": "system",
        "gelform": gelform.__version__,
        "python": f"{platform.python_version()} ({platform.python_implementation()})",
        "system": platform.platform(),
        "processor": f"{platform.machine()}, {os.cpu_count()} cores",
        "kernels": _kernels(),
        "variables": {name: os.environ[name] for name in of_speed if name in os.environ},
        "packages": {name: _version(name) or "missing" for name in core},
        "opencv": _opencv(),
        "extras": {extra: _extra(names) for extra, names in extras.items()},
        "cameras": _cameras(),
    }


def _requirements() -> tuple[list[str], dict[str, list[str]]]:
    """Names of the packages that gelform always needs, and those of each extra, for this version of Python."""
    try:
        declared = requires("gelform") or []
    except PackageNotFoundError:  # a checkout that is only on the path
        declared = []
    core: list[str] = []
    extras: dict[str, list[str]] = {}
    for requirement in declared:
        found = re.fullmatch(r"(?P<name>[\w.-]+)[^;]*(?:;(?P<marker>.*))?", requirement)
        if found is None:
            continue
        marker = found["marker"] or ""
        compared = re.findall(r"python_version\s*(<|>=)\s*['\"](\d+)\.(\d+)['\"]", marker)
        if any(
            (sys.version_info < (int(major), int(minor))) != (sign == "<") for sign, major, minor in compared
        ):
            continue
        extra = re.search(r"extra\s*==\s*['\"]([\w-]+)['\"]", marker)
        if extra is None:
            core.append(found["name"])
        elif extra[1] not in ("dev", "docs"):  # for developers
            extras.setdefault(extra[1], []).append(found["name"])
    return core, extras


def _opencv() -> str:
    """Every installed distribution of OpenCV: all of them write the one folder cv2, and the last one installed wins."""
    kinds = ("opencv-python", "opencv-contrib-python")
    names = (*kinds, *(f"{kind}-headless" for kind in kinds))
    found = [f"{name} {known}" for name in names if (known := _version(name)) is not None]
    if len(found) < 2:
        return ", ".join(found) or "none that pip knows"
    return f"{', '.join(found)}: they overwrite each other's cv2, so cv2.imshow may be missing (docs/installing.md)"


def _version(package: str) -> str | None:
    try:
        return version(package)
    except PackageNotFoundError:
        return None


def _extra(names: Iterable[str]) -> str:
    """The versions of an extra's packages, or the missing ones."""
    found = {name: _version(name) for name in names}
    missing = [name for name, known in found.items() if known is None]
    if missing:
        return f"missing: {', '.join(missing)}"
    return ", ".join(f"{name} {known}" for name, known in found.items())


def _kernels() -> str:
    """The instruction set in use, or the reason why the kernels cannot be loaded."""
    from gelform._native import instruction_set, library

    try:
        chosen = instruction_set()
        library(chosen)
    except (GelformError, ValueError) as problem:
        return str(problem)
    return chosen


def _cameras() -> list[str]:
    """Name and USB id of each camera; no serial number, because it identifies a unit and perhaps its owner."""
    from gelform.sensors.cameras import cameras_there

    try:
        cameras = cameras_there()
    except (GelformError, OSError) as problem:
        return [f"not known: {problem}"]
    return [f"{one.name} ({one.usb_id or 'not on USB'}, {one.kind or 'no known sensor'})" for one in cameras]


Facts = Mapping[str, Any]
Lines = list[tuple[str, Any]]  # label and text; a line without a text is left out
HELD_OUT = {
    "normal_free_deg": "normals {:.1f}°",
    "radius_percent": "ball's radius {:.1f} %",
    "cap_free_um": "depth in contact {:.0f} um",
    "off_contact_um": "depth off contact {:.0f} um",
}
ROUGHNESS = (
    "Sa {Sa_um:.3g} um, Sq {Sq_um:.3g} um, Sz {Sz_um:.3g} um, Ssk {Ssk:.2f}, Sku {Sku:.2f}, Sdr {Sdr_percent:.3g} % of what "
    "is in contact (ISO 25178; form removed: {form}, S-filter {s_filter_mm:.2g} mm, L-filter {l_filter_mm:.2g} mm)"
)


def info(
    *,
    path: Annotated[
        Path | None, argument("FILE|FOLDER", "Calibration, result, image, video, press folder.")
    ] = None,
    dataset: options.Dataset = "",
    system: Annotated[
        bool, Option("--system", help="Describe this machine instead, for a bug report.")
    ] = False,
    as_json: Json = False,
) -> None:
    """Describe a file or folder, and list what is missing.

    It recognizes calibrations, results, images, videos, recordings, ROS 2 bags, tables, data sets (HDF5, Zarr, LeRobot)
    and folders of presses.

    \b
    Examples:
      gelform info cal.npz
      gelform info out/frame.npz --json
      gelform info presses/
      gelform info presses.avi
      gelform info demos.hdf5 --dataset "data/*/obs/gelsight"
      gelform info session.mcap
      gelform info press_bag/
      gelform info --system --json
    """
    from gelform.sensors.containers import is_data_set

    if (path is None) != system:
        raise BadParameter("Expected a file or folder, or --system, and not both.")
    if path is None:
        facts = system_facts()
    elif path.exists() and (dataset or is_data_set(path)):
        facts = _data_set(path, dataset)
    elif path.exists():
        facts = _folder(path) if path.is_dir() else _file(path)
    else:
        raise DataError(f"No file or folder {path}. Check the path.")
    if as_json:
        print_json(facts)
        return
    lines = lines_of(facts)
    width = max(len(label) for label, _ in lines)
    for label, text in lines:
        show(f"{label:<{width}}  {text}")


def _file(path: Path) -> dict[str, Any]:
    from gelform.calibration_file import KIND as CALIBRATION
    from gelform.foundations.files import kind_of_npz, way_for

    kind = kind_of_npz(path)
    if kind == CALIBRATION:
        described = gelform.load_calibration(path).describe()
        described.pop("training_digests")
        presses = described["settings"].get("presses", 0)
        return {"kind": "calibration", **described, "training_presses": presses}
    if kind == result.KIND:
        return _result(path)
    if path.suffix.lower() == ".mcap":
        return _recording(path)
    from gelform.calibration.presses.folder import TAXIM, VIDEO, kind_of_presses
    from gelform.calibration.presses.press_set import table_rows
    from gelform.sensors.files import images_of_stack, is_stack, read_toml
    from gelform.sensors.pictures import IMAGE_SUFFIXES

    if path.suffix.lower() == ".csv":
        rows = [row for _, row in table_rows(path, ())]
        return {"kind": "table", "columns": list(rows[0]) if rows else [], "rows": len(rows)}
    if path.suffix.lower() == ".toml":
        return {
            "kind": "settings",
            **{f"[{name}]": value for name, value in read_toml(path, "settings").items()},
        }
    layout = kind_of_presses(path)
    if layout == VIDEO:
        video = gelform.Video(path)
        return _film(video, "video", [video.camera.settings[side] for side in ("height", "width")])
    if layout == TAXIM:
        return _presses(path, layout)
    if path.suffix == ".npz":
        raise DataError(
            f"{path} is neither a calibration nor a result of gelform's, or it is damaged.{way_for(path)}"
        )
    if is_stack(path):
        one, count = images_of_stack(path)
        return {"kind": "file of several images", "size_px": list(one(0).shape[:2]), "frames": count}
    try:
        image = gelform.read_image(path)
    except DataError as problem:
        if path.suffix.lower() in ("", ".npy", *IMAGE_SUFFIXES):
            raise
        raise DataError(
            f"Expected a calibration, result, image, video, recording, data set or table (.csv), got {path}, which is "
            f"none of them.{way_for(path)}"
        ) from problem
    levels = [round(float(level), 1) for level in image.mean(axis=(0, 1))]
    return {"kind": "image", "size_px": list(image.shape[:2]), "mean_rgb": levels}


def _data_set(path: Path, dataset: str) -> dict[str, Any]:
    """The datasets of frames in an HDF5 file or a Zarr store, the cameras of a LeRobot data set; or the frames of one."""
    from gelform.sensors.containers import frames_inside, is_lerobot_set, is_zarr
    from gelform.sensors.films import open_film

    if dataset:
        film = open_film(path, dataset=dataset, scan=True)
        return _film(film, f"frames of {dataset}", film[0].image.shape[:2])
    kind = "LeRobot data set" if is_lerobot_set(path) else "Zarr store" if is_zarr(path) else "HDF5 file"
    return {"kind": kind, "frames": frames_inside(path) or "no dataset of frames (N, H, W, 3)"}


def _recording(path: Path) -> dict[str, Any]:
    """The facts of a recording; its frames are counted, but not decoded."""
    from gelform.sensors.mcap import CUT, Recording, end_missing

    recording = Recording(path)
    facts, times_s = recording.camera, recording.times_s
    cut = f"no: its recorder was killed, or it was copied in part. {CUT}"
    return {
        "kind": "recording",
        "camera": facts.name,
        "serial": facts.serial,
        "frames": len(times_s),
        "duration_s": times_s[-1] if times_s else 0.0,
        "finished": cut if end_missing(path) else "yes",
        "settings": dict(facts.settings),
        "calibration": facts.calibration_digest,
        "gelform": facts.library_version,
    }


def _result(path: Path) -> dict[str, Any]:
    loaded = gelform.load_result(path)
    numbers, unit = loaded.numbers, "depth_mm" if loaded.mm_per_px is not None else "depth_px"
    return {
        "kind": "result",
        "size_px": list(loaded.shape),
        "mm_per_px": loaded.mm_per_px,
        "mm_per_px_sigma": loaded.mm_per_px_sigma,
        unit: numbers and [round(numbers.lowest, 4), round(numbers.peak, 4)],
        "at_least": numbers is not None and numbers.at_least,
        "contact_px": int(loaded.contact.sum()),
        "contacts": [asdict(contact) for contact in loaded.contacts],
        "roughness": _roughness(loaded),
        "markers": None if loaded.markers is None else loaded.markers.facts(),
        "known_px": int(loaded.known.sum()),
        "zero": loaded.zero,
        "solver": loaded.solver,
        "curl_rms": loaded.curl_rms,
        "findings": [finding.message for finding in loaded.health],
        "calibration": loaded.calibration_digest,
    }


def _roughness(found: gelform.Reconstruction) -> dict[str, Any] | None:
    """The roughness of the contact by ISO 25178; None without a scale or if the contact is too small."""
    from gelform.result.metrics import LEAST_PX, areal_roughness

    inside = found.contact & found.known
    if not isinstance(found.mm_per_px, float) or int(inside.sum()) < LEAST_PX:
        return None
    figures = asdict(areal_roughness(found.depth_mm, mm_per_px=found.mm_per_px, mask=inside))
    return {name: round(value, 4) if isinstance(value, float) else value for name, value in figures.items()}


def _film(film: Film, kind: str, size_px: Sequence[float | str]) -> dict[str, Any]:
    """The facts that a video or a data set states; calibration finds the presses."""
    rate_hz = film.camera.rate_hz or 0.0
    missing = ["the ball's diameter (--ball-diameter-mm)"]
    if not ((film.path if film.path.is_dir() else film.path.parent) / "sensor.toml").is_file():
        missing.append("the scale (--mm-per-px or --sensor)")
    return {
        "kind": kind,
        "size_px": [int(side) for side in size_px],
        "frames": film.count,
        "frame_rate_hz": rate_hz,
        "duration_s": film.count / rate_hz if rate_hz else None,
        "missing": missing,
    }


def _folder(path: Path) -> dict[str, Any]:
    """The facts of a bag or presses; for any other folder, the files that would make it a press folder."""
    from gelform.batch.records import MANIFEST
    from gelform.calibration.presses.folder import PLAIN, PRESS_FOLDER, kind_of_presses, rows_by_folder
    from gelform.foundations.files import kind_of_npz
    from gelform.sensors.files import likely_background
    from gelform.sensors.mcap import is_bag_folder
    from gelform.sensors.pictures import IMAGE_SUFFIXES

    if is_bag_folder(path):
        return _bag(path)
    layout = kind_of_presses(path)
    if layout not in (PRESS_FOLDER, PLAIN):
        return _presses(path, layout)
    here = {Path(entry.name) for entry in path.iterdir()}
    if {Path(MANIFEST), Path("parts")} <= here:
        return {"kind": "output of gelform batch", "check": f"gelform verify {path}"}
    results = sum(kind_of_npz(path / name) == result.KIND for name in here if name.suffix == ".npz")
    if results and not any(name.stem == "background" or name.name == "presses.csv" for name in here):
        return {"kind": "folder of results", "results": results, "of each": f"gelform info {path}/NAME.npz"}
    missing = []
    if not any(name.stem == "background" for name in here):
        likely = in_options(likely_background(path))
        missing.append(f"background.png, an image of the gel at rest (or --background). {likely}".strip())
    suggested = rows_by_folder(path) if layout == PLAIN else []
    if suggested:
        missing.append("presses.csv with these lines, if the names of the folders are the balls' diameters")
    elif layout == PLAIN:
        missing.append("presses.csv with the columns image,ball_diameter_mm (or --ball-diameter-mm)")
    if Path("sensor.toml") not in here:
        missing.append("sensor.toml with name and mm_per_px (or --sensor, --mm-per-px)")
    if not missing:
        return _presses(path, layout)
    images = sum(name.suffix.lower() in IMAGE_SUFFIXES for name in here)
    lines = {"presses.csv": suggested} if suggested else {}
    return {"kind": layout, "images_here": images, "missing": missing, **lines}


def _bag(path: Path) -> dict[str, Any]:
    """The topics with their numbers of messages; an error of the reader is listed as missing."""
    from gelform.sensors.mcap import mcap_file_in, mcap_records

    facts: dict[str, Any] = {"kind": "bag of ROS 2"}
    try:
        file = mcap_file_in(path)
        topics = Counter(topic for topic, _, one in mcap_records(file) if type(one).__name__ == "Message")
    except GelformError as problem:
        return {**facts, "missing": [str(problem)]}
    return {**facts, "file": file.name, "messages": dict(sorted(topics.items()))}


def _presses(path: Path, layout: str | None) -> dict[str, Any]:
    """The presses as calibration reads them; an error of the reader is listed as missing."""
    from gelform.calibration.circles.locate import count_presses

    try:
        presses = gelform.read_presses(path)
        different = count_presses(presses)
    except GelformError as problem:
        return {"kind": layout, "missing": [str(problem)]}
    balls = Counter(press.ball_diameter_mm for press in presses.presses)
    return {
        "kind": layout,
        "sensor": presses.sensor_name,
        "size_px": list(presses.image_shape),
        "mm_per_px": presses.mm_per_px,
        "images": len(presses.presses),
        "presses": different,
        "balls_mm": {f"{ball:g}": count for ball, count in sorted(balls.items())},
        "labelled": sum(press.label is not None for press in presses.presses),
        "missing": ["nothing: gelform calibrate can read it"],
    }


def lines_of(facts: Facts) -> Lines:
    """(label, text) of each line with a text; an unknown kind of file is listed unchanged."""
    of_kind = {"calibration": _calibration_lines, "result": _result_lines, "system": _system_lines}
    lines = of_kind.get(facts["kind"], _plain_lines)(facts)
    return [("kind", str(facts["kind"])), *((label, str(text)) for label, text in lines if text)]


def _calibration_lines(facts: Facts) -> Lines:
    settings = ", ".join(
        f"{name} {_said(value)}"
        for name, value in (facts.get("model_settings") or {}).items()
        if name != "shape"  # part of the line about images
    )
    held_out = facts.get("held_out") or {}
    figures = [form.format(held_out[name]) for name, form in HELD_OUT.items() if name in held_out]
    force = (facts.get("force") or {}).get("normal")
    noise, sigma = "not known", facts.get("slope_sigma")
    if sigma:  # the figures by slope, which --json has, are factors where the color model has a step
        camera = " without the camera's noise" if sigma["rest_per_noise"] else ""
        contact = f"{sigma['full_confidence_sigma']:.2g} mm/mm in 95 % of a contact"
        noise = f"{sigma['rest']:.2g} mm/mm at rest{camera}, at most {contact}"
    return [
        ("sensor", facts["sensor_name"]),
        ("serial", facts.get("serial")),
        ("gel", facts.get("gel_id")),
        ("images", f"{_size(facts['image_shape'])}, {_scale(facts)}"),
        ("view", _said(facts["view"]) if facts.get("view") else "none: a frame is used as the image"),
        ("color model", f"{facts['color_model']} ({settings})" if settings else facts["color_model"]),
        *_made_from(facts),
        ("held out", ", ".join(figures) or "no errors on held-out presses are known"),
        ("slope noise", noise),
        ("force", force and f"{counted(force['loads'], 'load')} up to {force['range'][1]:.3g} N"),
        ("made", f"{facts['created_utc']}, by gelform {facts['library_version']}"),
        ("digest", facts["digest"]),
    ]


def _made_from(facts: Facts) -> Lines:
    """The origin of a calibration; for a starter also the make, and the spread between units."""
    starter = facts["settings"].get("starter")
    if starter is None:
        presses = facts["training_presses"]
        return [
            ("made from", counted(presses, "press") if presses else "no presses: imported"),
            *_doubts(facts),
        ]
    return [
        (
            "starter",
            f"starter of the make {starter['sensor']}: no presses of this unit, but its background image",
        ),
        ("made from", "; ".join(starter["units"])),
        (
            "spread",
            f"slopes of a unit are within {100 * starter['spread']:.0f} % of the starter's (one standard deviation)",
        ),
        *_doubts(facts),
    ]


def _doubts(facts: Facts) -> Lines:
    return [("warning", message) for _, message, _ in facts["settings"].get("findings") or ()]


def _result_lines(facts: Facts) -> Lines:
    unit = "mm" if "depth_mm" in facts else "px"
    depth, roughness, markers = facts[f"depth_{unit}"], facts.get("roughness"), facts["markers"]
    deepest = "at least " if facts["at_least"] else ""
    low_to_high = "unknown" if depth is None else f"{depth[0]:.3f} to {deepest}{depth[1]:.3f} {unit}"
    pixels = facts["size_px"][0] * facts["size_px"][1]
    largest = facts["contacts"][:8]
    more = len(facts["contacts"]) - len(largest)
    return [
        ("image", f"{_size(facts['size_px'])}, {_scale(facts)}"),
        ("depth", f"{low_to_high}, 0 at rest, zero by: {facts['zero']}"),
        ("contact", f"{facts['contact_px']} of {pixels} px"),
        *[(f"contact {k + 1}", _contact(contact)) for k, contact in enumerate(largest)],
        ("contacts", more and f"{counted(more, 'smaller one')} more (--json gives all)"),
        ("roughness", roughness and ROUGHNESS.format(**roughness)),
        ("markers", markers and markers["in_words"]),
        ("known", f"{100 * facts['known_px'] / pixels:.0f} % of the pixels; the others are filled"),
        ("solver", f"{facts['solver']}, curl of the slopes {facts['curl_rms']:.3g} per px (RMS)"),
        *[("warning", message) for message in facts["findings"]],
        ("calibration", facts["calibration"]),
    ]


def _contact(contact: Facts) -> str:
    x, y = contact["deepest_px"]
    cut = ", cut by the image's border" if contact["cut_by_border"] else ""
    if contact["area_mm2"] is None:
        return f"{contact['area_px']} px, deepest at ({x}, {y}){cut}"
    major, minor = contact["axes_mm"]
    deepest = "at least " if contact["at_least"] else ""
    return (
        f"{contact['area_mm2']:.2f} mm², {contact['volume_mm3']:.3g} mm³, axes {major:.2f} x {minor:.2f} mm, "
        f"{deepest}{contact['deepest_mm']:.3f} mm deep at ({x}, {y}){cut}"
    )


def _plain_lines(facts: Facts) -> Lines:
    lines: Lines = []
    for name, value in facts.items():
        if name in ("missing", "presses.csv"):
            lines += [(name, one) for one in value]
        elif name.endswith("size_px"):
            lines.append(("size", _size(value)))
        elif name != "kind":
            lines.append((name.replace("_", " "), _said(value)))
    return lines


def _system_lines(facts: Facts) -> Lines:
    """One line per fact; several lines for facts with several values."""
    lines: Lines = []
    for name, value in facts.items():
        if isinstance(value, dict):
            lines += value.items()
        elif isinstance(value, list):
            lines += [("camera", one) for one in value or ["none"]]
        elif name != "kind":
            lines.append((name, value))
    return lines


def _size(shape: Any) -> str:
    return f"{shape[0]}x{shape[1]} px (height x width)"


def _scale(facts: Facts) -> str:
    pitch, sigma = facts.get("mm_per_px"), facts.get("mm_per_px_sigma")
    if pitch is None:
        return "scale unknown: depth in pixels"
    return f"{_said(pitch)} mm per pixel" + (f" +- {sigma:.2g}" if sigma else ", uncertainty unknown")


def _said(value: Any) -> str:
    from gelform.calibration.report.record import setting_in_words  # imports numpy, too slow for --help

    return setting_in_words(value)
