"""The shared presses, prepared and dealt into folds; the report of the shared calibration. Each is made once."""

import numpy as np
import pytest

from gelform.calibration.circles.find import find_contact
from gelform.calibration.circles.prepare import prepare
from gelform.calibration.report.content import report_content
from gelform.calibration.report.learning import learning_curve
from gelform.calibration.report.page.page import report_page
from gelform.calibration.selection.folds import make_folds


@pytest.fixture(scope="session")
def prepared(presses):
    return prepare(presses, 10.0)


@pytest.fixture(scope="session")
def found(prepared):
    return [find_contact(press.color_change) for press in prepared]


@pytest.fixture(scope="session")
def folds(prepared, found):
    return make_folds(prepared, found, range(len(prepared)))


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
