"""Names of models, sensors and the like for the help: read from the table's source, which is not imported.

`--help` has to start at once, and the tables hold classes that need numpy.
"""

from __future__ import annotations

import ast
from pathlib import Path

PACKAGE = Path(__file__).parents[1]


def names_in(file: str, table: str) -> tuple[str, ...]:
    """The keys of a dict literal, in its order.

    Parameters
    ----------
    file : below the package, such as "color_models/__init__.py"
    table : the dict's name in that file

    Raises
    ------
    LookupError
        There is no such table, or it is no dict with keys written out.
    """
    for node in ast.parse((PACKAGE / file).read_text(encoding="utf-8")).body:
        if isinstance(node, ast.Assign | ast.AnnAssign) and isinstance(node.value, ast.Dict):
            target = node.target if isinstance(node, ast.AnnAssign) else node.targets[0]
            keys = [key.value for key in node.value.keys if isinstance(key, ast.Constant)]
            if isinstance(target, ast.Name) and target.id == table and len(keys) == len(node.value.keys):
                return tuple(str(key) for key in keys)
    raise LookupError(f"Expected a dict {table} with its keys written out in {file}.")


COLOR_MODELS = names_in("color_models/__init__.py", "COLOR_MODELS")
PACKAGES = names_in("importers/calibrations.py", "PACKAGES")
LAYOUTS = names_in("simulate/presets.py", "LAYOUTS")
SENSORS = names_in("sensors/profiles.py", "SENSORS")


def listed(names: tuple[str, ...]) -> str:
    """Names as a sentence has them: a, b or c."""
    return " or ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)
