"""One door for shapes, dtypes and ranges: every public function checks its arguments here, once."""

from gelform.checks.arrays import (
    LARGEST,
    as_array,
    check_finite,
    check_gradients,
    check_image,
    check_map,
    check_mask,
    check_normals,
    check_values,
    value_range,
)
from gelform.checks.kinds import check_is, check_list, check_path
from gelform.checks.numbers import (
    check_gel_thickness,
    check_mm_per_px,
    check_number,
    check_numbers,
    check_positive,
    check_sensor_pitch,
    check_within,
)

__all__ = [
    "LARGEST",
    "as_array",
    "check_finite",
    "check_gel_thickness",
    "check_gradients",
    "check_image",
    "check_is",
    "check_list",
    "check_map",
    "check_mask",
    "check_mm_per_px",
    "check_normals",
    "check_number",
    "check_numbers",
    "check_path",
    "check_positive",
    "check_sensor_pitch",
    "check_values",
    "check_within",
    "value_range",
]
