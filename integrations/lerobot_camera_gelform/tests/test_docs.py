"""The code of docs/lerobot.md."""

import re
from pathlib import Path

PAGE = Path(__file__).parents[3] / "docs/lerobot.md"


def test_the_code_of_the_page_runs():
    code, *_ = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    exec(compile(code, str(PAGE), "exec"), {})
