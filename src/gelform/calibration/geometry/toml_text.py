"""Change values in a TOML file's text: its comments, its order and all other keys stay."""

from __future__ import annotations

import copy
import json
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

Table = tuple[str, ...]


@dataclass(frozen=True)
class _Statement:
    """Some lines that belong together: a header, a key with its value, a comment or an empty line."""

    text: str
    table: Table
    key: str | None = None


def edited_toml(text: str, changes: Mapping[Table, Mapping[str, Any]], drop: Sequence[Table] = ()) -> str:
    """TOML text with some values changed.

    Parameters
    ----------
    text : of the file; "" for a new one
    changes : table (a path of names, () for the top level) -> key -> number, text, or list of them
    drop : tables whose keys and tables are taken out before

    Raises
    ------
    ValueError
        The text is no TOML, or says a value in a way that is not edited here (a dotted key, an inline table).
    """
    wanted = copy.deepcopy(tomllib.loads(text))
    for table in drop:
        _table_in(wanted, table[:-1]).pop(table[-1], None)
    for table, values in changes.items():
        _table_in(wanted, table).update(json.loads(json.dumps(values)))
    statements = [s for s in _statements(text) if not any(s.table[: len(d)] == d for d in drop)]
    for table, values in changes.items():
        for key, value in values.items():
            _set(statements, table, key, value)
    changed = "".join(statement.text for statement in statements)
    if not _says(changed, wanted):
        lines = "; ".join(
            f"[{'.'.join(table)}] {_line(key, value)}"
            for table, values in changes.items()
            for key, value in values.items()
        )
        raise ValueError(
            f"Expected keys on lines of their own, got dotted keys or inline tables. Change it by hand: {lines}."
        )
    return changed


def toml_value(value: Any) -> str:
    """A number, a text or a list of them as TOML writes it."""
    if isinstance(value, (list, tuple)):
        return f"[{', '.join(map(toml_value, value))}]"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False)
    return repr(int(value) if isinstance(value, int) else float(value))


def _says(text: str, wanted: dict[str, Any]) -> bool:
    try:
        return bool(tomllib.loads(text) == wanted)
    except tomllib.TOMLDecodeError:
        return False


def _table_in(content: dict[str, Any], table: Table) -> dict[str, Any]:
    for name in table:
        content = content.setdefault(name, {})
    return content


def _statements(text: str) -> list[_Statement]:
    found: list[_Statement] = []
    table: Table = ()
    lines = [line + "\n" for line in text.removesuffix("\n").split("\n")] if text else []
    while lines:
        count = next(n for n in range(1, len(lines) + 1) if _is_whole("".join(lines[:n])))
        chunk, lines = "".join(lines[:count]), lines[count:]
        content = tomllib.loads(chunk)
        if chunk.lstrip().startswith("["):
            table, key = _path_of(content), None
        else:
            key = next(iter(content), None)
        found.append(_Statement(chunk, table, key))
    return found


def _is_whole(chunk: str) -> bool:
    """Whether lines are TOML by themselves: a value that goes on is not."""
    try:
        tomllib.loads(chunk)
    except tomllib.TOMLDecodeError:
        return False
    return True


def _path_of(content: Any) -> Table:
    path: list[str] = []
    while content:
        if isinstance(content, list):  # an array of tables
            content = content[-1]
            continue
        name, content = next(iter(content.items()))
        path.append(name)
    return tuple(path)


def _set(statements: list[_Statement], table: Table, key: str, value: Any) -> None:
    """Replace a key's statement, or put one behind the last key of its table, or behind a new header."""
    new = _Statement(_line(key, value) + "\n", table, key)
    same = [k for k, s in enumerate(statements) if s.table == table and s.key == key]
    if same:
        comment = _comment(statements[same[0]].text)
        statements[same[0]] = _Statement(f"{_line(key, value)}{comment}\n", table, key)
        return
    inside = [k for k, s in enumerate(statements) if s.table == table and s.text.strip()]
    if inside:
        keys = [k for k in inside if statements[k].key is not None or statements[k].text.lstrip()[0] == "["]
        statements.insert((keys or inside)[-1] + 1, new)
    elif table:
        gap = "\n" if statements else ""
        statements += [_Statement(f"{gap}[{'.'.join(table)}]\n", table), new]
    else:
        statements.insert(0, new)


def _line(key: str, value: Any) -> str:
    return f"{key} = {toml_value(value)}"


def _comment(text: str) -> str:
    """The comment behind a value, with the space before it; "" where there is none."""
    content = tomllib.loads(text)
    for at in (k for k, letter in enumerate(text) if letter == "#"):
        if _is_whole(text[:at]) and tomllib.loads(text[:at]) == content:
            before = text[:at].rstrip(" \t")
            return text[len(before) :].rstrip("\r\n") if "\n" not in before else ""
    return ""
