"""Faults of a simulated gel are named, and a sound one has none."""

import pytest

from stream.sensor_faults import CHANGES, ONSET_S


@pytest.mark.slow
@pytest.mark.parametrize("fault", [*CHANGES, "other_gel", "frozen", "torn"])
def test_each_fault_is_named(findings, fault):
    found = findings(fault)
    assert fault in found
    assert found[fault] >= (0 if fault == "other_gel" else ONSET_S)


def test_a_sound_gel_has_no_findings(findings):
    assert findings(None) == {}
