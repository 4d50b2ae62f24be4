"""The report of the shared calibration, made once."""

import numpy as np
import pytest

from gelform.calibration.report.content import report_content
from gelform.calibration.report.learning import learning_curve
from gelform.calibration.report.page.page import report_page


@pytest.fixture(scope="session")
def learning(presses, calibration):
    return learning_curve(presses, calibration, rng=np.random.default_rng(0))


@pytest.fixture(scope="session")
def content(presses, calibration, learning):
    return report_content(presses, calibration, rng=np.random.default_rng(0), learning=learning)


@pytest.fixture(scope="session")
def page(content, presses, calibration):
    return report_page(content, presses, calibration)
