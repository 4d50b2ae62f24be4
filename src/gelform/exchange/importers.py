"""Files of other packages: look-up tables and networks as a Calibration, and Taxim's tables as a look for simulation.

Look-up tables from color difference to gradients (`table_smooth.npy`, and MATLAB's `LookupTable` in a `.mat`) are in the
tradition of Dong and Yuan (W. Yuan, S. Dong, E. H. Adelson, GelSight: high-resolution robot tactile sensors, Sensors
17(12), 2017). Taxim's tables (`polycalib.npz`) bin slopes by angle and direction. Each bin has a quadratic polynomial of
the pixel's place for each channel's change in gray levels (Z. Si and W. Yuan, Taxim: an example-based simulation model for
GelSight tactile sensors, RA-L 2022).
"""

from __future__ import annotations

import pickletools
import re
import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import astuple, dataclass
from datetime import datetime, timezone
from io import BytesIO
from itertools import pairwise
from os import PathLike
from pathlib import Path
from pickle import UnpicklingError
from typing import Any
from zipfile import ZipFile

import numpy as np
import scipy  # its parts load at first use
from numpy.typing import ArrayLike

from gelform import View, __version__, image_from_frame
from gelform.arrays import Array, Map, Numbers
from gelform.calibration_file import Calibration, CalibrationSettings
from gelform.errors import DataError, Finding, needed, said
from gelform.foundations.checks import (
    check_choice,
    check_image,
    check_is,
    check_numbers,
    check_path,
    check_positive,
    check_sensor_pitch,
)
from gelform.foundations.files import (
    DAMAGED_ARCHIVE,
    MAX_ARRAY_BYTES,
    bytes_of,
    checked_archive,
    names_in,
    present_file,
    read_npy,
)
from gelform.image.background import ChangeSettings, noise_from_image
from gelform.sensors.profiles import SENSORS, check_gel_width, make_of, view_from_camera
from gelform.slopes.color_models import ColorModel, LookupModel, NetworkModel
from gelform.slopes.color_models.networks import Layers

RANGE_LEVELS = (-90.0, 90.0)  # gray levels, the usual range of differences in a look-up table without one
MOST_LEVELS = 1024.0  # gray levels, the widest range of differences
HEIGHT, WIDTH = 480, 640  # px, size of the images whose pixels Taxim's polynomials use
STEEPEST = np.pi / 2  # mm/mm, of a table: programs of MATLAB's take the angle as slope, which is under pi/2
MEMBERS = ("bins", "grad_b", "grad_g", "grad_r")  # "r" is channel 0 of an OpenCV image, which is blue
_DAMAGED = (OSError, *DAMAGED_ARCHIVE, ValueError, AttributeError, TypeError)


def read_lut(
    path: str | PathLike[str],
    background: Map,
    *,
    depth_sign: int = 1,
    range_levels: Sequence[float] | None = None,
) -> LookupModel:
    """A table (bins, bins, bins, 2) of gradients (gx, gy), indexed by the blue, green and red difference.

    The images are blurred by 3x3 px; their difference is multiplied by 1 + 2 (mean(I0)/I0 - 1). Values hold at the
    bins' centers, with linear interpolation between them. The table's gradient for no difference is subtracted. The
    file does not state its accuracy, so no standard deviation is given.

    A `.mat` has MATLAB's struct LookupTable, whose slope angles GradMag and directions GradDir become gradients, and
    states its range. The differences of a `.npy` span `range_levels` in each channel, (low, high) in gray levels, or three
    such pairs in a row, for blue, green and red; -90 to 90 by default. `depth_sign` is 1 if the table's surface rises where
    pressed, -1 if it falls.

    Slopes over pi/2 become that (`STEEPEST`).

    DataError: the file is missing, no such table, or damaged. ValueError: the range is none, or is given for a `.mat`.
    """
    return _lut(path, background, depth_sign, range_levels)[0]


