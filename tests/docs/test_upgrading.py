"""docs/upgrading.md says what the code does: the formats of files, and each name that ends with its replacement."""

import re
import warnings
from pathlib import Path

import pytest

import gelform
from gelform import calibration_file
from gelform.batch import manifest
from gelform.calibration.report import content
from gelform.reconstruction import file as result_file
from gelform.sensors.recordings import facts
from gelform.starters import starter

PAGE = (Path(__file__).parents[2] / "docs/upgrading.md").read_text(encoding="utf-8")
WRITTEN = {
    "calibration": calibration_file.FORMAT_VERSION,
    "result": result_file.FORMAT_VERSION,
    "starter": starter.FORMAT_VERSION,
    "recording": facts.FORMAT_VERSION,
    "manifest of a batch": manifest.FORMAT_VERSION,
    "record of a calibration": content.FORMAT_VERSION,
}


def test_the_formats_are_those_that_are_written():
    rows = re.findall(r"^\| \[?([a-z ]+?)\]?(?:\(\S+\))? \(.*\) \| (\d+) \|", PAGE, re.MULTILINE)
    assert {name: int(version) for name, version in rows} == WRITTEN


def test_every_old_name_stands_beside_a_line_that_works():
    rows = dict(re.findall(r"^\| `(\w+)` \| `(from gelform\.\S+ import \w+)` \|$", PAGE, re.MULTILINE))
    assert rows.keys() == gelform.MOVED.keys()
    for name, line in rows.items():
        namespace = {}
        with warnings.catch_warnings():
            warnings.simplefilter("error", DeprecationWarning)
            exec(line, namespace)
        with pytest.warns(DeprecationWarning, match=re.escape(line)):
            assert namespace[name] is getattr(gelform, name)
