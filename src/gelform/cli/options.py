"""Options that several commands share, alone and in groups, the parsers of their values, and names for the help."""

from __future__ import annotations

import ast
import inspect
import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, fields, is_dataclass
from functools import wraps
from pathlib import Path
from typing import Annotated, Any, get_args, get_origin, get_type_hints

from typer import Argument, BadParameter, Option

from gelform.sensors.profiles import PROFILES

PACKAGE = Path(__file__).parents[1]


def names_in(file: str, table: str) -> tuple[str, ...]:
    """The keys of a dict literal in a file of the package, in its order; LookupError if there is none.

    `--help` must start at once, and the tables hold classes that need numpy, so the file is not imported.
    """
    for node in ast.parse((PACKAGE / file).read_text(encoding="utf-8")).body:
        if isinstance(node, ast.Assign | ast.AnnAssign) and isinstance(node.value, ast.Dict):
            target = node.target if isinstance(node, ast.AnnAssign) else node.targets[0]
            keys = [key.value for key in node.value.keys if isinstance(key, ast.Constant)]
            if isinstance(target, ast.Name) and target.id == table and len(keys) == len(node.value.keys):
                return tuple(str(key) for key in keys)
    raise LookupError(f"Expected a dict {table} with its keys written out in {file}.")


COLOR_MODELS = names_in("slopes/color_models/__init__.py", "COLOR_MODELS")
PACKAGES = names_in("exchange/importers.py", "PACKAGES")
LAYOUTS = names_in("simulate/presets.py", "LAYOUTS")
CAUSES = names_in("slopes/budget.py", "CAUSES")
FORMS = names_in("exchange/exporters/press_folder.py", "FORMS")
STARTERS = tuple(sorted(path.stem for path in (PACKAGE / "calibration" / "starters").glob("*.npz")))


def listed(names: tuple[str, ...]) -> str:
    """Names joined for a sentence: a, b or c."""
    return " or ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)


@contextmanager
def usage_errors(option: str | None = None) -> Iterator[None]:
    """Turn a ValueError about an option's value into a usage error that names the option."""
    try:
        yield
    except ValueError as problem:
        raise BadParameter(str(problem), param_hint=option) from problem


def positive(text: str) -> float:
    """Parse a finite number > 0 of an option."""
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if not (math.isfinite(number) and number > 0):
        pointed = text.replace(",", ".")
        remedy = f" Write it with a decimal point: {pointed}." if text.count(",") == 1 else ""
        raise BadParameter(f"expected a number > 0, got {text!r}.{remedy}")
    return number


def pitch(text: str) -> float:
    """Parse a sensor's pixel pitch, mm, of an option."""
    from gelform.foundations.checks import check_sensor_pitch  # imports numpy, too slow for --help

    with usage_errors():
        return check_sensor_pitch(positive(text))


def ball_diameter(text: str) -> float:
    """Parse a ball's diameter, mm, of an option."""
    from gelform.calibration.presses.press_set import check_ball_diameter

    with usage_errors():
        return check_ball_diameter(positive(text))


FILE_ENDINGS = (
    *(".npz", ".npy", ".png", ".jpg", ".jpeg", ".tif", ".tiff", ".csv", ".parquet", ".json", ".toml"),
    *(".html", ".pdf", ".zip", ".mcap", ".h5", ".hdf5", ".mp4", ".avi", ".ply", ".stl", ".x3p"),
)


def a_folder(path: Path | None) -> Path | None:
    """The name of a folder, which may be new; BadParameter if it is one of a file."""
    if path is not None and path.suffix.lower() in FILE_ENDINGS and not path.is_dir():
        raise BadParameter(f"expected a folder, got the name of a file: {path}. Leave out {path.suffix}.")
    return path


def argument(metavar: str, help: str) -> Any:
    """An argument, which the help calls `metavar`."""
    return Argument(metavar=metavar, help=help)


def option(metavar: str, help: str) -> Any:
    """An option named as its parameter, whose value the help calls `metavar`."""
    return Option(metavar=metavar, help=help, callback=a_folder if metavar == "DIR" else None)


def number(help: str, parser: Callable[[str], float] = positive) -> Any:
    """An option that takes a finite number > 0, or a value for another parser."""
    return Option(metavar="F", parser=parser, help=help)


def output(metavar: str, help: str) -> Any:
    """The option that names what a command writes."""
    return Option(
        "--output", "-o", metavar=metavar, help=help, callback=a_folder if metavar == "DIR" else None
    )


def calibration(help: str) -> Any:
    """The option that names a calibration to read."""
    return Option("--calibration", "-c", metavar="CAL.npz", help=help)


def numbers(text: str, form: str, option: str) -> tuple[float, ...]:
    """Numbers separated by commas, as many as the form (such as "X1,Y1,X2,Y2,MM") has parts."""
    try:
        found = tuple(float(part) for part in text.split(","))
    except ValueError:
        found = ()
    if len(found) != form.count(",") + 1 or not all(map(math.isfinite, found)):
        raise BadParameter(f"expected {form}, got {text!r}.", param_hint=option)
    return found


