"""A Calibration from another package's calibration or network: one function for all formats."""

from __future__ import annotations

import pickletools
import re
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from datetime import datetime, timezone
from itertools import pairwise
from os import PathLike
from pathlib import Path
from pickle import UnpicklingError
from typing import Any
from zipfile import ZipFile

import numpy as np
from numpy.typing import ArrayLike

from gelform import View, __version__, image_from_frame
from gelform.arrays import Map, Numbers
from gelform.calibration_file import Calibration, CalibrationSettings
from gelform.errors import DataError, needed, said
from gelform.exchange.importers.tables import mm_per_px_of_lut, read_lut
from gelform.foundations.checks import check_choice, check_image, check_is, check_path, check_sensor_pitch
from gelform.foundations.files import DAMAGED_ARCHIVE, present_file
from gelform.image.background import ChangeSettings, noise_from_image
from gelform.sensors.profiles import SENSORS, check_gel_width, make_of, view_from_camera
from gelform.slopes.color_models import ColorModel, NetworkModel
from gelform.slopes.color_models.networks import Layers

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
            members = Counter(name.split("/")[-1] for name in archive.namelist())
            declared = sum(member.file_size for member in archive.infolist())
            pickles = [name for name in archive.namelist() if name.split("/")[-1] == "data.pkl"]
            pickled = archive.read(pickles[0]) if len(pickles) == 1 and declared <= MAX_BYTES else b""
    except (OSError, *DAMAGED_ARCHIVE) as problem:
        raise DataError(f"{path} is truncated or damaged: {said(problem)}. Copy it again.") from problem
    if start != b"PK\x03\x04" or members["data.pkl"] != 1 or members["constants.pkl"]:
        raise DataError(f"Expected weights of torch.save, a zip with data.pkl in it, got {path}.")
    if declared > MAX_BYTES:
        raise DataError(
            f"{path} declares {declared / 1e6:.3g} MB; networks that gelform reads have at most "
            f"{MAX_BYTES >> 20} MB. It is damaged or another network."
        )
    try:
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
    except Exception as problem:  # torch names no classes for what is damaged
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
    said: list[tuple[str, Any]] = []  # the operations so far, without those that only remember
    kinds: dict[Any, str] = {}  # of what is remembered
    numbers = 0
    for operation, argument, _ in pickletools.genops(content):
        name = operation.name
        if name.endswith("BINPUT"):
            kinds[argument] = said[-1][0]
            continue
        if name.endswith("BINGET") and kinds.get(argument, "") not in ("GLOBAL", "BINUNICODE"):
            raise UnpicklingError("something repeated")
        if name == "GLOBAL" and not _NAMES.fullmatch(str(argument)):
            raise UnpicklingError(f"the name {argument}")
        if name == "BINPERSID":
            (of_count, count), (of_storage, _) = said[-2:]
            is_number = of_count in ("BININT", "BININT1", "BININT2", "LONG1") and of_storage == "TUPLE"
            numbers += count if is_number else MAX_BYTES + 1
        if not 0 <= numbers <= MAX_BYTES:
            raise UnpicklingError("a storage larger than the file")
        said.append((name, argument))


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
        settings=CalibrationSettings(others={"imported_from": package, **options}),
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
