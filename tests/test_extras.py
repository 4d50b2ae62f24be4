"""Every extra has a use (`extra_uses.py`), and without its packages the use ends with a sentence that names the extra."""

import re
import sys
from pathlib import Path

import pytest

from extra_uses import EXTRA_OF, USES, prepared

try:
    import tomllib
except ModuleNotFoundError:  # Python 3.10
    import tomli as tomllib

PYPROJECT = Path(__file__).parents[1] / "pyproject.toml"
SCRIPTS = {"docs"}  # of the checkout, which another process runs: `.ci/extras` tries them
HARMLESS = {"png"}  # without it Python's own zlib reads the same pixels
IMPORTED_AS = {"rerun-sdk": "rerun", "foxglove-sdk": "foxglove", "eclipse-zenoh": "zenoh"}
EXTRAS = tomllib.loads(PYPROJECT.read_text(encoding="utf-8"))["project"]["optional-dependencies"]


def modules_of(extra):
    """The modules that an extra brings, as they are imported."""
    packages = [re.match(r"[\w.-]+", one)[0] for one in EXTRAS[extra]]
    return {IMPORTED_AS.get(package, package.replace("-", "_")) for package in packages}


def test_every_extra_has_a_use():
    assert set(EXTRAS) - {"dev"} == {EXTRA_OF.get(use, use) for use in USES}


@pytest.mark.parametrize("use", sorted(set(USES) - SCRIPTS - HARMLESS))
def test_without_its_packages_it_is_named(use, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    prepared(tmp_path)
    extra = EXTRA_OF.get(use, use)
    missing = modules_of(extra)
    for module in [*missing, *sys.modules]:
        if module.split(".")[0] in missing:
            monkeypatch.setitem(sys.modules, module, None)
        elif module.startswith("gelform.torch"):
            monkeypatch.delitem(sys.modules, module)
    with pytest.raises((Exception, SystemExit)) as refused:
        USES[use]()
    said = str(refused.value).removeprefix("gelform: error: ").strip()
    assert "\n" not in said
    assert f"gelform[{extra}]" in said
