"""A comparison of two designs, made once."""

from dataclasses import replace

import pytest

from gelform.design import Variation, compare_designs
from gelform.simulate import LAYOUTS


@pytest.fixture(scope="session")
def study(made_once):
    """Results of a sensor as given and with eight times the noise, and the progress that was reported."""
    return made_once("study", lambda _: _study())


def _study():
    calls = []
    results = compare_designs(
        replace(LAYOUTS["ring-120"], shape=(120, 160), mm_per_px=0.1268),
        [Variation("as given"), Variation("eight times the noise", noise=8)],
        presses=8,
        tests=6,
        halved=False,
        progress=lambda *call: calls.append(call[:2]),
    )
    return results, calls
