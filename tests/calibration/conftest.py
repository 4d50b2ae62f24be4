"""The report of the shared calibration, made once."""

import numpy as np
import pytest

from gelform.calibration.report.content import report_content
from gelform.calibration.report.learning import learning_curve
from gelform.calibration.report.page.page import report_page


@pytest.fixture(scope="session")
def learning(presses, calibration, made_once):
    rng = np.random.default_rng(0)
    return made_once("learning", lambda _: learning_curve(presses, calibration, rng=rng))


@pytest.fixture(scope="session")
def content(presses, calibration, learning, made_once):
    rng = np.random.default_rng(0)
    return made_once("content", lambda _: report_content(presses, calibration, rng=rng, learning=learning))


@pytest.fixture(scope="session")
def page(content, presses, calibration):
    return report_page(content, presses, calibration)
