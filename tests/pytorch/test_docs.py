"""The code of docs/torch.md."""

import re
from pathlib import Path

import pytest

pytest.importorskip("torch", reason="needs the extra 'torch'")
PAGE = Path(__file__).parents[2] / "docs/torch.md"


def test_the_code_of_the_page_runs(calibration, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    calibration.save("mini.npz")
    (code,) = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    exec(compile(code, str(PAGE), "exec"), {})