def _lut(
    path: str | PathLike[str], background: Map, depth_sign: int, range_levels: Sequence[float] | None
) -> tuple[LookupModel, float, tuple[Finding, ...]]:
    """A table (`read_lut`), the steepest slope in its file, and a finding if that is beyond `STEEPEST`."""
    if depth_sign not in (1, -1):
        raise ValueError(f"Expected depth_sign 1 or -1, got {depth_sign}.")
    if is_matlab(path):
        if range_levels is not None:
            raise ValueError(f"Expected no range for {path}, which states its own: leave --range out.")
        fields = _matlab(path)
        magnitude, direction = fields["GradMag"], fields["GradDir"]
        slopes = np.tan(magnitude)[..., None] * np.stack([np.cos(direction), np.sin(direction)], axis=-1)
        step = np.full(3, fields["Scale"] / (len(slopes) - 1))
        low = np.full(3, fields["Zeropoint"])
    else:
        array = read_npy(path, "a look-up table")
        shape = array.shape
        if len(shape) != 4 or shape[3] != 2 or len(set(shape[:3])) != 1 or not 4 <= shape[0] <= 200:
            raise DataError(f"Expected a table of shape (bins, bins, bins, 2) in {path}, got {shape}.")
        if not np.issubdtype(array.dtype, np.floating) or not np.isfinite(array).all():
            raise DataError(f"Expected finite floats in {path}, got {array.dtype} or NaN.")
        slopes = array.astype(np.float64).transpose(2, 1, 0, 3)  # to red, green, blue
        low, high = _ranges(range_levels)
        step = (high - low) / len(slopes)
    steep = np.linalg.norm(slopes, axis=-1, keepdims=True)
    slopes *= np.minimum(1, STEEPEST / np.maximum(steep, STEEPEST))
    unknown = np.zeros((*slopes.shape[:3], 1))
    table = np.concatenate([depth_sign * slopes, unknown], axis=-1)[None, None].astype(np.float32)
    height, width = background.shape[:2]
    model = LookupModel(table, low + step / 2, step, (height, width), "mean_over_background", background)
    return model, float(steep.max()), _steep_table(steep)


def _steep_table(steep: Numbers) -> tuple[Finding, ...]:
    beyond, steepest = float(np.mean(steep > STEEPEST)), float(steep.max())
    if not beyond:
        return ()
    message = (
        f"The table states slopes of up to {steepest:.3g} ({np.degrees(np.arctan(steepest)):.0f}°), {100 * beyond:.2g} % of "
        f"them over {STEEPEST:.2f} ({np.degrees(np.arctan(STEEPEST)):.0f}°), which no gel follows: these are read as "
        f"{STEEPEST:.2f}. Circles were probably marked too wide, or the ball stated too small, so that depth is too large. "
        "Measure it: gelform evaluate PRESSES -c CAL.npz."
    )
    return (Finding("steep_table", message, steepest),)


def _ranges(given: Sequence[float] | None) -> tuple[Numbers, Numbers]:
    """Lowest and highest difference (3,) of red, green and blue."""
    given = RANGE_LEVELS if given is None else given
    numbers = check_numbers(given, "range_levels", 6 if len(given) > 2 else 2)
    # Blue, green, red to red, green, blue.
    pairs = np.broadcast_to(np.reshape(numbers, (-1, 2)), (3, 2))[::-1]
    if not ((pairs[:, 0] < 0) & (pairs[:, 1] > 0) & (abs(pairs) <= MOST_LEVELS).all(axis=1)).all():
        raise ValueError(
            f"Expected range_levels (--range) as a low difference below 0 and a high one above, gray levels, got {given}."
        )
    return pairs[:, 0].copy(), pairs[:, 1].copy()


def is_matlab(path: str | PathLike[str]) -> bool:
    """Whether a look-up table is a file of MATLAB, by its name."""
    return Path(path).suffix.lower() == ".mat"


def mm_per_px_of_lut(path: str | PathLike[str], image_shape: tuple[int, int]) -> float | None:
    """The scale that MATLAB's table states for images (H, W) of its frames, or of their middle; None if it states none.

    DataError: it is of frames of another size.
    """
    if not is_matlab(path) or "Pixmm" not in (fields := _matlab(path)):
        return None
    frame = np.atleast_1d(fields.get("FrameSize", image_shape)).ravel()[:2]
    cut = frame - np.array(image_shape)
    if len(frame) != 2 or cut[0] != cut[1] or cut[0] < 0:
        raise DataError(
            f"{path} states {fields['Pixmm']:g} mm per pixel of frames of {'x'.join(f'{size:g}' for size in frame)} px, and "
            f"the background is {image_shape[0]}x{image_shape[1]} px. Give the scale of these images: --mm-per-px."
        )
    return check_positive(fields["Pixmm"], f"Pixmm of {path}")


