"""Real files, written by the package or in other packages' form, and the call that reads each."""

from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import cv2
import numpy as np

import gelform
from gelform.exchange.exporters.press_folder import save_press_folder
from gelform.exchange.importers import read_taxim_forward
from gelform.foundations.files import digest_of
from gelform.sensors.files import read_sensor_toml
from made.files import network_arrays, torch_file, web_file
from made.small_gel import MM_PER_PX, Touch, background, calibration, image_of, save

SENSOR_TOML = (
    'name = "known gel"\nmm_per_px = 0.1\nserial = "a1"\n'
    "[view]\nframe_shape = [64, 80]\ncrop = [8, 4, 64, 56]\nflip = \"x\"\n"
)  # fmt: skip
ROWS = 3


@dataclass(frozen=True)
class RealFile:
    """One file among those that a reader needs.

    Attributes
    ----------
    path : of the file that is damaged
    read : what a user calls
    same : whether a result of it is the undamaged one
    """

    path: Path
    read: Callable[[], Any]
    same: Callable[[Any], bool]
    content: bytes


def _real(path: Path, read: Callable[[], Any], same: Callable[[Any], bool]) -> RealFile:
    assert same(read()), f"{path} is not read as it was written"
    return RealFile(path, read, same, path.read_bytes())


def real_files(folder: Path) -> dict[str, RealFile]:
    """One of each kind, in a folder of its own."""
    return {
        **_own_files(folder),
        **_images(folder),
        **_press_folder(folder / "presses"),
        **_gs_sdk_folder(folder / "gs_sdk"),
        **_py3dcal_folder(folder / "py3dcal"),
        **_of_other_packages(folder),
    }


def _own_files(folder: Path) -> dict[str, RealFile]:
    cal, result = folder / "cal.npz", folder / "result.npz"
    calibration().save(cal)
    made = gelform.Reconstructor(calibration())(image_of(Touch()))
    gelform.save_result(made, result)
    digest = gelform.load_calibration(cal).digest
    toml = folder / "sensor.toml"
    toml.write_text(SENSOR_TOML)
    settings = read_sensor_toml(toml)
    return {
        "calibration": _real(cal, lambda: gelform.load_calibration(cal), lambda got: got.digest == digest),
        "result": _real(
            result,
            lambda: gelform.load_result(result),
            lambda got: np.array_equal(got.depth_mm, made.depth_mm) and got.mm_per_px == MM_PER_PX,
        ),
        # Text has no checksum: another number or name is another sensor.
        "sensor.toml": _real(toml, lambda: read_sensor_toml(toml), lambda got: type(got) is type(settings)),
    }


def _images(folder: Path) -> dict[str, RealFile]:
    image, found = image_of(Touch()), {}
    for suffix in ("png", "jpg", "bmp", "tif", "ppm"):
        path = folder / f"image.{suffix}"
        _, content = cv2.imencode(f".{suffix}", image[..., ::-1])
        path.write_bytes(content.tobytes())
        pixels = gelform.read_image(path)
        found[suffix] = _real(path, lambda p=path: gelform.read_image(p), _like_image(suffix, pixels))
    return found


def _like_image(suffix: str, pixels: np.ndarray) -> Callable[[Any], bool]:
    """PNG has checksums. Of the others only the form can be right: any pixels may be what the camera saw."""
    if suffix == "png":
        return lambda got: np.array_equal(got, pixels)
    return lambda got: got.dtype == np.uint8 and got.ndim == 3 and got.shape[2] == 3


def _press_folder(folder: Path) -> dict[str, RealFile]:
    touches = [Touch(seed=k, x_px=30.0 + 8 * k) for k in range(ROWS)]
    save_press_folder(
        folder,
        background=image_of(None),
        images=[image_of(touch) for touch in touches],
        ball_diameters_mm=[8.0] * ROWS,
        mm_per_px=MM_PER_PX,
        name="known gel",
    )

    def same(got: Any) -> bool:
        return got.mm_per_px == MM_PER_PX and [p.ball_diameter_mm for p in got.presses] == [8.0] * ROWS

    table = next(path for path in folder.rglob("presses.csv"))
    image = sorted(folder.rglob("*.png"))[-1]
    read = lambda: gelform.read_presses(folder)  # noqa: E731
    return {
        "presses.csv": _real(table, read, lambda got: len(got.presses) <= ROWS),
        "image of a press": _real(image, read, same),
        "sensor.toml of presses": _real(folder / "sensor.toml", read, lambda got: len(got.presses) == ROWS),
    }


