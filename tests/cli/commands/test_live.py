"""gelform live: the address is printed, mistakes are one line; tests/live tests the page."""

import os
import re
import signal
import subprocess
import sys
import urllib.request

import pytest


@pytest.mark.slow
def test_it_prints_an_address_that_answers_and_ends_on_interrupt():
    command = [sys.executable, "-m", "gelform", "live"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as running:
        try:
            url = running.stdout.readline().strip()
            assert re.fullmatch(r"http://127\.0\.0\.1:\d+/", url)
            with urllib.request.urlopen(url, timeout=20) as answer:
                assert b"<title>gelform live</title>" in answer.read()
        finally:
            os.kill(running.pid, signal.SIGINT)
        _, said = running.communicate(timeout=20)
    assert "Traceback" not in said
    assert running.returncode in (0, 130)


def test_mistakes_are_one_line(fails):
    for arguments, said in (
        (["-c", "missing.npz"], "missing.npz"),
        (["seq/"], "No file or folder seq/. Check the path."),
        (["simulated:three-edge"], "three-edges"),
        (["--host", "203.0.113.9"], "address of this machine"),
        (["--sink", "rviz", "--rate", "5"], "sinks among rerun, foxglove, got rviz"),
        (["a", "b", "c", "-c", "x.npz", "-c", "y.npz"], "one for each of the 3"),
    ):
        assert said in fails("live", *arguments)


def test_a_make_without_a_starter_is_wrong_usage(fails):
    said = fails("live", "--sensor", "gelslim", status=2)
    assert "--sensor" in said
    assert "expected digit, gelsight-mini or simulated-three-edges, got 'gelslim'" in " ".join(said.split())
