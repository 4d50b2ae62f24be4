"""What ten seconds of a stream hand to the slow checks."""

from dataclasses import replace

import numpy as np

from gelform.streams.rest.background_drift import CANDIDATE_S, BackgroundDrift


def test_evidence_is_the_mean_of_its_frames(reconstruct, at_rest):
    drift = BackgroundDrift(reconstruct.background)
    result = reconstruct.from_image(at_rest[0])
    times_s = np.arange(0, CANDIDATE_S + 0.5, 0.5)
    for index, time_s in enumerate(times_s):
        drift(at_rest[index % 10], replace(result, index=index, time_s=float(time_s)))
    evidence = drift.evidence
    assert evidence.frames == len(times_s)
    expected = np.mean([at_rest[i % 10] for i in range(len(times_s))], axis=0)
    np.testing.assert_allclose(evidence.image, expected, rtol=1e-5)
    assert evidence.start is reconstruct.background
    assert not evidence.contact.any()
    assert evidence.different == 0
