"""The table of the maps of a result, which files, batches, the live page, pictures and help read."""

from __future__ import annotations

from dataclasses import dataclass


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


MAPS: dict[str, ResultMap] = {
    row.name: row
    for row in (
        ResultMap("depth_mm", "float32", "mm", "indentation", kept_as="depth", plane="depth", colors="viridis"),
        ResultMap("known", "bool", "", "where depth is not just filled in", kept_as="known"),
        ResultMap(
            "depth_sigma_mm", "float32", "mm", "one standard deviation of depth", optional=True,
            kept_as="depth_sigma", plane="sigma", plane_step=0.002,
        ),
        ResultMap("gradients", "float32", "mm/mm", "slopes of the depth", (2,), kept_as="gradients", colors="RdBu_r"),
        ResultMap("gradients_sigma", "float32", "mm/mm", "one standard deviation of them", (2,), optional=True),
        ResultMap("observed_gradients", "float32", "mm/mm", "slopes read from color", (2,), optional=True),
        ResultMap("normals", "float32", "", "unit normals", (3,), derived=True, kept_as="normals"),
        ResultMap(
            "confidence", "float32", "", "how far a slope can be trusted, 0-1",
            kept_as="confidence", plane="confidence", plane_step=1 / 255, colors="gray",
        ),
        ResultMap("contact", "bool", "", "where something touches", kept_as="contact"),
    )
}  # fmt: skip
KEPT_MAPS: dict[str, ResultMap] = {row.kept_as: row for row in MAPS.values() if row.kept_as}
MAP_PLANES: dict[str, ResultMap] = {row.plane: row for row in MAPS.values() if row.plane}
BESIDE_DEPTH = tuple(row for row in MAPS.values() if row.name != "depth_mm" and not row.derived)
