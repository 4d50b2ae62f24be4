"""TOML files of a user: read completely, or refused in a sentence."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

from gelform.errors import DataError, GelformError
from gelform.foundations.whole_files import MAX_TEXT_BYTES, bytes_of

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib


def read_toml(path: Path, what: str, error: type[GelformError] = DataError) -> dict[str, Any]:
    """The settings in a TOML file; `what` describes it in errors.

    error: the file is missing, too large, no text in UTF-8, no TOML, or nested beyond reason.
    """
    try:
        return tomllib.loads(bytes_of(path, what, MAX_TEXT_BYTES, error).decode("utf-8"))
    except UnicodeDecodeError as problem:
        raise error(
            f"{path} is no text in UTF-8: byte {problem.start} is none. Save it as UTF-8."
        ) from problem
    except tomllib.TOMLDecodeError as problem:
        raise error(f"{path} is no TOML file: {problem}.") from problem
    except RecursionError:
        raise error(f"{path} holds tables inside tables beyond reason: expected {what}.") from None
