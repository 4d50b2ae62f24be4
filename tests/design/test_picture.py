"""The picture of a study."""

import numpy as np
import pytest

from gelform.design import design_picture


@pytest.mark.slow
def test_a_study_can_be_drawn(study):
    pytest.importorskip("matplotlib")
    results, _ = study
    picture = design_picture(results)
    assert picture.dtype == np.uint8
    assert picture.shape[2] == 3
    assert picture.std() > 20
    alone = design_picture(results[:1])
    assert alone.shape[1] < picture.shape[1]
