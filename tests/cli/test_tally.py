"""The exit status of a command on many frames."""

import pytest

from gelform.cli.tally import status_of
from gelform.foundations.findings import FrameTally

GOOD, DOUBTFUL, UNKNOWN = ([], True), (["beyond_gel"], True), (["not_this_gel"], False)


@pytest.mark.parametrize(
    ("frames", "failed", "status", "accepted"),
    [
        ([GOOD, DOUBTFUL], 0, 0, 0),
        ([GOOD, DOUBTFUL, DOUBTFUL], 0, 3, 0),
        ([GOOD, UNKNOWN, UNKNOWN], 0, 3, 0),
        ([UNKNOWN], 0, 1, 1),
        ([GOOD], 1, 1, 1),
        ([DOUBTFUL], 1, 1, 1),
        ([], 2, 1, 1),
        ([], 0, 0, 0),
    ],
)
def test_what_the_frames_make_of_the_status(frames, failed, status, accepted):
    tally = FrameTally()
    for names, known in frames:
        tally.add(names, known=known)
    for _ in range(failed):
        tally.add_failed("it is empty")
    assert status_of(tally, accept_doubtful=False, quiet=True) == status
    assert status_of(tally, accept_doubtful=True, quiet=True) == accepted


def test_few_frames_are_no_zero_percent(capsys):
    tally = FrameTally()
    for k in range(300):
        tally.add(["steep"] * (k == 0), known=True)
    status_of(tally, accept_doubtful=False, quiet=False)
    assert capsys.readouterr().err == "Findings in 300 frames: steep under 1 %.\n"
