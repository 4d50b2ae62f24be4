"""Findings: what a user should know of an image, a background or a stream, in words and with a figure."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Finding:
    """Something that a user should know, with its figure."""

    name: str
    message: str
    figure: float
