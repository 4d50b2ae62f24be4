"""Simulated presses: an image with its truth, sets of them, sequences, and a twin's, which look like one real sensor's."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np

from gelform.arrays import Array, Image, Map, Numbers
from gelform.calibration_file import Calibration
from gelform.errors import Progress, no_progress
from gelform.foundations.checks import check_is, check_positive
from gelform.image.background import image_from_color_change
from gelform.simulate.gel import (
    Drag,
    Gel,
    Surface,
    ball_press,
    depth_of_ball,
    displacement_at,
    flat_surface,
    surface_from_indenter,
)
from gelform.simulate.indenters import Ball, Indenter, Pair, Pose, Posed
from gelform.simulate.light import (
    Rendered,
    draws,
    normal_table,
    px_from_mm,
    render,
    saturated_from_levels,
    simulate_background,
)
from gelform.simulate.sensor import Led, SimulatedSensor


@dataclass(frozen=True)
class SimulatedPress(Rendered):
    """An image and its truth, on the image's grid.

    Attributes
    ----------
    image : (H, W, 3) uint8, or float64 where not quantized, RGB
    depth_mm : (H, W) float64, the surface at the pixels' centers, positive where pressed
    gradients : (H, W, 2) float64, its slopes there, mm/mm
    contact : (H, W) bool
    indenter : the pressed indenter
    center_mm : (x, y), position of its center, mm from the gel's center
    center_px : (x, y), the same in pixels
    press_depth_mm : depth of its foremost point in the gel
    contact_radius_px : of the circle in which gel and ball touch; None for other indenters
    albedo : (H, W) float32, reflectance with dust and markers; 1 is the clean coating
    shadowed : (H, W) bool, where at least half of some light is lost to the surface
    saturated : (H, W) bool, where some channel is cut at 0 or 255
    markers_px : (N, 2), positions of the markers, x and y; some lie outside the image
    markers_shift_mm : (N, 2), their displacement from rest
    pose : Pose
    time_s : float, time since the LEDs were switched on
    """

    indenter: Indenter
    center_mm: tuple[float, float]
    center_px: tuple[float, float]
    press_depth_mm: float
    contact_radius_px: float | None
    markers_shift_mm: Numbers
    pose: Pose
    time_s: float = 0.0

    @property
    def normals(self) -> Numbers:
        """Unit normals (H, W, 3), n_z > 0."""
        n = np.concatenate([-self.gradients, np.ones_like(self.gradients[..., :1])], axis=-1)
        return np.asarray(n / np.linalg.norm(n, axis=-1, keepdims=True), dtype=np.float64)

    @property
    def ball_diameter_mm(self) -> float:
        """Diameter of the pressed ball; an error for any other indenter."""
        if not isinstance(self.indenter, Ball):
            raise ValueError(f"Expected the press of a ball, got one of a {type(self.indenter).__name__}.")
        return 2 * self.indenter.radius_mm


def simulate_press(
    sensor: SimulatedSensor,
    indenter: Indenter,
    *,
    depth_mm: float,
    center_mm: tuple[float, float] = (0.0, 0.0),
    rng: np.random.Generator | None,
    spin_deg: float = 0.0,
    tilt_deg: tuple[float, float] = (0.0, 0.0),
    oversample: int = 3,
    quantise: bool = True,
) -> SimulatedPress:
    """The image of an indenter pressed into the gel, and its truth.

    Light is computed on a grid `oversample` times finer and averaged over each pixel; the truth is that
    grid's middle sample: the surface at the pixel's center.

    Parameters
    ----------
    depth_mm : depth of the indenter's foremost point in the gel
    center_mm : (x, y), position of the indenter from the gel's center, x to the right, y down
    rng : for the noise; None: no noise
    spin_deg, tilt_deg : float, (about x, about y), turn of the indenter; see `Posed`
    oversample : odd int
    quantise : False: float64 levels, neither rounded nor cut at 0 and 255

    Raises
    ------
    ValueError
        A depth that is not positive or goes through the gel, an even oversample, or an indenter that does
        not touch the gel within the image.
    """
    check_positive(depth_mm, "depth_mm")
    pose = Pose(depth_mm, center_mm, spin_deg, tilt_deg)
    press = simulate_pose(sensor, indenter, pose, rng=rng, oversample=oversample, quantise=quantise)
    if not press.contact.any():
        height, width = (n * sensor.mm_per_px for n in sensor.shape)
        raise ValueError(
            f"Expected an indenter that touches the gel within the image, got none at center_mm={center_mm} "
            f"pressed {depth_mm:g} mm: the image spans {width:.3g} x {height:.3g} mm."
        )
    return press


def check_press_depth(sensor: SimulatedSensor, depth_mm: float) -> None:
    """Refuse (ValueError) a press through the gel."""
    if depth_mm >= sensor.gel.thickness_mm:
        thickness = f"{sensor.gel.thickness_mm:g} mm"
        raise ValueError(f"Expected depth_mm less than the gel's thickness, {thickness}, got {depth_mm:g}.")


def simulate_pose(
    sensor: SimulatedSensor,
    indenter: Indenter,
    pose: Pose,
    *,
    rng: np.random.Generator | None,
    oversample: int = 1,
    quantise: bool = True,
    drag: Drag | None = None,
    time_s: float = 0.0,
) -> SimulatedPress:
    """The image of an indenter at a pose, touching or not, and its truth.

    `drag` remembers the earlier poses; without it the gel is not dragged.
    """
    if oversample < 1 or oversample % 2 == 0:
        raise ValueError(f"Expected oversample as an odd number (1, 3, 5), got {oversample}.")
    check_press_depth(sensor, pose.depth_mm)
    surface = _pressed(sensor, indenter, pose, oversample)
    rest = sensor.coating.markers_mm(sensor.shape, sensor.mm_per_px)
    shift = np.zeros_like(rest)
    if len(rest):
        coarse = surface.middles(oversample).middles(4)  # drag is smooth over the gel's thickness
        shift = displacement_at((drag or Drag(sensor.gel))(coarse, pose), coarse, rest)
    rendered = render(
        sensor,
        surface,
        rng=rng,
        oversample=oversample,
        quantise=quantise,
        markers_mm=rest + shift,
        time_s=time_s,
    )
    radius_mm, rim_mm = _rim(sensor, indenter, pose.depth_mm)
    center = px_from_mm(sensor, np.array([pose.center_mm]), rim_mm)[0]
    return SimulatedPress(
        **vars(rendered),
        indenter=indenter,
        center_mm=pose.center_mm,
        center_px=(float(center[0]), float(center[1])),
        press_depth_mm=pose.depth_mm,
        contact_radius_px=None if radius_mm is None else radius_mm / sensor.mm_per_px,
        markers_shift_mm=shift,
        pose=pose,
        time_s=time_s,
    )


def _pressed(sensor: SimulatedSensor, indenter: Indenter, pose: Pose, oversample: int) -> Surface:
    """The gel's surface on the subpixel grid; all faces but a ball's are solved on a wider grid."""
    if pose.depth_mm <= 0:
        return flat_surface(*sensor.grid_mm(oversample))
    press: dict[str, Any] = {"center_mm": pose.center_mm, "depth_mm": pose.depth_mm}
    press |= {"relaxation_mm": sensor.relaxation_mm, "gel": sensor.gel}
    if isinstance(indenter, Ball):
        return surface_from_indenter(indenter, *sensor.grid_mm(oversample), **press)
    # The gel extends four relaxation lengths beyond the image, where e^-4 = 2 % is left.
    margin = int(np.ceil(4 * sensor.relaxation_mm / sensor.mm_per_px * oversample))
    turned = pose.spin_deg != 0 or pose.tilt_deg != (0, 0)
    posed = Posed(indenter, pose.spin_deg, pose.tilt_deg) if turned else indenter
    wide = surface_from_indenter(posed, *sensor.grid_mm(oversample, margin), **press)
    return wide.sampled(slice(margin, -margin or None))


def _rim(sensor: SimulatedSensor, indenter: Indenter, depth_mm: float) -> tuple[float | None, float]:
    """Contact radius of a ball in the image, and the depth of the rim, mm; None and 0 for others."""
    if not isinstance(indenter, Ball) or depth_mm <= 0:
        return None, 0.0
    radius = indenter.radius_mm
    a = ball_press(radius, depth_mm, sensor.relaxation_mm, sensor.gel).contact_radius_mm
    rim = depth_mm - radius + float(np.sqrt(radius**2 - a**2))
    height = sensor.optics.height_mm
    return (a if height is None else a / (1 - rim / height)), rim


RIM_SLOPES = (0.5, 0.95)  # mm/mm at the contact's rim, as when a hand presses a GelSight


@dataclass(frozen=True)
class SimulatedPresses:
    """A background and presses of one simulated sensor: the content of a press folder, and the truth."""

    sensor: SimulatedSensor
    background: Image
    presses: tuple[SimulatedPress, ...]


def simulate_ball_presses(
    sensor: SimulatedSensor,
    *,
    ball_diameters_mm: Sequence[float],
    count: int,
    rng: np.random.Generator,
    oversample: int = 3,
    progress: Progress = no_progress,
) -> SimulatedPresses:
    """A background and `count` presses of balls, spread over the image; some are cut by its border.

    The balls take turns. Centers lie on a low-discrepancy sequence that fills the image evenly; depths give
    slopes of 0.5-0.95 at the contact's rim, as a hand that presses a GelSight does. Each press has its own
    random stream, so it does not depend on the others.
    """
    if count < 1 or len(ball_diameters_mm) == 0:
        raise ValueError(f"Expected count >= 1 and a ball, got {count} and {list(ball_diameters_mm)}.")
    check_balls(sensor, ball_diameters_mm)
    background_rng, place_rng, *press_rngs = check_is(rng, np.random.Generator, "rng").spawn(count + 2)
    shift = place_rng.random(2)
    presses = []
    for k, press_rng in enumerate(press_rngs):
        presses.append(_ball_press(sensor, ball_diameters_mm, k, shift, press_rng, oversample))
        progress(k + 1, count, "simulating presses of a ball")
    return SimulatedPresses(sensor, simulate_background(sensor, background_rng), tuple(presses))


def check_balls(sensor: SimulatedSensor, ball_diameters_mm: Sequence[float]) -> None:
    """Refuse (ValueError) balls whose contact is no pixel wide, or that go through the gel; the message has the range."""
    smallest, largest = 4 * sensor.mm_per_px, largest_ball_mm(sensor)  # the flattest contact is 1.8 px wide
    for diameter in ball_diameters_mm:
        if not smallest <= diameter <= largest:
            raise ValueError(
                f"Expected ball_diameter_mm from {smallest:.3g} to {largest:.3g} mm, got {diameter:g}: pixels of "
                f"{sensor.mm_per_px:g} mm see none that is smaller, a larger one goes through the gel, "
                f"{sensor.gel.thickness_mm:g} mm thick."
            )


def largest_ball_mm(sensor: SimulatedSensor) -> float:
    """Diameter, mm, of the largest ball whose deepest press in a set stays within the gel; at most 1000."""
    low, high = 0.0, 1000.0
    for _ in range(40):  # halvings of the interval, to 1e-9 mm
        middle = (low + high) / 2
        deepest = depth_of_ball(middle / 2, RIM_SLOPES[1], sensor.relaxation_mm, sensor.gel)
        deep = deepest >= sensor.gel.thickness_mm
        low, high = (low, middle) if deep else (middle, high)
    return low


def ball_press_of_set(
    sensor: SimulatedSensor, ball_diameters_mm: Sequence[float], k: int, *, seed: int, oversample: int = 3
) -> SimulatedPress:
    """The k-th press of `simulate_ball_presses` with `rng=numpy.random.default_rng(seed)`, by itself."""
    place_rng, press_rng = (
        np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(n,))) for n in (1, k + 2)
    )
    return _ball_press(sensor, ball_diameters_mm, k, place_rng.random(2), press_rng, oversample)


def _ball_press(
    sensor: SimulatedSensor,
    ball_diameters_mm: Sequence[float],
    k: int,
    shift: Numbers,
    rng: np.random.Generator,
    oversample: int,
) -> SimulatedPress:
    """The k-th press: a ball of its turn, at the k-th point of Roberts' R2 sequence (2018).

    The points fill all but the outermost 2 % of the image.
    """
    ball = Ball(ball_diameters_mm[k % len(ball_diameters_mm)] / 2)
    depth = depth_of_ball(ball.radius_mm, rng.uniform(*RIM_SLOPES), sensor.relaxation_mm, sensor.gel)
    plastic = 1.32471795724474602596
    unit = (shift + (k + 1) / np.array([plastic, plastic**2])) % 1
    height, width = sensor.shape
    x, y = (unit - 0.5) * 0.96 * np.array([width, height]) * sensor.mm_per_px
    center = float(x), float(y)
    return simulate_press(sensor, ball, depth_mm=depth, center_mm=center, rng=rng, oversample=oversample)


def simulate_sequence(
    sensor: SimulatedSensor,
    indenter: Indenter,
    poses: Iterable[Pose],
    *,
    rng: np.random.Generator | None,
    oversample: int = 1,
    start_s: float = 0.0,
) -> Iterator[SimulatedPress | None]:
    """Images of an indenter that moves from pose to pose, one per frame of the sensor's camera.

    The surface is dragged along (`markers_shift_mm`), the light drifts and flickers; a dropped frame
    is None. Poses may be off the gel (depth 0 or less).
    """
    drag = Drag(sensor.gel)
    for k, pose in enumerate(poses):
        press = simulate_pose(
            sensor,
            indenter,
            pose,
            rng=rng,
            oversample=oversample,
            drag=drag,
            time_s=start_s + k / sensor.timing.frame_rate_hz,
        )
        dropped = rng is not None and rng.random() < sensor.timing.drop_probability
        yield None if dropped else press


def press_poses(depth_mm: float, count: int, *, center_mm: Pair = (0.0, 0.0)) -> tuple[Pose, ...]:
    """Poses from first touch to `depth_mm` in equal steps."""
    return tuple(Pose(d, center_mm) for d in _steps(0, depth_mm, count))


def slide_poses(depth_mm: float, start_mm: Pair, end_mm: Pair, count: int) -> tuple[Pose, ...]:
    """Poses along a line at one depth, which drag the surface."""
    return tuple(Pose(depth_mm, (x, y)) for x, y in _steps(start_mm, end_mm, count))


def roll_poses(depth_mm: float, start_mm: Pair, end_mm: Pair, count: int) -> tuple[Pose, ...]:
    """Poses along a line at one depth of a rolling ball or cylinder; the touched side does not move."""
    return tuple(Pose(depth_mm, (x, y), carried_mm=start_mm) for x, y in _steps(start_mm, end_mm, count))


def twist_poses(
    depth_mm: float, angle_deg: float, count: int, *, center_mm: Pair = (0.0, 0.0)
) -> tuple[Pose, ...]:
    """Poses that turn in place about the view axis, from 0 to `angle_deg`."""
    return tuple(Pose(depth_mm, center_mm, angle) for angle in _steps(0, angle_deg, count))


def _steps(start: float | Pair, end: float | Pair, count: int) -> list[Any]:
    if count < 1:
        raise ValueError(f"Expected count >= 1 poses, got {count}.")
    steps: list[Any] = np.linspace(start, end, count).tolist()
    return steps


STEEPEST_RENDERED = 1.2  # mm/mm; calibrations are fitted up to about 1, and a cubic is meaningless beyond


class SensorLook(Protocol):
    """The response of one sensor to a surface, which a twin shows."""

    @property
    def name(self) -> str: ...  # of the sensor
    @property
    def background(self) -> Map: ...  # (H, W, 3), background image
    @property
    def mm_per_px(self) -> float: ...
    @property
    def noise(self) -> Numbers: ...  # (3,), standard deviation of an image's pixel, gray levels

    def levels(self, gradients: Array, depth_mm: Array) -> Map:
        """Gray levels (H, W, 3), 0-255, for slopes (H, W, 2) and depths (H, W)."""
        ...


class CalibratedLook:
    """The look that a calibration has learned: its forward response to slope and depth.

    An imported response may depend on slope alone. The noise is that of the calibration's images, or that of its background
    if the former is unknown. Slopes over `STEEPEST_RENDERED` are rendered with it.
    """

    def __init__(self, calibration: Calibration) -> None:
        pitch_x, pitch_y = np.broadcast_to(np.asarray(calibration.known_mm_per_px, dtype=np.float64), 2)
        if abs(pitch_x / pitch_y - 1) > 1e-6:
            raise ValueError(
                f"Expected a calibration of square pixels, got mm_per_px={calibration.mm_per_px}."
            )
        self.calibration = calibration
        self.name = calibration.sensor_name
        self.background = calibration.background
        self.mm_per_px = float(pitch_x)
        known = calibration.settings.image_noise
        self.noise = np.asarray(calibration.background_noise if known is None else known, dtype=np.float64)

    def levels(self, gradients: Array, depth_mm: Array) -> Map:
        change = self.color_change(gradients, depth_mm)
        return image_from_color_change(change, self.background, self.calibration.change)

    def color_change(self, gradients: Array, depth_mm: Array) -> Map:
        """Expected color change (H, W, 3) for gradients (H, W, 2), with a limit on steep ones, and depths (H, W)."""
        steepness = np.linalg.norm(gradients, axis=-1, keepdims=True)
        limited = gradients * np.minimum(1, STEEPEST_RENDERED / np.maximum(steepness, 1e-12))
        forward = self.calibration.forward
        if forward is None:
            return self.calibration.color_from_gradients(limited)
        y, x = (axis.ravel() for axis in np.mgrid[: depth_mm.shape[0], : depth_mm.shape[1]])
        depth_px = depth_mm.ravel() / self.mm_per_px
        change = forward.color_from_gradients(limited.reshape(-1, 2), x, y, depth_px=depth_px)
        return change.reshape(*depth_mm.shape, 3).astype(np.float32)


class Twin:
    """A simulated sensor with the response of a real one, as far as its calibration or its tables describe it.

    The surface comes from the simulator's gel, and everything visible from the look. Dust and scratches are in its
    background. Cast shadows are missing, because they depend on more than slope and depth at a pixel.

    Parameters
    ----------
    look : a Calibration, or any `SensorLook`, such as another package's tables
    gel, relaxation_mm : of its gel; by default of a GelSight Mini's, fitted to ball presses
    """

    def __init__(
        self, look: Calibration | SensorLook, *, gel: Gel | None = None, relaxation_mm: float = 0.5
    ) -> None:
        if not isinstance(look, Calibration) and not hasattr(look, "levels"):
            raise TypeError(
                f"Expected a Calibration or a look with `levels`, got {type(look).__name__}. "
                "From a file: gelform.load_calibration(path)."
            )
        self.look: SensorLook = CalibratedLook(look) if isinstance(look, Calibration) else look
        height, width = self.look.background.shape[:2]
        self.sensor = SimulatedSensor(
            (Led((0.0, 0.0, 1e3), (1.0, 1.0, 1.0)),),
            name=f"like {self.look.name}",
            shape=(height, width),
            mm_per_px=self.look.mm_per_px,
            relaxation_mm=relaxation_mm,
            gel=gel or Gel(thickness_mm=3.5, bulge=0.5),
        )

    def press(
        self, indenter: Indenter, pose: Pose, *, rng: np.random.Generator | None, oversample: int = 1
    ) -> SimulatedPress:
        """The image of an indenter at a pose, and its truth."""
        return self.rendered(simulate_pose(self.sensor, indenter, pose, rng=None, oversample=oversample), rng)

    def ball_presses(
        self, *, ball_diameters_mm: Sequence[float], count: int, rng: np.random.Generator
    ) -> SimulatedPresses:
        """A background and presses of balls spread over the image, as `simulate_ball_presses` makes them."""
        made = simulate_ball_presses(
            self.sensor, ball_diameters_mm=ball_diameters_mm, count=count, rng=rng, oversample=1
        )
        presses = tuple(self.rendered(press, rng) for press in made.presses)
        return replace(made, background=self.background, presses=presses)

    @property
    def background(self) -> Image:
        """The background image, without noise."""
        return _gray(self.look.background)

    def rendered(self, press: SimulatedPress, rng: np.random.Generator | None) -> SimulatedPress:
        """A press of the twin's sensor with the look's image; `rng` is for its noise, None for none."""
        levels = self.look.levels(press.gradients, press.depth_mm)
        if rng is not None:
            drawn = normal_table()[draws(rng, levels.size)].reshape(levels.shape)
            levels = levels + drawn * self.look.noise.astype(np.float32)
        nowhere = np.zeros(press.contact.shape, dtype=bool)
        return replace(press, image=_gray(levels), shadowed=nowhere, saturated=saturated_from_levels(levels))


def _gray(levels: Array) -> Image:
    return np.clip(np.rint(levels), 0, 255).astype(np.uint8)