def _gs_sdk_folder(folder: Path) -> dict[str, RealFile]:
    save(folder / "background.png", image_of(None))
    save(folder / "p0" / "gelsight.png", image_of(Touch()))
    (folder / "catalog.csv").write_text("experiment_reldir,diameter(mm)\np0,8.0\n")
    (folder / "sensor.toml").write_text('name = "known gel"\nmm_per_px = 0.1\n')
    label = folder / "p0" / "label.npz"
    np.savez(label, center=np.array([40, 30]), radius=np.array(17.0))
    read = lambda: gelform.read_presses(folder)  # noqa: E731
    return {
        "catalog.csv": _real(folder / "catalog.csv", read, lambda got: len(got.presses) == 1),
        "label.npz": _real(label, read, lambda got: got.presses[0].label == (40.0, 30.0, 17.0)),
    }


def _py3dcal_folder(folder: Path) -> dict[str, RealFile]:
    save(folder / "blank_images" / "blank.png", image_of(None))
    save(folder / "probe_images" / "0.png", image_of(Touch()))
    facts = folder / "annotations" / "metadata.json"
    facts.parent.mkdir()
    (facts.parent / "annotations.csv").write_text("img_name,x_px,y_px\n0.png,40,30\n")
    facts.write_text('{"px_per_mm": 10, "probe_radius_mm": 4}')
    read = lambda: gelform.read_presses(folder)  # noqa: E731
    # Text has no checksum: another number is another sensor.
    return {"metadata.json": _real(facts, read, lambda got: len(got.presses) == 1)}


def _of_other_packages(folder: Path) -> dict[str, RealFile]:
    weights = web_file(folder / "weights.bin")
    table, pack = folder / "polycalib.npz", folder / "pack" / "dataPack.npz"
    rng = np.random.default_rng(0)
    grads = {name: rng.normal(0, 1e-4, (8, 8, 6)) for name in ("grad_r", "grad_g", "grad_b")}
    np.savez(table, bins=np.array(8), **grads)
    pack.parent.mkdir()
    images = np.stack([image_of(Touch(seed=k))[..., ::-1] for k in range(2)])
    np.savez(
        pack,
        f0=image_of(None)[..., ::-1],
        imgs=images,
        touch_center=np.array([[40, 30]] * 2),
        touch_radius=np.array([17, 17]),
    )
    rest = np.ascontiguousarray(background()[:60, :80])
    read = lambda path, name, **more: lambda: gelform.import_calibration(path, name, background=rest, **more)  # noqa: E731
    of_torch = {}
    if find_spec("torch"):
        saved = torch_file(folder / "nnmodel.pth", network_arrays((5, 32, 32, 32, 2)))
        of_torch = {"torch weights": _real(saved, read(saved, "gs_sdk"), _all_finite)}
    return {
        **of_torch,
        "browser weights": _real(weights, read(weights, "gsrobotics-web", position="true"), _all_finite),
        "Taxim table": _real(
            table, lambda: read_taxim_forward(table), lambda got: bool(np.isfinite(got.table).all())
        ),
        "Taxim pack": _real(
            pack,
            lambda: gelform.read_presses(pack, mm_per_px=0.1, ball_diameter_mm=8.0),
            lambda got: np.array_equal(got.presses[1].image, images[1][..., ::-1]) and len(got.presses) == 2,
        ),
    }


def _all_finite(calibration: Any) -> bool:
    arrays, _ = calibration.color_model.to_arrays()
    return all(np.isfinite(array).all() for array in arrays.values())


def odd_archives(content: bytes) -> list[bytes]:
    """An archive whose arrays declare 8 TB, and one with a name that is no text; none of a file of another kind."""
    if not content.startswith(b"PK"):
        return []
    header, declared = io.BytesIO(), io.BytesIO()
    np.lib.format.write_array_header_1_0(header, {"descr": "<f8", "fortran_order": False, "shape": (10**12,)})
    with zipfile.ZipFile(io.BytesIO(content)) as archive, zipfile.ZipFile(declared, "w") as other:
        for name in archive.namelist():
            other.writestr(name, header.getvalue())
        other.writestr("é", b"")
    whole = declared.getvalue()
    return [whole, whole.replace("é".encode(), b"\xff\xfe")]


def unsealed(content: bytes) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """Arrays and settings of a file of gelform's own."""
    with np.load(io.BytesIO(content)) as file:
        arrays = {name: file[name] for name in file.files}
    return arrays, json.loads(str(arrays.pop("meta")[()]))


def sealed(arrays: dict[str, Any], meta: dict[str, Any]) -> bytes:
    """A file whose digest agrees, whatever it holds: what only somebody who means it would make."""
    arrays = {name: np.asarray(array) for name, array in arrays.items()}
    plain = {name: array for name, array in arrays.items() if not array.dtype.hasobject}
    meta = {name: value for name, value in meta.items() if name != "digest"}
    meta["digest"] = digest_of(plain, meta)
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        for name, array in {"meta": np.array(json.dumps(meta)), **arrays}.items():
            member = io.BytesIO()
            np.lib.format.write_array(member, array, allow_pickle=True)
            archive.writestr(f"{name}.npy", member.getvalue())
    return stream.getvalue()
