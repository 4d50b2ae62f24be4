"""Calls of the command line with odd arguments and damaged inputs: each ends well, or in a sentence; none in a bug."""

import shlex

import pytest

from gelform.cli import main
from hostile.calls import inputs_in, is_fault, known_faults, made_calls
from hostile.outcome import FACTOR

CALLS = round(30 * FACTOR)


@pytest.mark.slow
def test_no_call_ends_in_a_bug(tmp_path, monkeypatch, capfd):
    (tmp_path / "inputs").mkdir()
    template, faults = inputs_in(tmp_path / "inputs" / "work"), []
    known = len(list(known_faults(template, tmp_path)))
    template = inputs_in(tmp_path / "whole")
    for call, here in made_calls(template, tmp_path, known + CALLS, seed=1):
        for name in ("HOME", "XDG_DATA_HOME", "XDG_CACHE_HOME"):
            monkeypatch.setenv(name, str(here / "home"))
        monkeypatch.chdir(here)
        with pytest.raises(SystemExit) as stopped:
            main(call)
        said = capfd.readouterr()
        if is_fault(stopped.value.code or 0, said.out + said.err):
            faults.append(f"{shlex.join(call)[:300]}: {said.err[-300:]}")
        monkeypatch.chdir(tmp_path)
    assert faults == []
