"""The table of the maps of a result, which records, files, batches, the live page, pictures and help read.

It imports no numpy, because help reads it.
"""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass, field, fields
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from gelform.arrays import Map, Mask, Slopes


@dataclass(frozen=True)
class ResultMap:
    """One map of a result."""

    name: str  # of the attribute of `Reconstruction`, and in files; without a scale the depth is `depth_px`
    dtype: str  # "float32" or "bool"
    unit: str  # "" if it has none
    meaning: str  # in words
    axes: tuple[int, ...] = ()  # sizes after (H, W)
    optional: bool = False  # whether a result can lack it
    derived: bool = False  # whether it follows from other maps, so that a result's file omits it
    kept_as: str = ""  # its name in the choice of a batch; "" if a batch keeps it only in complete results
    plane: str = ""  # name of the map on the live page; "" if the page does not draw it by itself
    plane_step: float = 0.0  # of the page's 8-bit levels, in the map's unit; 0 if there are none
    colors: str = ""  # matplotlib's name of the color map; "" if no picture shows the map by itself


def row(*written: Any, name: str = "", **more: Any) -> dict[str, Any]:
    """The row of a field: that of its `ResultMap`, without a name where it is the field's."""
    return {"row": lambda of: ResultMap(name or of, *written, **more)}


@dataclass(frozen=True, eq=False)
class ResultMaps:
    """The maps of a result, each with its row: a Reconstructor's follow from the `FrameRecord` attributes of their names."""

    depth: Map = field(
        metadata=row(
            "float32", "mm", "indentation", name="depth_mm", kept_as="depth", plane="depth", colors="viridis"
        )
    )
    depth_sigma_mm: Map | None = field(
        metadata=row(
            "float32",
            "mm",
            "one standard deviation of depth",
            optional=True,
            kept_as="depth_sigma",
            plane="sigma",
            plane_step=0.002,
        )
    )
    gradients: Slopes = field(
        metadata=row("float32", "mm/mm", "slopes of the depth", (2,), kept_as="gradients", colors="RdBu_r")
    )
    gradients_sigma: Map | None = field(
        metadata=row("float32", "mm/mm", "one standard deviation of them", (2,), optional=True)
    )
    confidence: Map = field(
        metadata=row(
            "float32",
            "",
            "how far a slope can be trusted, 0-1",
            kept_as="confidence",
            plane="confidence",
            plane_step=1 / 255,
            colors="gray",
        )
    )
    contact: Mask = field(metadata=row("bool", "", "where something touches", kept_as="contact"))
    known: Mask = field(metadata=row("bool", "", "where depth is not just filled in", kept_as="known"))
    _: KW_ONLY
    observed_gradients: Slopes | None = field(
        default=None, metadata=row("float32", "mm/mm", "slopes read from color", (2,), optional=True)
    )


NORMALS = ResultMap("normals", "float32", "", "unit normals", (3,), derived=True, kept_as="normals")
MAPS: dict[str, ResultMap] = {
    one.name: one for one in (*(one.metadata["row"](one.name) for one in fields(ResultMaps)), NORMALS)
}  # fmt: skip
KEPT_MAPS: dict[str, ResultMap] = {row.kept_as: row for row in MAPS.values() if row.kept_as}
MAP_PLANES: dict[str, ResultMap] = {row.plane: row for row in MAPS.values() if row.plane}
BESIDE_DEPTH = tuple(row for row in MAPS.values() if row.name != "depth_mm" and not row.derived)
