"""gelform ros: usage, and the sentence where no router answers."""

import pytest

pytest.importorskip("rosbags", reason="the extra zenoh is not installed")


def test_mistakes_in_usage(run, calibration_file):
    assert run("ros", "-c", calibration_file, "--topics", "depth")[0] == 2
    assert run("ros", "-c", calibration_file, "--name", "Left Finger")[0] == 2
    assert run("ros", "-c", calibration_file, "--domain", "233")[0] == 2


def test_no_router_is_one_sentence_that_says_what_to_do(fails, calibration_file):
    pytest.importorskip("zenoh", reason="the extra zenoh is not installed")
    said = fails("ros", "-c", calibration_file, "--router", "tcp/127.0.0.1:1")
    assert "No zenoh router answers at tcp/127.0.0.1:1. Start one" in said
    assert "address of a zenoh router" in fails("ros", "-c", calibration_file, "--router", "here")
