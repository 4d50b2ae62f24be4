"""The report of a calibration run: numbers, words and a page."""

from gelform.calibration.report.content import report_content
from gelform.calibration.report.learning import learning_curve
from gelform.calibration.report.page.page import report_page
from gelform.calibration.report.record import CalibrationReport, PressReport, summary

__all__ = [
    "CalibrationReport",
    "PressReport",
    "learning_curve",
    "report_content",
    "report_page",
    "summary",
]
