"""docs/adding-a-color-model.md, followed word for word."""

import importlib.util
import re
import sys
import textwrap
from pathlib import Path

import numpy as np
import pytest

import gelform
from gelform.calibration.candidates import candidates_for, color_model_names
from gelform.slopes import color_models

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "adding-a-color-model.md"


def blocks(language):
    """The page's code blocks in a language."""
    found = re.findall(rf"^ *```{language}\n(.*?)^ *```", PAGE.read_text(encoding="utf-8"), re.M | re.S)
    return [textwrap.dedent(block) for block in found]


@pytest.fixture
def added(tmp_path, monkeypatch):
    """The model of the page, its file written and its class listed as step 1 and 2 say."""
    code, import_line = blocks("python")
    path = re.search(r"This is `(src/gelform/\S+\.py)`", PAGE.read_text(encoding="utf-8"))[1]
    assert (ROOT / path).parent == Path(color_models.__file__).parent
    (tmp_path / Path(path).name).write_text(code)
    name = f"gelform.slopes.color_models.{Path(path).stem}"
    spec = importlib.util.spec_from_file_location(name, tmp_path / Path(path).name)
    monkeypatch.setitem(sys.modules, name, importlib.util.module_from_spec(spec))
    spec.loader.exec_module(sys.modules[name])
    listed = Path(color_models.__file__).read_text(encoding="utf-8")
    last = '    "lookup": LookupModel,\n'
    assert last in listed
    namespace = {}
    exec(import_line + listed.replace(last, f"{last}    {blocks('text')[0]}"), namespace)
    table = namespace["COLOR_MODELS"]
    (new,) = table.keys() - color_models.COLOR_MODELS.keys()
    monkeypatch.setitem(color_models.COLOR_MODELS, new, table[new])
    return new


def test_every_file_that_the_page_names_is_there():
    text = re.sub(r"\S*linear\.py", "", PAGE.read_text(encoding="utf-8"))
    named = re.findall(
        r"`(?:python -m pytest |python )?((?:src|tests|benchmarks|color_models)/[\w/.]+)", text
    )
    assert len(named) >= 5
    for path in named:
        assert (ROOT / path).exists() or (ROOT / "src" / "gelform" / path).exists(), path


@pytest.mark.slow
def test_the_model_calibrates_by_name(added, presses, tmp_path):
    assert added in color_model_names()
    calibration = gelform.calibrate(presses.subset(range(8)), color_model=added)
    assert calibration.color_model.name == added
    calibration.save(tmp_path / "cal.npz")
    again = gelform.load_calibration(tmp_path / "cal.npz")
    image = presses.presses[0].image
    np.testing.assert_array_equal(
        gelform.Reconstructor(again)(image).depth_mm, gelform.Reconstructor(calibration)(image).depth_mm
    )
    assert [one.model for one in candidates_for(added, len(presses.presses))] == [added]
