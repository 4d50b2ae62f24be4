"""The tally of many frames: doubtful ones, and failures by reason."""

from gelform.foundations.findings import FrameTally


def test_frames_with_a_doubtful_finding_or_without_depth_are_doubtful():
    tally = FrameTally()
    for names, known in ((["exposure", "steep"], True), (["beyond_gel", "exposure"], True), ([], False)):
        tally.add(names, known=known)
    assert (tally.frames, tally.doubtful, tally.unknown) == (3, 2, 1)
    assert tally.findings == {"exposure": 2, "steep": 1, "beyond_gel": 1}
    assert tally.is_doubtful
    assert not tally.is_useless
    tally.add(["exposure"], known=True)
    assert not tally.is_doubtful, "half is not most"


def test_a_reason_is_one_whatever_file_and_figure_it_names():
    tally = FrameTally()
    for reason in ("/a/1.png: too small (3 px)", "/b c.png: bad", "/d/22.png: too small (14 px)"):
        tally.add_failed(reason)
    assert sorted(tally.reasons.values()) == [1, 2]
    assert tally.examples[max(tally.reasons, key=tally.reasons.get)] == "/a/1.png: too small (3 px)"
