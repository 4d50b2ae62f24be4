"""`hierarchical` with terms of the depth: pressed gel is nearer to or farther from the lamps than untouched gel.

A map from colour to slope that was learnt inside contacts knows the light at the depth of contacts. Around them the gel
is less deep, the lamps stand otherwise, and slopes there are read low or high. So the depth z of the whole frame is
read first by the plain map, and the slopes are read again with `z (1, x, y)` and `z (R, G, B)` beside its terms; then
once more, with the depth of these. What it learns from is the depth that the plain map reads, never the ball's.

One ball at one depth says nothing of depth: there it is as deep as it is steep. How large the terms of the depth are
all together, balls say badly; flat punches of known height say it (`calibration.heights`). See
docs/choosing-a-color-model.md.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from gelform.color_models._shared.least_squares import unit_position
from gelform.color_models._shared.nodes import fitted_nodes
from gelform.color_models.depth_aware.frame_depth import FrameDepth, untouched_change
from gelform.color_models.hierarchical import HierarchicalModel
from gelform.color_models.seam import Samples, Variant, check_image_shape

PLACE_PENALTIES = (
    3.0,
    12.0,
    12.0,
)  # of z, z x and z y, beside a coefficient of colour that is the same everywhere
COLOR_PENALTIES = (3.0, 3.0, 3.0)

Read = Callable[[NDArray[np.float32]], NDArray[np.float32]]


@dataclass(frozen=True)
class DepthAwareModel:
    """A plain model for the first depth, and one with terms of the depth.

    Attributes
    ----------
    plain : what reads the first depth
    beside : the terms of colour and place that stand beside those of the depth
    place : (3, 2), slopes per px of depth at the image's centre, and per unit of x and y
    color : (3, 2), slopes per px of depth and color change
    untouched : color changes up to it say untouched gel, where depth is 0
    """

    plain: HierarchicalModel
    beside: HierarchicalModel
    place: NDArray[np.float64]
    color: NDArray[np.float64]
    untouched: float

    name: ClassVar[str] = "depth_aware"
    change_offset: ClassVar[float] = HierarchicalModel.change_offset
    slow: ClassVar[bool] = False
    whole_frames: ClassVar[bool] = True  # a pixel alone does not say how deep it is

    @classmethod
    def fit(
        cls,
        samples: Samples,
        *,
        position_degrees: tuple[int, ...] = (5, 4, 3),
        ridge: float = 3e-4,
        share: float = 1.0,
    ) -> DepthAwareModel:
        """Penalised Huber regression, as `HierarchicalModel.fit`; samples without `depth_px` leave the depth out.

        Parameters
        ----------
        samples, position_degrees, ridge : as for `HierarchicalModel.fit`
        share : of `with_share`; presses of balls tell the terms of the depth but not well how large they are all together
        """
        plain = HierarchicalModel.fit(samples, position_degrees=position_degrees, ridge=ridge)
        untouched = untouched_change(samples)
        if samples.depth_px is None:
            return cls(plain, plain, np.zeros((3, 2)), np.zeros((3, 2)), untouched)
        depth = np.asarray(samples.depth_px, dtype=np.float64)
        scale = float(np.sqrt(np.average(depth**2, weights=samples.weight))) + 1e-12
        change = np.asarray(samples.color_change, dtype=np.float64)
        change_scale = float(np.sqrt(np.mean(change**2))) + 1e-12
        x, y = unit_position(samples.x_px, samples.y_px, samples.shape)
        columns = [np.stack([np.ones_like(x), x, y], axis=1), change / change_scale]
        terms = (depth / scale)[:, None] * np.concatenate(columns, axis=1)
        penalties = np.array([*PLACE_PENALTIES, *COLOR_PENALTIES])
        nodes, found = fitted_nodes(samples, position_degrees, ridge, terms, penalties)
        beside = replace(plain, nodes=nodes)
        whole = cls(plain, beside, found[:3] / scale, found[3:] / (scale * change_scale), untouched)
        return whole.with_share(share)

    def with_share(self, share: float) -> DepthAwareModel:
        """The model on the line from the plain one (share 0) to this one (1), and beyond it."""
        nodes = self.plain.nodes + share * (self.beside.nodes - self.plain.nodes)
        beside = replace(self.beside, nodes=nodes)
        return replace(self, beside=beside, place=share * self.place, color=share * self.color)

    @classmethod
    def depth_reader(cls, samples: Samples, **settings: Any) -> Read:
        """What reads the `depth_px` (H, W) of samples from a frame's color change (H, W, 3), as this model will in use."""
        model = cls.fit(replace(samples, depth_px=None), **settings)
        prepared = PreparedDepthAware(model)
        return prepared.plain_depth

    @classmethod
    def variants(cls, presses: int) -> list[Variant]:
        """Those of `hierarchical`, with 12 numbers more each; by name only."""
        return [
            Variant(plain.complexity + 12, plain.settings, in_auto=False)
            for plain in HierarchicalModel.variants(presses)
        ]

    def gradients_at(
        self, color_change: NDArray[Any], x_px: NDArray[Any], y_px: NDArray[Any]
    ) -> NDArray[np.float64]:
        """Gradients (N, 2) of scattered pixels of no depth: how deep they are, only a whole frame can say."""
        return self.beside.gradients_at(color_change, x_px, y_px)

    def prepare(self, background: NDArray[Any], shape: tuple[int, int]) -> PreparedDepthAware:
        """Both models, and a solver for the depth."""
        check_image_shape(shape, self.plain.shape)
        return PreparedDepthAware(self)

    def to_arrays(self) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
        """The coefficients."""
        arrays = {
            "plain_nodes": self.plain.nodes,
            "nodes": self.beside.nodes,
            "place": self.place,
            "color": self.color,
        }
        return arrays, {**self.plain.to_arrays()[1], "untouched": self.untouched}

    @classmethod
    def from_arrays(cls, arrays: dict[str, NDArray[Any]], settings: dict[str, Any]) -> DepthAwareModel:
        """The model of `to_arrays`."""
        plain = HierarchicalModel.from_arrays({"nodes": arrays["plain_nodes"]}, settings)
        beside = HierarchicalModel.from_arrays({"nodes": arrays["nodes"]}, settings)
        return cls(plain, beside, arrays["place"], arrays["color"], settings["untouched"])


