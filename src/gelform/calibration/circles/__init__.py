"""The contact circle of each press: found, refined, and the pixels whose slope is known by it."""

from gelform.calibration.circles.find import ContactCircle, find_contact, why_no_contact
from gelform.calibration.circles.markers import change_without_markers
from gelform.calibration.circles.prepare import ColorChanges, change_settings, prepare
from gelform.calibration.circles.refine import Refined, refine
from gelform.calibration.circles.samples import PreparedPress, contact_samples, with_rest_samples
from gelform.calibration.circles.sigma import circle_sigmas

__all__ = [
    "ColorChanges",
    "ContactCircle",
    "PreparedPress",
    "Refined",
    "change_settings",
    "change_without_markers",
    "circle_sigmas",
    "contact_samples",
    "find_contact",
    "prepare",
    "refine",
    "why_no_contact",
    "with_rest_samples",
]
