"""gelform live: the address is printed; tests/live tests the page."""

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
