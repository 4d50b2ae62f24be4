"""The shared presses for choosing: sizes left out, held-out presses, made-up trials."""

import pytest

from gelform.calibration.selection.candidates import Candidate
from gelform.calibration.selection.folds import size_folds
from gelform.calibration.selection.press_score import PressScore
from gelform.calibration.selection.trials import HeldOutPresses, Trial


@pytest.fixture(scope="session")
def sizes(prepared, found):
    """Each of the two balls left out, although the others are fewer than calibration asks for."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("gelform.calibration.selection.folds.MIN_OF_OTHER_SIZES", 7)
        return size_folds(prepared, found, range(len(prepared)))


@pytest.fixture(scope="session")
def held_out(prepared, found, folds, sizes):
    return HeldOutPresses({10.0: prepared}, found, folds, sizes)


@pytest.fixture(scope="session")
def made_up():
    """A trial of 20 presses in 5 folds with given cap errors; press i is in fold i % 5."""

    def make(name, by_fold, by_pair=None, by_size=None, zone=0.8):
        seen = {i: PressScore(0.0, by_fold(i)) for i in range(20)}
        pairs = {
            f: {i: PressScore(0.0, (by_pair or by_fold)(i)) for i in range(20) if i % 5 != f}
            for f in range(5)
        }
        sizes = {} if by_size is None else {i: PressScore(0.0, by_size(i)) for i in range(20)}
        return Trial(Candidate(name, zone), seen, sizes, pairs)

    return make