def _matlab(path: str | PathLike[str]) -> dict[str, Any]:
    """The fields of the struct LookupTable in a file of MATLAB: arrays, and one number each as float."""
    content = bytes_of(Path(path), "a look-up table (.mat)", MAX_ARRAY_BYTES)
    if content[:10] == b"MATLAB 7.3":
        raise DataError(
            f"{path} is of MATLAB's format 7.3. Save it in MATLAB with: save file.mat LookupTable -v7"
        )
    try:
        _check_inflated(content)
        table = scipy.io.loadmat(BytesIO(content), variable_names=["LookupTable"])["LookupTable"][0, 0]
        arrays = {name: np.asarray(table[name], dtype=np.float64) for name in table.dtype.names}
    except KeyError:
        raise DataError(f"Expected a struct LookupTable in {path}, got none.") from None
    except (Exception, MemoryError) as problem:  # scipy's reader raises many kinds on damaged bytes
        raise DataError(
            f"{path} is no file of MATLAB with a LookupTable, or a damaged one: {said(problem)}."
        ) from problem
    fields: dict[str, Any] = {name: one.item() if one.size == 1 else one for name, one in arrays.items()}
    wanted = ("bins", "GradMag", "GradDir", "Zeropoint", "Scale")
    missing = [name for name in wanted if name not in fields]
    if missing:
        raise DataError(
            f"Expected the fields {', '.join(wanted)} in LookupTable of {path}, got no {', '.join(missing)}."
        )
    magnitude, direction, zero, scale = (fields[name] for name in wanted[1:])
    shape = np.shape(magnitude)
    are_cubes = len(shape) == 3 and shape == np.shape(direction) == (shape[:1] * 3)
    if (
        not (are_cubes and 4 <= shape[0] <= 200 and fields["bins"] == shape[0])
        or not np.isfinite([magnitude, direction]).all()
        or abs(magnitude).max() >= STEEPEST
    ):
        raise DataError(
            f"Expected GradMag (angles under pi/2) and GradDir of shape (bins, bins, bins) in {path}, got {shape}."
        )
    # Older programs divide by the background first, and have a scale of 0.005.
    if np.ndim(zero) or np.ndim(scale) or not (10 <= scale <= MOST_LEVELS and -scale < zero < 0):
        raise DataError(
            f"Expected Zeropoint and Scale of {path} in gray levels, such as -90 and 180, got {zero} and {scale}. gelform "
            "reads tables of gray-level differences (matchGrad_Bnz), none of differences over the background (matchGrad)."
        )
    return fields


def _check_inflated(content: bytes) -> None:
    """ValueError: a variable in a file of MATLAB takes more memory than a table can need."""
    at, left = 128, MAX_ARRAY_BYTES
    while at + 8 <= len(content):
        kind, size = np.frombuffer(content, "<u4", 2, at)
        if kind == 15:  # compressed (MAT-file format, level 5)
            inflate = zlib.decompressobj()
            left -= len(inflate.decompress(content[at + 8 : at + 8 + int(size)], left + 1))
            if left < 0:
                raise ValueError(f"it takes more than {MAX_ARRAY_BYTES >> 20} MB")
        at += 8 + int(size)