class PreparedDepthAware:
    """Both models for whole frames, and a solver for the depth; immutable, shared by threads.

    Attributes
    ----------
    place : (H, W, 2), slopes per px of depth without a color change
    color : (3, 2), slopes per px of depth and color change
    """

    def __init__(self, model: DepthAwareModel) -> None:
        shape = model.plain.shape
        self._plain, self._beside = (one.prepare(np.empty(0), shape) for one in (model.plain, model.beside))
        x, y = unit_position(*np.meshgrid(np.arange(shape[1]), np.arange(shape[0])), shape)
        place = np.stack([np.ones_like(x), x, y], axis=-1) @ model.place
        self.place, self.color = place.astype(np.float32), model.color.astype(np.float32)
        self._depth = FrameDepth(shape, model.untouched)

    def gradients_from_color(self, color_change: NDArray[np.float32]) -> tuple[NDArray[np.float32], None]:
        """Gradients (H, W, 2) of a color change (H, W, 3); their deviation is the calibration's."""
        beside, _ = self._beside.gradients_from_color(color_change)
        per_depth = color_change @ self.color
        per_depth += self.place
        depth = self.plain_depth(color_change)
        again = self._depth(color_change, beside + depth[..., None] * per_depth)
        beside += again[..., None] * per_depth
        return beside, None

    def plain_depth(self, color_change: NDArray[np.float32]) -> NDArray[np.float32]:
        """Depth (H, W) that the plain model reads, in pixels, at least 0."""
        return self._depth(color_change, self._plain.gradients_from_color(color_change)[0])

    def depth(self, color_change: NDArray[np.float32]) -> NDArray[np.float32]:
        """Depth (H, W) that this model reads, in pixels, at least 0."""
        return self._depth(color_change, self.gradients_from_color(color_change)[0])
