"""The shared presses for choosing: held out fold by fold, with the change that untouched gel shows."""

import pytest

from gelform.calibration.draft import untouched_change
from gelform.calibration.selection.select import HeldOutPresses


@pytest.fixture(scope="session")
def held_out(prepared, found, folds):
    return HeldOutPresses({10.0: prepared}, found, folds, {10.0: untouched_change(prepared, found)})