@dataclass(frozen=True, eq=False)
class TaximTables:
    """A forward model in Taxim's form."""

    # (bins, bins, 3, 6) float64: by slope angle (0 to 90 degrees) and direction (-180 to 180), for red, green and
    # blue: the factors of x^2, y^2, x y, x, y, 1 in pixels of an image of 480x640.
    table: Numbers
    name: str = "Taxim tables"

    def level_change(self, gradients: Array, *, as_level: bool = False) -> Numbers:
        """Change in gray levels (H, W, 3) for slopes (H, W, 2) of an image of the whole gel, in the tables' bins.

        With `as_level`, as if each slope were 0 in its own direction.
        """
        height, width = gradients.shape[:2]
        last = len(self.table) - 1
        p, q = np.moveaxis(np.asarray(gradients, dtype=np.float64), -1, 0)
        angle = np.zeros((height, width)) if as_level else np.arctan(np.hypot(p, q))
        steepness = np.floor(angle / (np.pi / 2 / last)).astype(np.intp)
        direction = np.floor((np.arctan2(q, p) + np.pi) / (2 * np.pi / last)).astype(np.intp)
        x = np.broadcast_to((np.arange(width) + 0.5) * (WIDTH / width) - 0.5, (height, width))
        y = np.broadcast_to(((np.arange(height) + 0.5) * (HEIGHT / height) - 0.5)[:, None], (height, width))
        place = np.stack([x**2, y**2, x * y, x, y, np.ones_like(x)], axis=-1)
        change = np.einsum("hwck,hwk->hwc", self.table[steepness, direction], place)
        return np.asarray(change, dtype=np.float64)


@dataclass(frozen=True, eq=False)
class TaximLook:
    """Taxim's tables on a background image: a look for `gelform.simulate.press.Twin`.

    The tables were fitted inside contacts, where level gel has another color than at rest. Their color of level gel is
    therefore faded in over the first 0.1 mm of depth. Gel at rest keeps its background.

    Attributes
    ----------
    tables : from `read_taxim_forward`
    background : (H, W, 3) float32, 4:3 as the tables, oriented as the images of their calibration
    mm_per_px : of this image; the tables contain no scale
    noise : (3,) gray levels
    """

    tables: TaximTables
    background: Map
    mm_per_px: float
    noise: Numbers

    def __post_init__(self) -> None:
        check_positive(self.mm_per_px, "mm_per_px")
        shape = np.shape(self.background)
        if len(shape) != 3 or shape[2] != 3 or abs(shape[1] / shape[0] * HEIGHT / WIDTH - 1) > 0.02:
            raise ValueError(
                f"Expected a background of shape (H, W, 3) with W/H = 4/3 as the tables', got {shape}. "
                "Turn an upright one by 90 degrees clockwise, as Taxim's images of that sensor are."
            )

    @property
    def name(self) -> str:
        """The name of the tables."""
        return self.tables.name

    def levels(self, gradients: Array, depth_mm: Array) -> Map:
        """Gray levels (H, W, 3), 0-255, of slopes (H, W, 2) and depths (H, W)."""
        level = self.tables.level_change(gradients, as_level=True)
        untouched = 1 - np.clip(depth_mm / 0.1, 0, 1)[..., None]
        levels = self.background + self.tables.level_change(gradients) - untouched * level
        return np.asarray(np.clip(levels, 0, 255), dtype=np.float32)


def is_taxim_forward(path: str | PathLike[str]) -> bool:
    """Whether a file is an archive with Taxim's members; `load_calibration` reports other kinds."""
    try:
        return {f"{name}.npy" for name in MEMBERS} <= set(checked_archive(path, "Taxim's tables"))
    except (DataError, *_DAMAGED):  # no archive: an array, or another file
        return False


def read_taxim_forward(path: str | PathLike[str]) -> TaximTables:
    """Read Taxim's `polycalib.npz`.

    DataError: it is missing, lacks these tables, is damaged, too large, or of another form.
    """
    path = check_path(path)
    try:
        checked_archive(path, "Taxim's tables (polycalib.npz)", MAX_ARRAY_BYTES)
        with open(path, "rb") as handle, np.load(handle, allow_pickle=False) as file:
            missing = [name for name in MEMBERS if name not in file.files]
            if missing:
                raise DataError(f"{path} lacks {', '.join(missing)}: expected Taxim's {', '.join(MEMBERS)}.")
            bins, *channels = (np.asarray(file[name], dtype=np.float64) for name in MEMBERS)
    except _DAMAGED as problem:
        raise DataError(f"{path} is damaged, or no archive (.npz) of numbers: {said(problem)}.") from problem
    count = int(bins) if bins.ndim == 0 and np.isfinite(bins) else 0
    if not 2 <= count <= 2000 or any(one.shape != (count, count, 6) for one in channels):
        shapes = ", ".join(str(one.shape) for one in channels)
        raise DataError(f"{path}: expected three tables of shape (bins, bins, 6), got {shapes}, bins {bins}.")
    table = np.stack(channels, axis=2)
    if not np.all(np.isfinite(table)):
        raise DataError(f"{path}: expected finite tables, got NaN or infinity.")
    return TaximTables(table, path.stem)


