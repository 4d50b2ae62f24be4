"""Numbers, places and settings as the report's page says them: text, not yet HTML."""

from __future__ import annotations

from typing import Any

DIGEST_SHOWN = 12  # characters of a digest: enough to tell two calibrations apart


def digits(value: float) -> str:
    """Three significant digits, zeros at the end included."""
    return f"{value:#.3g}".removesuffix(".")


def place_in_words(place: dict[str, Any], mm_per_px: float) -> str:
    """A place as a user finds it: part of the image, px, and mm from its left and its top."""
    x, y = place["x_px"], place["y_px"]
    from_left, from_top = x * mm_per_px, y * mm_per_px
    return f"{place['name']}: ({x:.0f}, {y:.0f}) px, {from_left:.1f} mm from the left, {from_top:.1f} mm from the top"


def setting_in_words(value: Any) -> str:
    """A setting as a person reads it: four significant digits, lists joined, the beginning of a digest; none: nothing."""
    if isinstance(value, dict):
        return ", ".join(f"{name}: {setting_in_words(one)}" for name, one in value.items()) or "none"
    if isinstance(value, (list, tuple)):
        return " / ".join(setting_in_words(one) for one in value) or "none"
    if isinstance(value, float):
        return f"{value:.4g}"
    text = "none" if value in (None, "") else str(value)
    is_digest = len(text) == 64 and set(text) <= set("0123456789abcdef")
    return f"{text[:DIGEST_SHOWN]}…" if is_digest else text
