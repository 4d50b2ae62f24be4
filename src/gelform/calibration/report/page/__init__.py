"""The report as one page of HTML that needs nothing else."""

from gelform.calibration.report.page.page import report_page

__all__ = ["report_page"]