WEB_SIZES = (5, 64, 64, 64, 2)  # of the layers of gsrobotics' browser port
UNITS = {"gs_sdk": (32, 128), "gsrobotics": (64,)}  # of the first layer; 128 in gs_sdk's older networks
# All that a pickle of weights names; and how it writes the size of a storage.
_NAMES = re.compile(
    r"collections OrderedDict|torch\._utils _rebuild_(tensor_v2|parameter)|torch [A-Z][A-Za-z0-9]*Storage"
)
MAX_BYTES = 4 * 2**20  # of all members of a file: 100 times these networks


def read_gs_sdk(path: str | PathLike[str], background: Map) -> NetworkModel:
    """gs_sdk's `nnmodel.pth`: B, G, R, x/W, y/H to slope angles of a surface that goes down where pressed.

    Its older networks, 1x1 convolutions of 5-128-32-32-2 with BatchNorm, become layers of the same output.
    """
    return NetworkModel(_layers(path, "gs_sdk"), background, "xy", "angles")


def read_gsrobotics(path: str | PathLike[str], background: Map, *, position: str) -> NetworkModel:
    """gsrobotics' `nnmini.pt`: B, G, R, row/H, column/W to normals n_x, n_y; for `position` see `POSITIONS`."""
    return NetworkModel(_layers(path, "gsrobotics"), background, POSITIONS[position], "normals")


def read_gsrobotics_web(path: str | PathLike[str], background: Map, *, position: str) -> NetworkModel:
    """The browser port's weights: 8834 little-endian float32, W1 (64, 5) by rows, b1, ... W4 (2, 64), b4."""
    wanted = sum(n_in * n_out + n_out for n_in, n_out in pairwise(WEB_SIZES))
    path = present_file(path, f"{wanted} numbers, little-endian float32")
    if path.stat().st_size != 4 * wanted:
        raise DataError(
            f"Expected {4 * wanted} bytes ({wanted} numbers, little-endian float32), got {path} of "
            f"{path.stat().st_size}. Is it the browser port's file of weights?"
        )
    left, weights, biases = np.fromfile(path, dtype="<f4"), [], []
    for n_in, n_out in pairwise(WEB_SIZES):
        weight, bias, left = np.split(left, [n_in * n_out, n_in * n_out + n_out])
        weights.append(weight.reshape(n_out, n_in))
        biases.append(bias)
    layers = _of_file(path, tuple(weights), tuple(biases))
    return NetworkModel(layers, background, POSITIONS[position], "normals")


def _layers(path: str | PathLike[str], package: str) -> Layers:
    """fc1 ... fc4 or conv1 ... conv4 of a file; their width distinguishes the two packages' networks."""
    tensors = _state_dict(present_file(path, "weights saved by torch (.pth, .pt)"))
    kind = "conv" if "conv1.weight" in tensors else "fc"
    wanted = [f"{kind}{k}.{part}" for k in range(1, 5) for part in ("weight", "bias")]
    missing = [name for name in wanted if name not in tensors]
    if missing:
        raise DataError(
            f"Expected the layers {kind}1 to {kind}4 in {path}, got {', '.join(list(tensors)[:6]) or 'none'}. "
            "Is it of another package?"
        )
    width = tuple(tensors[wanted[0]].shape[:1])
    if width not in [(units,) for units in UNITS[package]]:
        other = next((f": is it {name}'s?" for name, sizes in UNITS.items() if {*width} & {*sizes}), ".")
        sizes = " or ".join(map(str, UNITS[package]))
        raise DataError(f"Expected hidden layers of {sizes} units in {path}, got {width}{other}")
    weights, biases = zip(*(_folded(tensors, kind, k, path) for k in range(1, 5)))
    return _of_file(path, weights, biases)


