"""The shared presses, prepared and dealt into folds; the report of the shared calibration. Each is made once."""

import numpy as np
import pytest

from gelform.calibration.circles.find import prepare
from gelform.calibration.circles.locate import Located, Refined
from gelform.calibration.held_out import PIXEL, table
from gelform.calibration.report.content import report_content
from gelform.calibration.report.page import report_page
from gelform.calibration.report.record import learning_curve
from gelform.calibration.selection import HeldOutPresses, make_folds
from gelform.result.metrics import ball_gradients


@pytest.fixture(scope="session")
def prepared(presses):
    return prepare(presses)


@pytest.fixture(scope="session")
def found(prepared):
    return [press.found for press in prepared]


@pytest.fixture(scope="session")
def folds(located):
    return make_folds(located)


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


@pytest.fixture(scope="session")
def located(presses, prepared, found):
    return Located(presses, prepared, Refined(tuple(found), (None,) * len(found), None))


@pytest.fixture(scope="session")
def held_out(located, folds):
    return HeldOutPresses(located, folds)


@pytest.fixture(scope="session")
def sample():
    """Makes the pixels of a ball of radius 40 px in an image of 60x80 px, read with a gain, a bias and noise."""

    def sample(index=0, *, gain=1.0, noise=0.0, bias=(0.0, 0.0), circle=(40.0, 30.0, 25.0), rng=None):
        y, x = (axis.ravel() for axis in np.mgrid[:60, :80])
        away = np.hypot(x - circle[0], y - circle[1])
        x, y, away = (one[away < circle[2] - 2] for one in (x, y, away))
        true = ball_gradients(x, y, circle[:2], 40.0)
        seen = gain * true + bias + (noise * rng.standard_normal(true.shape) if noise else 0)
        columns = {
            "press": index,
            "x_px": x,
            "y_px": y,
            "rho": away / circle[2],
            "true": true,
            "solved": seen,
        }
        return table(PIXEL, len(x), **columns, stated=np.nan)

    return sample
