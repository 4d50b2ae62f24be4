"""Presses with what was measured beside them: their scale, their crosstalk, the view that undoes the lens."""

from __future__ import annotations

from dataclasses import replace
from os import PathLike

import numpy as np

from gelform.calibration.geometry.crosstalk import Crosstalk
from gelform.calibration.geometry.scale import Scale
from gelform.calibration.presses.folder import Press, Presses, as_presses
from gelform.calibration.presses.press_set import ListedFlat, flat_from_frame
from gelform.checks import check_is
from gelform.errors import DataError
from gelform.frames import pixels_digest
from gelform.view import View, image_from_frame, image_px_from_frame_px


def with_scale(presses: Presses | str | PathLike[str], scale: Scale) -> Presses:
    """The presses, or those of a path, at a measured scale."""
    check_is(scale, Scale, "scale")
    presses = as_presses(presses)
    return replace(
        presses,
        mm_per_px=scale.mm_per_px,
        mm_per_px_sigma=scale.sigma,
        geometry=replace(presses.geometry, scale_source=scale.source),
    )


def with_crosstalk(presses: Presses | str | PathLike[str], crosstalk: Crosstalk) -> Presses:
    """The presses of channels whose crosstalk is known: the calibration undoes it before its color model."""
    check_is(crosstalk, Crosstalk, "crosstalk")
    presses = as_presses(presses)
    return replace(presses, geometry=replace(presses.geometry, crosstalk=crosstalk))


def with_view(presses: Presses | str | PathLike[str], view: View, source: str) -> Presses:
    """The presses through a view that undoes the lens; labels move with their pixels.

    Parameters
    ----------
    presses : as they were read, without a view
    view : from the presses' frames to images
    source : what told the view, for the report

    Raises
    ------
    DataError
        The presses have a view of their own already, or are of another size than the view's frames.
    """
    check_is(view, View, "view")
    check_is(source, str, "source")
    presses = as_presses(presses)
    if not presses.view.is_identity:
        raise DataError(
            "Expected presses without a view where the lens is undone, got a [view] or --crop: undo it on whole "
            "frames (leave the view out), and crop by the lens's view."
        )
    if presses.image_shape != view.frame_shape:
        raise DataError(
            f"Expected presses of the size of the grid's images, {view.frame_shape} px, got {presses.image_shape} px "
            "(height, width). Take both with the same camera settings."
        )
    background = image_from_frame(presses.background, view).astype(np.float32)
    seen = tuple(_through(press, view) for press in presses.presses)
    flats = tuple(
        flat_from_frame(ListedFlat(flat.name, flat.height_mm), flat.image, view) for flat in presses.flats
    )
    geometry = replace(presses.geometry, lens=source)
    return replace(presses, presses=seen, flats=flats, background=background, view=view, geometry=geometry)


def _through(press: Press, view: View) -> Press:
    image = np.ascontiguousarray(image_from_frame(press.image, view))
    label = None
    if press.label is not None:
        x, y, radius = press.label
        ring = np.array([(x, y), (x + radius, y), (x - radius, y), (x, y + radius), (x, y - radius)])
        center, *rim = image_px_from_frame_px(ring, view)
        distances = [float(np.hypot(*(point - center))) for point in rim]
        label = (float(center[0]), float(center[1]), float(np.mean(distances)))
    return replace(press, image=image, digest=pixels_digest(image), label=label)