def _folded(tensors: Mapping[str, Any], kind: str, k: int, path: str | PathLike[str]) -> tuple[Any, Any]:
    """Weight and bias of layer `k`, with the BatchNorm after it: y = (Wx + b - mean) gain/sqrt(variance + eps) + shift."""
    weight, bias = (_array(tensors, f"{kind}{k}.{part}", path) for part in ("weight", "bias"))
    if weight.ndim == 4 and weight.shape[2:] == (1, 1):
        weight = weight[:, :, 0, 0]
    if weight.ndim != 2:
        raise DataError(
            f"{path} holds a network that looks at neighbors of a pixel (weights {weight.shape}), such as py3DCal's "
            "TouchNet, which gelform does not run. Calibrate again from its presses: gelform calibrate."
        )
    if f"bn{k}.running_var" in tensors:
        names = ("weight", "bias", "running_mean", "running_var")
        gain, shift, mean, variance = (_array(tensors, f"bn{k}.{name}", path) for name in names)
        if any(one.shape != bias.shape for one in (gain, shift, mean, variance)) or not (variance >= 0).all():
            raise DataError(f"Expected a BatchNorm of {bias.shape} units after layer {k} in {path}.")
        gain = gain / np.sqrt(variance + 1e-5)  # torch's BatchNorm, as gs_sdk uses it
        weight, bias = weight * gain[:, None], (bias - mean) * gain + shift
    return weight.astype(np.float32), bias.astype(np.float32)


def _array(tensors: Mapping[str, Any], name: str, path: str | PathLike[str]) -> Numbers:
    if name not in tensors or tensors[name].nbytes > MAX_BYTES:  # a view may repeat its numbers
        raise DataError(f"{path} lacks {name}, or it is of another size.")
    return np.asarray(tensors[name].double().numpy())


def _state_dict(path: Path) -> dict[str, Any]:
    """The tensors of a file of `torch.save`, by name; no code in it runs.

    Only what `torch.save` has written since version 1.6, a zip: for older files the guard `weights_only` has a hole
    before torch 2.6 (CVE-2025-32434). Programs of TorchScript have the member `constants.pkl`.
    """
    with open(path, "rb") as file:
        start = file.read(4)
    if start[:1] == b"\x80":
        raise DataError(
            f"{path} is a pickle, as torch wrote before version 1.6: reading it could run code, so gelform does "
            "not. If you trust it, save it again where torch is installed: "
            "torch.save(torch.load(old, weights_only=True), new)."
        )
    try:
        with ZipFile(path) as archive:
            members = names_in(archive, path, "a network that gelform reads", MAX_BYTES)
            ends = [name.split("/")[-1] for name in members]
            if start != b"PK\x03\x04" or ends.count("data.pkl") != 1 or "constants.pkl" in ends:
                raise DataError(f"Expected weights of torch.save, a zip with data.pkl in it, got {path}.")
            pickled = archive.read(members[ends.index("data.pkl")])
        _check_pickle(pickled)
        torch = needed("torch", "torch", "A network saved by torch")
        content = torch.load(path, map_location="cpu", weights_only=True)
    except UnpicklingError as problem:
        raise DataError(
            f"{path} holds more than tensors in dicts, such as a pickled module, or is damaged. Reading it could run "
            "code. If you trust it, load it with its own package and save its weights alone: "
            "torch.save(model.state_dict(), new)."
        ) from problem
    except DataError:
        raise
    except Exception as problem:  # neither zipfile nor torch has one class for what is damaged
        raise DataError(f"{path} is truncated or damaged: {said(problem)}. Copy it again.") from problem
    content = content.get("state_dict", content) if isinstance(content, dict) else None
    tensors = {str(name): one for name, one in content.items()} if isinstance(content, dict) else {}
    return {  # of floats one by one: not sparse, and no mere shape
        name: one.detach()
        for name, one in tensors.items()
        if isinstance(one, torch.Tensor) and one.is_floating_point()
        if str(one.layout) == "torch.strided" and one.device.type == "cpu"
    }


