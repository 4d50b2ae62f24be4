"""`hierarchical` on colours as they would be at depth 0, by the law of near lights.

Under a lamp at the height h and the distance d beside it, gel that is pressed in by z is nearer to the lamp: slopes change
the light more there, by the factor 1 + 3 h z/(h^2 + d^2), and the level one is lighter by z (3 h/(h^2 + d^2) - 1/h). A map
from colour to slope that was learnt inside contacts knows their light, and reads the gel around them too flat. Where the
lamps are, slopes say, not depths: the light of a slope turns and grows over the image as lamps near or far let it. So the
lamps are found by `NearLightModel`, the depth of the frame is read by a plain map, and its colours are carried to depth 0
before a second map reads them. No coefficient is fitted to the depth: inside contacts what is deep is also gently sloped,
and a regression takes the one for the other.

Where near lamps do not explain the colours (a scattering gel, a reflecting wall) nothing of this is known: `unexplained`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from gelform.color_models._shared.least_squares import unit_position
from gelform.color_models._shared.near_light_law import Toward, light_ratio
from gelform.color_models.depth_aware.frame_depth import FrameDepth, untouched_change
from gelform.color_models.hierarchical import HierarchicalModel
from gelform.color_models.near_light import NearLightModel
from gelform.color_models.seam import Samples, Variant, check_image_shape

LIGHT_SAMPLES = 800
SMALL_DEPTH = 0.002  # of half the image's larger side: for a difference quotient

Read = Callable[[NDArray[np.float32]], NDArray[np.float32]]


@dataclass(frozen=True)
class DepthByLightsModel:
    """A plain model for the depth of the frame, near lights, and a model of colours at depth 0.

    Attributes
    ----------
    plain : what reads the depth
    beside : what reads the slopes, from colours that are carried to depth 0
    lights : by whose law they are
    unexplained : part of the training samples' color change, root mean square, that the lights do not explain
    untouched : color changes up to it say untouched gel, where depth is 0
    """

    plain: HierarchicalModel
    beside: HierarchicalModel
    lights: NearLightModel
    unexplained: float
    untouched: float

    name: ClassVar[str] = "depth_by_lights"
    change_offset: ClassVar[float] = HierarchicalModel.change_offset
    slow: ClassVar[bool] = False
    whole_frames: ClassVar[bool] = True  # a pixel alone does not say how deep it is

    @classmethod
    def fit(
        cls, samples: Samples, *, position_degrees: tuple[int, ...] = (5, 4, 3), ridge: float = 3e-4
    ) -> DepthByLightsModel:
        """Two fits of `HierarchicalModel` and one of `NearLightModel`; samples without `depth_px` leave the depth out.

        Parameters
        ----------
        samples, position_degrees, ridge : as for `HierarchicalModel.fit`
        """
        plain = HierarchicalModel.fit(samples, position_degrees=position_degrees, ridge=ridge)
        lights, unexplained = cls.lights_of(samples)
        found = cls(plain, plain, lights, unexplained, untouched_change(samples))
        if samples.depth_px is None:
            return found
        lighter, stronger = light_per_depth(lights, samples.x_px, samples.y_px)
        depth = np.asarray(samples.depth_px, dtype=np.float64)[:, None]
        level = (samples.color_change - depth * lighter * _seen_at(samples)) / (1 + depth * stronger)
        beside = HierarchicalModel.fit(
            replace(samples, color_change=level), position_degrees=position_degrees, ridge=ridge
        )
        return replace(found, beside=beside)

    @classmethod
    def lights_of(cls, samples: Samples) -> tuple[NearLightModel, float]:
        """Near lights fitted to the contacts, and the part of their color change, root mean square, left unexplained."""
        change = np.asarray(samples.color_change, dtype=np.float64)
        ratios = replace(samples, color_change=change / _seen_at(samples))
        lights = NearLightModel.fit(_some_pressed(ratios))
        return lights, _unexplained(lights, ratios)

    @classmethod
    def depth_reader(cls, samples: Samples, **settings: Any) -> Read:
        """What reads the `depth_px` (H, W) of samples from a frame's color change (H, W, 3), as this model will in use."""
        plain = HierarchicalModel.fit(samples, **settings).prepare(np.empty(0), samples.shape)
        depth = FrameDepth(samples.shape, untouched_change(samples))
        return lambda color_change: depth(color_change, plain.gradients_from_color(color_change)[0])

    @property
    def carries(self) -> bool:
        """Whether colours are carried to depth 0; fitted without depths, what reads the slopes knows them as they are."""
        return not np.array_equal(self.plain.nodes, self.beside.nodes)

    @cached_property
    def frame_depth(self) -> FrameDepth:
        """What reads the depth of a frame from the slopes of `plain`."""
        return FrameDepth(self.plain.shape, self.untouched)

    @cached_property
    def per_depth(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """`light_per_depth` on the grid of `frame_depth`, (rows, columns, 3) each: the same for every background."""
        x, y = self.frame_depth.coarse_positions()
        lighter, stronger = light_per_depth(self.lights, x.ravel(), y.ravel())
        return lighter.reshape(*x.shape, 3), stronger.reshape(*x.shape, 3)

    @classmethod
    def variants(cls, presses: int) -> list[Variant]:
        """Those of `hierarchical`, and the lights; `auto` tries it by a rule of its own."""
        return [
            Variant(plain.complexity + 8, plain.settings, in_auto=False)
            for plain in HierarchicalModel.variants(presses)
        ]

    def gradients_at(
        self, color_change: NDArray[Any], x_px: NDArray[Any], y_px: NDArray[Any]
    ) -> NDArray[np.float64]:
        """Gradients (N, 2) of scattered pixels of no depth: how deep they are, only a whole frame can say."""
        return self.beside.gradients_at(color_change, x_px, y_px)

    def prepare(self, background: NDArray[Any], shape: tuple[int, int]) -> PreparedDepthByLights:
        """Both maps, the light's change with depth at every pixel, and a solver for the depth."""
        check_image_shape(shape, self.plain.shape)
        return PreparedDepthByLights(self, background)

    def to_arrays(self) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
        """The coefficients, and the lights."""
        lights, settings = self.lights.to_arrays()
        arrays = {"plain_nodes": self.plain.nodes, "nodes": self.beside.nodes, **lights}
        known = {"lights": settings, "unexplained": self.unexplained, "untouched": self.untouched}
        return arrays, {**self.plain.to_arrays()[1], **known}

    @classmethod
    def from_arrays(cls, arrays: dict[str, NDArray[Any]], settings: dict[str, Any]) -> DepthByLightsModel:
        """The model of `to_arrays`."""
        plain, beside = (
            HierarchicalModel.from_arrays({"nodes": arrays[name]}, settings)
            for name in ("plain_nodes", "nodes")
        )
        lights = NearLightModel.from_arrays(arrays, settings["lights"])
        return cls(plain, beside, lights, settings["unexplained"], settings["untouched"])


def light_per_depth(
    lights: NearLightModel, x_px: NDArray[Any], y_px: NDArray[Any]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """How the light of pixels changes per px of depth, to first order.

    Returns
    -------
    lighter : (N, 3), what level gel becomes lighter by, relative to the untouched gel
    stronger : (N, 3), by which part of itself the effect of a slope grows
    """
    half = max(lights.shape) / 2
    x, y = unit_position(x_px, y_px, lights.shape)
    at_rest, pressed = (
        _light_at(lights, x, y, depth, lights.positions_px / half) for depth in (0, SMALL_DEPTH)
    )
    level = pressed[..., 2] / at_rest[..., 2]
    slopes, deeper = (one[..., :2] / at_rest[..., 2:] for one in (at_rest, pressed))
    square = np.maximum(np.einsum("nck,nck->nc", slopes, slopes), 1e-12)
    gain = np.einsum("nck,nck->nc", slopes, deeper) / square
    per_px, response = SMALL_DEPTH * half, lights.response
    return (level**response - 1) / per_px, (gain * level ** (response - 1) - 1) / per_px


def _light_at(
    lights: NearLightModel,
    x: NDArray[np.float64],
    y: NDArray[np.float64],
    depth: float,
    positions: NDArray[np.float64],
) -> NDArray[np.float64]:
    """What a normal is multiplied by for the light of each channel, (N, 3 channels, 3), at a depth."""
    nearer = positions - np.array([0, 0, depth])
    toward = Toward.of(x, y, nearer, lights.falloff)
    # `Toward` measures strengths against that at the lamp's own distance from the centre, which the depth must not change.
    power = (np.sum(positions**2, axis=1) / np.sum(nearer**2, axis=1)) ** (lights.falloff / 2)
    light: NDArray[np.float64] = np.einsum("cl,nlk->nck", lights.mixture * power, toward.light)
    return light


def _seen_at(samples: Samples) -> NDArray[np.float64] | float:
    """Color change over the relative change of the light (N, 3), which the offset of the division makes less."""
    if samples.background is None:
        return 1.0
    rows, columns = (np.asarray(at).astype(np.intp) for at in (samples.y_px, samples.x_px))
    return _seen(samples.background[rows, columns])


def _seen(background: NDArray[Any]) -> NDArray[np.float64]:
    light = np.maximum(np.asarray(background, dtype=np.float64), 1.0)
    return light / (light + HierarchicalModel.change_offset)


def _some_pressed(samples: Samples) -> Samples:
    """About 800 of the samples with a slope: sixteen numbers need no more."""
    known = np.flatnonzero(np.any(samples.gradients != 0, axis=1))
    known = known[:: max(1, len(known) // LIGHT_SAMPLES)]
    columns = ("color_change", "x_px", "y_px", "gradients", "weight")
    part = {name: getattr(samples, name)[known] for name in columns}
    return Samples(**part, shape=samples.shape)


def _unexplained(lights: NearLightModel, samples: Samples) -> float:
    known = np.any(samples.gradients != 0, axis=1)
    normals = np.concatenate([-samples.gradients[known], np.ones((np.count_nonzero(known), 1))], axis=1)
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    x, y = unit_position(samples.x_px[known], samples.y_px[known], samples.shape)
    positions = lights.positions_px / (max(lights.shape) / 2)
    ratio = light_ratio(normals, x, y, positions, lights.mixture, lights.falloff)
    error = ratio**lights.response - 1 - samples.color_change[known]
    return float(np.sqrt(np.mean(error**2) / np.mean(samples.color_change[known] ** 2)))


class PreparedDepthByLights:
    """Both maps for whole frames, the light's change with depth, and a solver; immutable, shared by threads.

    Attributes
    ----------
    lighter, stronger : (rows, columns, 3), `light_per_depth` on the coarser grid, `lighter` as a color change
    """

    def __init__(self, model: DepthByLightsModel, background: NDArray[Any]) -> None:
        shape = model.plain.shape
        self._plain, self._beside = (one.prepare(background, shape) for one in (model.plain, model.beside))
        self._carries = model.carries
        self._depth, (lighter, stronger) = model.frame_depth, model.per_depth
        seen = self._depth.made_coarse(_seen(background)) if background.size else 1.0
        self.lighter, self.stronger = (lighter * seen).astype(np.float32), stronger.astype(np.float32)

    def gradients_from_color(self, color_change: NDArray[np.float32]) -> tuple[NDArray[np.float32], None]:
        """Gradients (H, W, 2) of a color change (H, W, 3); their deviation is the calibration's."""
        plain, _ = self._plain.gradients_from_color(color_change)
        if not self._carries:
            return plain, None
        depth = self._depth.coarse(color_change, plain)[..., None]
        level = color_change - self._depth.in_full(depth * self.lighter)
        level *= self._depth.in_full(1 / (1 + depth * self.stronger))
        return self._beside.gradients_from_color(level)[0], None

    def depth(self, color_change: NDArray[np.float32]) -> NDArray[np.float32]:
        """Depth (H, W) that this model reads, in pixels, at least 0."""
        return self._depth(color_change, self.gradients_from_color(color_change)[0])
