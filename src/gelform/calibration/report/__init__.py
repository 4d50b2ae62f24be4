"""What a calibration run found, in numbers, in words and on a page."""

from gelform.calibration.report.content import report_content
from gelform.calibration.report.held_out import HeldOutSample, measure_held_out
from gelform.calibration.report.learning import learning_curve
from gelform.calibration.report.page import report_page
from gelform.calibration.report.record import CalibrationReport, PressReport, summary

__all__ = [
    "CalibrationReport",
    "HeldOutSample",
    "PressReport",
    "learning_curve",
    "measure_held_out",
    "report_content",
    "report_page",
    "summary",
]