def _check_pickle(content: bytes) -> None:
    """Refuse (UnpicklingError) what takes more time or memory than its length; ValueError if it is no pickle.

    torch makes storages as large as they say, and `weights_only` lets a pickle repeat what it holds, which doubles it with
    each line.
    """
    before: list[tuple[str, Any]] = []  # the operations so far, without those that only remember
    kinds: dict[Any, str] = {}  # of what is remembered
    numbers = 0
    for operation, argument, _ in pickletools.genops(content):
        name = operation.name
        if name.endswith("BINPUT"):
            kinds[argument] = before[-1][0]
            continue
        if name.endswith("BINGET") and kinds.get(argument, "") not in ("GLOBAL", "BINUNICODE"):
            raise UnpicklingError("something repeated")
        if name == "GLOBAL" and not _NAMES.fullmatch(str(argument)):
            raise UnpicklingError(f"the name {argument}")
        if name == "BINPERSID":
            (of_count, count), (of_storage, _) = before[-2:]
            is_number = of_count in ("BININT", "BININT1", "BININT2", "LONG1") and of_storage == "TUPLE"
            numbers += count if is_number else MAX_BYTES + 1
        if not 0 <= numbers <= MAX_BYTES:
            raise UnpicklingError("a storage larger than the file")
        before.append((name, argument))


def _of_file(path: str | PathLike[str], weights: tuple[Any, ...], biases: tuple[Any, ...]) -> Layers:
    try:
        layers = Layers(weights, biases)
    except ValueError as problem:
        raise DataError(f"{path}: {problem}") from problem
    if (layers.inputs, layers.outputs) != (5, 2):
        raise DataError(
            f"Expected a network of 5 inputs and 2 outputs in {path}, got {layers.inputs} and {layers.outputs}."
        )
    return layers


# Gray levels / 255. Pixels of a Mini at rest differ from its background by up to this, from noise and drift together.
UNTOUCHED_CHANGE = 8 / 255

PACKAGES: dict[str, Callable[..., ColorModel]] = {
    "gs_sdk": read_gs_sdk,
    "gsrobotics": read_gsrobotics,
    "gsrobotics-web": read_gsrobotics_web,
    "lut": read_lut,
}
POSITIONED = ("gsrobotics", "gsrobotics-web")
# Places in a network's input: "zeros" as in the original program, which truncates them, or "true" as in its training.
POSITIONS: dict[str, Any] = {"zeros": "zeros", "true": "yx"}
# Makes whose frames a package's own programs crop and resize, as their profiles do.
MAKES = dict.fromkeys(("gs_sdk", *POSITIONED), "gelsight-mini")


