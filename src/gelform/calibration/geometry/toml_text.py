"""Change values in the text of a TOML file and keep its comments, its order and all other keys."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

import tomlkit
from tomlkit.exceptions import TOMLKitError

Table = tuple[str, ...]


def edited_toml(text: str, changes: Mapping[Table, Mapping[str, Any]], drop: Sequence[Table] = ()) -> str:
    """TOML text with some values changed.

    Parameters
    ----------
    text : text of the file; "" for a new one
    changes : table (a path of names, () for the top level) -> key -> number, text, or list of them
    drop : tables whose keys and tables are removed first

    Raises
    ------
    ValueError
        The text is no TOML, or has a value where a table is meant.
    """
    try:
        document = tomlkit.parse(text)
        for path in drop:
            _table_in(document, path[:-1]).pop(path[-1], None)
        for path, values in changes.items():
            _table_in(document, path).update(json.loads(json.dumps(values)))
    except (TOMLKitError, TypeError, AttributeError) as problem:
        raise ValueError(f"the settings cannot be written into it: {problem}") from problem
    edited = tomlkit.dumps(document)
    if tomlkit.parse(edited).unwrap() != document.unwrap():
        raise ValueError("the settings cannot be written into it. Put each key on a line of its own.")
    return edited


def _table_in(content: Any, path: Table) -> Any:
    """A table, created if missing."""
    for name in path:
        if name not in content:
            content[name] = tomlkit.table()
        content = content[name]
    return content
