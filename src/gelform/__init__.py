"""gelform: depth in millimetres from the image of an RGB visual-tactile sensor.

The public names, in the order of the path:

    frame -> image -> color change -> gradients (by way of normals) -> depth
"""

import importlib
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

_HOME = {
    "read_image": "gelform.sensors.files",
    "Video": "gelform.sensors.video_files",
    "Frame": "gelform.frames",
    "View": "gelform.view",
    "Lens": "gelform.lens",
    "image_from_frame": "gelform.view",
    "frame_from_image": "gelform.view",
    "ChangeSettings": "gelform.background.change",
    "background_from_frames": "gelform.background.average",
    "read_background": "gelform.sensors.backgrounds",
    "exposure_from_image": "gelform.background.exposure",
    "color_change_from_image": "gelform.background.change",
    "image_from_color_change": "gelform.background.change",
    "Markers": "gelform.markers",
    "markers_from_image": "gelform.markers",
    "normals_from_image": "gelform.normals",
    "image_from_normals": "gelform.normals",
    "normals_from_gradients": "gelform.normals",
    "lights_from_normals": "gelform.normals",
    "gradients_from_normals": "gelform.gradients",
    "gradients_from_depth": "gelform.gradients",
    "curl": "gelform.gradients",
    "fill": "gelform.gradients",
    "depth_from_gradients": "gelform.depth",
    "integrate": "gelform.depth",
    "Integration": "gelform.depth",
    "edge_residuals": "gelform.depth",
    "depth_sigma": "gelform.depth_sigma.sigma",
    "DepthSigma": "gelform.depth_sigma.sigma",
    "contact_from_depth": "gelform.contact",
    "read_presses": "gelform.calibration.presses.folder",
    "presses_from_frames": "gelform.calibration.presses.video",
    "Scale": "gelform.calibration.geometry.scale",
    "combined_scale": "gelform.calibration.geometry.scale",
    "scale_from_profile": "gelform.calibration.geometry.scale",
    "scale_from_points": "gelform.calibration.geometry.scale",
    "scale_from_punch": "gelform.calibration.geometry.scale_images",
    "scale_from_thread": "gelform.calibration.geometry.scale_images",
    "scale_from_stage": "gelform.calibration.geometry.scale_stage",
    "crosstalk_from_frames": "gelform.calibration.geometry.crosstalk",
    "view_from_grid": "gelform.calibration.geometry.lens",
    "with_scale": "gelform.calibration.geometry.adjust",
    "with_crosstalk": "gelform.calibration.geometry.adjust",
    "with_view": "gelform.calibration.geometry.adjust",
    "calibrate": "gelform.calibration.fit",
    "evaluate": "gelform.calibration.evaluate",
    "import_calibration": "gelform.importers.calibrations",
    "Calibration": "gelform.calibration_file",
    "load_calibration": "gelform.calibration_file",
    "Reconstructor": "gelform.reconstruct",
    "Reconstruction": "gelform.reconstruction",
    "save_result": "gelform.reconstruction",
    "load_result": "gelform.reconstruction",
    "picture": "gelform.plots.result",
    "save_picture": "gelform.plots.result",
    "press_errors": "gelform.metrics",
    "save_press_folder": "gelform.exporters.press_folder",
    "save_simulated_presses": "gelform.exporters.press_folder",
    "warmup": "gelform.depth_sigma.warmup",
    "GelformError": "gelform.errors",
    "CalibrationError": "gelform.errors",
    "SensorError": "gelform.errors",
    "ConvergenceError": "gelform.errors",
    "DataError": "gelform.errors",
}

if TYPE_CHECKING:
    from gelform.background.average import background_from_frames
    from gelform.background.change import ChangeSettings, color_change_from_image, image_from_color_change
    from gelform.background.exposure import exposure_from_image
    from gelform.calibration.evaluate import evaluate
    from gelform.calibration.fit import calibrate
    from gelform.calibration.geometry.adjust import with_crosstalk, with_scale, with_view
    from gelform.calibration.geometry.crosstalk import crosstalk_from_frames
    from gelform.calibration.geometry.lens import view_from_grid
    from gelform.calibration.geometry.scale import (
        Scale,
        combined_scale,
        scale_from_points,
        scale_from_profile,
    )
    from gelform.calibration.geometry.scale_images import scale_from_punch, scale_from_thread
    from gelform.calibration.geometry.scale_stage import scale_from_stage
    from gelform.calibration.presses.folder import read_presses
    from gelform.calibration.presses.video import presses_from_frames
    from gelform.calibration_file import Calibration, load_calibration
    from gelform.contact import contact_from_depth
    from gelform.depth import Integration, depth_from_gradients, edge_residuals, integrate
    from gelform.depth_sigma.sigma import DepthSigma, depth_sigma
    from gelform.depth_sigma.warmup import warmup
    from gelform.errors import CalibrationError, ConvergenceError, DataError, GelformError, SensorError
    from gelform.exporters.press_folder import save_press_folder, save_simulated_presses
    from gelform.frames import Frame
    from gelform.gradients import curl, fill, gradients_from_depth, gradients_from_normals
    from gelform.importers.calibrations import import_calibration
    from gelform.lens import Lens
    from gelform.markers import Markers, markers_from_image
    from gelform.metrics import press_errors
    from gelform.normals import (
        image_from_normals,
        lights_from_normals,
        normals_from_gradients,
        normals_from_image,
    )
    from gelform.plots.result import picture, save_picture
    from gelform.reconstruct import Reconstructor
    from gelform.reconstruction import Reconstruction, load_result, save_result
    from gelform.sensors.backgrounds import read_background
    from gelform.sensors.files import read_image
    from gelform.sensors.video_files import Video
    from gelform.view import View, frame_from_image, image_from_frame

__all__ = ["__version__", *_HOME]


def __getattr__(name: str) -> Any:
    """Import a public name when it is first asked for (PEP 562)."""
    if name in _HOME:
        return getattr(importlib.import_module(_HOME[name]), name)
    raise AttributeError(f"module 'gelform' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)
