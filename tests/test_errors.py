"""What work tells its caller: the tally of frames, of which some are doubtful, failures by reason, and progress."""

import inspect
from importlib import import_module

import gelform
from gelform.errors import FrameTally, Progress, counted, no_progress, said


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


def test_every_public_progress_is_that_one():
    functions = [value for name in gelform.__all__ if inspect.isfunction(value := getattr(gelform, name))]
    reporting = [one for one in functions if "progress" in inspect.signature(one).parameters]
    assert reporting
    for function in reporting:
        parameter = inspect.signature(function).parameters["progress"]
        assert parameter.annotation in (Progress, "Progress"), function
        assert parameter.default is no_progress, function
        assert import_module(function.__module__).Progress is Progress, function


def test_counts_and_quoted_messages_read_as_sentences():
    assert [counted(count, "press") for count in (0, 1, 2)] == ["0 presses", "1 press", "2 presses"]
    assert counted(1, "contact") == "1 contact"
    assert said(ValueError("It is cut off.\nMore.")) == "It is cut off"
