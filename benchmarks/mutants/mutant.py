"""One changed place in one file."""

from __future__ import annotations

import difflib
import random
from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class Mutant:
    """A file's whole text with one change.

    Attributes
    ----------
    line : of the change, from 1
    change : the operator's name
    source : the changed text of the file
    before, after : the lines that differ, without their indentation
    """

    line: int
    change: str
    source: str
    before: str
    after: str


def mutant(original: str, changed: str, line: int, change: str) -> Mutant:
    """A mutant, with the lines that differ."""
    differing = [
        entry
        for entry in difflib.ndiff(original.splitlines(), changed.splitlines())
        if entry.startswith(("- ", "+ "))
    ]
    before, after = (
        " ".join(" ".join(entry[2:].split()) for entry in differing if entry[0] == sign) for sign in "-+"
    )
    return Mutant(line, change, changed, before, after)


def sample(mutants: Sequence[Mutant], limit: int, seed: str) -> list[Mutant]:
    """`limit` of the mutants at random, in the order of their lines; all where limit is 0."""
    if not limit or limit >= len(mutants):
        return list(mutants)
    chosen = random.Random(seed).sample(range(len(mutants)), limit)
    return [mutants[index] for index in sorted(chosen)]
