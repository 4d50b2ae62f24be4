"""What is measured beside the presses, and written where `read_presses` finds it: scale, lens, crosstalk."""

from gelform.calibration.geometry.crosstalk import Crosstalk, crosstalk_from_frames
from gelform.calibration.geometry.lens import GridView, view_from_grid
from gelform.calibration.geometry.measured import Geometry
from gelform.calibration.geometry.save import save_crosstalk, save_grid_view, save_scale
from gelform.calibration.geometry.scale import Scale, combined_scale, scale_from_points, scale_from_profile
from gelform.calibration.geometry.scale_images import scale_from_punch, scale_from_thread
from gelform.calibration.geometry.scale_stage import scale_from_stage
from gelform.calibration.geometry.setup import Setup, read_setup

__all__ = [
    "Crosstalk",
    "Geometry",
    "GridView",
    "Scale",
    "Setup",
    "combined_scale",
    "crosstalk_from_frames",
    "read_setup",
    "save_crosstalk",
    "save_grid_view",
    "save_scale",
    "scale_from_points",
    "scale_from_profile",
    "scale_from_punch",
    "scale_from_stage",
    "scale_from_thread",
    "view_from_grid",
]
