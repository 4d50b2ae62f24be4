"""Finding: a fact about an image, a background or a stream that a user should know, in words and with a figure."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Finding:
    """A fact that a user should know, with its figure."""

    name: str
    message: str
    figure: float