def names_from(text: str) -> tuple[str, ...]:
    """Names separated by commas, each once."""
    return tuple(dict.fromkeys(one.strip() for one in text.split(",") if one.strip()))


def one_of(name: str, known: tuple[str, ...], option: str) -> str:
    """The name, if it is a known one."""
    if name not in known:
        raise BadParameter(f"expected {listed(known)}, got {name!r}.", param_hint=option)
    return name


Quiet = Annotated[bool, Option("--quiet", "-q", help="Show neither progress nor tables.")]
Json = Annotated[bool, Option("--json", help="Print the numbers as JSON on standard output.")]
AcceptDoubtful = Annotated[
    bool, Option("--accept-doubtful", help="Exit with status 0 though the depth of most frames is doubtful.")
]
Overwrite = Annotated[bool, Option("--overwrite", help="Replace results that are already there.")]
Images = Annotated[list[Path], argument("IMAGE...", "Images of the sensor, or folders of them.")]
ResultFolder = Annotated[Path, output("DIR", "Folder for the results.")]
NewFolder = Annotated[Path, output("DIR", "A new or empty folder.")]
PictureFolder = Annotated[Path | None, output("DIR", "Folder for a picture of each image.")]
NewCalibration = Annotated[Path, output("CAL.npz", "The calibration to write.")]
CalibrationFile = Annotated[Path, calibration("The sensor's calibration.")]
OptionalCalibration = Annotated[
    Path | None, calibration("The sensor's calibration. Default: the library's newest of its serial.")
]
StarterSensor = Annotated[
    str | None,
    Option(
        "--sensor",
        metavar="NAME",
        help=f"For a sensor without a calibration: the starter of its make, {listed(STARTERS)}.",
    ),
]
Sensor = Annotated[str | None, option("PROFILE", f"Make, for crop and scale: {listed(tuple(PROFILES))}.")]
MmPerPx = Annotated[float | None, number("Width of an image pixel on the gel, mm.", pitch)]
Background = Annotated[
    Path | None, option("IMG|DIR", "Gel at rest: an image, or a folder of several to average.")
]
Bgr = Annotated[bool, Option("--bgr", help="The frames are blue, green, red, as OpenCV writes an array.")]
Dataset = Annotated[str, option("PATH", "Where frames are in HDF5, Zarr, LeRobot; * stands for one name.")]
Seconds = Annotated[float | None, number("Duration in seconds; else to the end or Ctrl-C.")]
Seed = Annotated[int, Option(min=0, help="Seed of the random numbers.")]


@dataclass(frozen=True)
class Reading:
    """How the frames of a source are read: keywords of `open_source`."""

    bgr: Bgr = False
    dataset: Dataset = ""


@dataclass(frozen=True)
class PressOptions:
    """Facts about presses that their folder may lack: keywords of `read_presses`."""

    sensor: Sensor = None
    mm_per_px: MmPerPx = None
    ball_diameter_mm: Annotated[
        float | None, number("Ball's diameter, mm, for a video or folder without presses.csv.", ball_diameter)
    ] = None
    background: Background = None
    bgr: Annotated[
        bool, Option("--bgr", help="All images, also the background, are blue, green, red, as in OpenCV.")
    ] = False
    dataset: Dataset = ""


def flat(function: Callable[..., None]) -> Callable[..., None]:
    """Flatten a command for typer: each field of a dataclass of options becomes a parameter."""
    parameters: list[inspect.Parameter] = []
    groups: dict[str, Any] = {}
    for parameter in _typed_parameters(function):
        if is_dataclass(parameter.annotation):
            groups[parameter.name] = parameter.annotation
            parameters += _typed_parameters(parameter.annotation)
        else:
            parameters.append(parameter)

    @wraps(function)
    def command(**given: Any) -> None:
        made = {
            name: kind(**{field.name: given.pop(field.name) for field in fields(kind)})
            for name, kind in groups.items()
        }
        function(**given, **made)

    command.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    command.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
    return command


def _typed_parameters(of: Any) -> list[inspect.Parameter]:
    """The parameters of a function or dataclass as keywords, with their types in the place of their types' text."""
    hints = get_type_hints(of, include_extras=True)
    return [
        one.replace(kind=one.KEYWORD_ONLY, annotation=as_written(hints[one.name]))
        for one in inspect.signature(of).parameters.values()
    ]


def as_written(hint: Any) -> Any:
    """An annotation without the Optional that Python 3.10 adds if the default is None.

    typer finds an option's names only if `Annotated` is outermost.
    """
    if get_origin(hint) is Annotated:
        return hint
    return next((one for one in get_args(hint) if get_origin(one) is Annotated), hint)