def import_calibration(
    path: str | PathLike[str],
    package: str,
    *,
    background: ArrayLike,
    mm_per_px: float | None = None,
    position: str | None = None,
    flip_depth: bool = False,
    range_levels: Sequence[float] | None = None,
    sensor_name: str | None = None,
) -> Calibration:
    """A calibration from another package's file, with gelform's signs and a current background image.

    Values that the file lacks stay unknown. Without `mm_per_px` the calibration gives gradients and depth in pixels.
    It states no standard deviation of the slopes, so confidence is 1 except at clipped pixels.

    Parameters
    ----------
    path : the package's file
    package : a name in `PACKAGES`: gs_sdk, gsrobotics, gsrobotics-web or lut
    background : (H, W, 3) RGB, 0-255, the background image, cropped and sized as that package's images; or a whole frame of
        the camera whose crop that package knows, which becomes the calibration's view
    mm_per_px : width of an image's pixel on the gel, mm, if known; by default what a `.mat` states
    position : required for gsrobotics and gsrobotics-web, and only there: "zeros", the input of its program, or "true", the
        input of its network's training
    flip_depth : only for lut: the table's surface falls where pressed
    range_levels : only for lut (`.npy`): (low, high) of the differences that it spans, gray levels; (-90, 90) by default
    sensor_name : name of the calibration's sensor; by default the file's name

    Raises
    ------
    DataError
        The file is not of that package or damaged, holds more than weights, or needs torch, which is not installed.
    ValueError
        The package is unknown, an option is missing or not accepted, or the scale is none of these images.
    """
    path = check_path(path)
    options = _options(check_is(package, str, "package"), position, flip_depth, range_levels)
    if sensor_name is not None:
        check_is(sensor_name, str, "sensor_name")
    frame = check_image(background, name="background").astype(np.float32)
    if package == "lut" and mm_per_px is None:
        mm_per_px = mm_per_px_of_lut(path, frame.shape[:2])
    if mm_per_px is not None:
        mm_per_px = check_sensor_pitch(mm_per_px)
    view = _view(MAKES.get(package), frame.shape[:2], mm_per_px)
    image = image_from_frame(frame, view)
    if mm_per_px is not None:
        make = MAKES.get(package) if not view.is_identity else make_of(sensor_name or "")
        check_gel_width(image.shape[:2], mm_per_px, make)
    model: ColorModel
    others: dict[str, Any] = {"imported_from": package, **options}
    doubts: tuple[Finding, ...] = ()
    if package == "lut":
        model, others["steepest_slope"], doubts = _lut(path, image, **options)
    else:
        model = PACKAGES[package](path, image, **options)
    # As wide as the 3x3 blur of tables, weights 1/4, 1/2, 1/4.
    blur_px = 0.5**0.5 if package == "lut" else 0.0
    change = ChangeSettings("subtract", 0.0, blur_px)
    return Calibration(
        sensor_name=sensor_name or Path(path).stem,
        serial=None,
        gel_id=None,
        view=view,
        image_shape=image.shape[:2],
        mm_per_px=mm_per_px,
        mm_per_px_sigma=None,
        background=image,
        background_noise=noise_from_image(image),
        change=change,
        color_model=model,
        forward=None,
        slope_sigma=None,
        untouched_change=UNTOUCHED_CHANGE,
        held_out={},
        training_digests=(),
        settings=CalibrationSettings(others=others, findings=[astuple(one) for one in doubts] or None),
        library_version=__version__,
        created_utc=datetime.now(timezone.utc).isoformat(timespec="seconds"),
    )


def _view(make: str | None, frame_shape: tuple[int, int], mm_per_px: float | None) -> View:
    """The view of a background (H, W): of a make's frame that crop, of its image that of its camera, else identity.

    ValueError: it is a frame of the make's camera, and the scale is not that of its images.
    """
    known = SENSORS[make] if make is not None else None
    if known is None or known.profile is None or known.camera is None:
        return View()
    profile = known.profile
    if frame_shape == profile.image_shape:
        return view_from_camera(make, frame_shape, mm_per_px)
    # Of another shape it is of another sensor, unless the scale says that it is this one.
    if frame_shape != known.camera.frame_shape:
        cropped = profile.has_aspect(frame_shape) and profile.is_cropped_scale(mm_per_px)
        return profile.view(frame_shape) if cropped else View()
    if mm_per_px is not None and not profile.is_cropped_scale(mm_per_px):
        height, width = profile.image_shape
        raise ValueError(
            f"Expected mm_per_px of images of {height}x{width} px, to which frames of a {profile.name} are cropped and "
            f"resized, about {profile.mm_per_px:g}, got {mm_per_px:g}."
        )
    return profile.view(frame_shape)


def _options(
    package: str, position: str | None, flip_depth: bool, range_levels: Sequence[float] | None
) -> dict[str, Any]:
    """Keywords of the package's reader."""
    check_choice(package, PACKAGES, "a package")
    if position is not None:
        check_is(position, str, "position")
    if position not in (POSITIONS if package in POSITIONED else (None,)):
        raise ValueError(
            f"Expected position ('zeros' as its program feeds it, or 'true') for {' and '.join(POSITIONED)} and no "
            f"other, got {position!r} for {package}."
        )
    if check_is(flip_depth, bool, "flip_depth") and package != "lut":
        raise ValueError(
            f"Expected flip_depth for lut only, whose tables differ in sign, got it for {package}."
        )
    if package == "lut":
        return {"depth_sign": -1 if flip_depth else 1, "range_levels": range_levels}
    if range_levels is not None:
        raise ValueError(f"Expected range_levels for lut only, got it for {package}.")
    return {} if position is None else {"position": position}
