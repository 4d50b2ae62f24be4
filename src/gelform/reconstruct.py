"""Reconstructor: the path from a frame to depth in one method."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from os import PathLike
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gelform.calibration_file import Calibration, as_calibration
from gelform.depth.contact import PreparedContact, SlopeDeviations, Surround, unknown_contact
from gelform.depth.frame import FrameDepth, Work
from gelform.depth.sigma.missing import MissingDepth
from gelform.depth.sigma.sigma import add_in_proportion
from gelform.depth.solvers.inputs import checked_solver, takes_weights
from gelform.depth.stepped import SteppedSlopes
from gelform.errors import GelformError
from gelform.foundations.checks import check_image
from gelform.foundations.findings import Finding
from gelform.foundations.pool import Pool, keep_freed_memory
from gelform.image.background.change import PreparedBackground
from gelform.image.background.check import background_digest, check_own_background, check_viewed_image
from gelform.image.background.light import FrameLight
from gelform.image.background.untouched import reference_from_color_change
from gelform.image.frame import Frame, as_levels, whole_levels
from gelform.image.health import DepthLimit, FrameFaults, FrameHealth, check_untouched_image
from gelform.image.markers import MarkerFlow, MarkerFollower
from gelform.image.view import image_from_frame
from gelform.result import Reconstruction
from gelform.slopes.color_models.forward_response import Step
from gelform.slopes.color_models.seam import AlbedoModel, gradients_from_pending
from gelform.slopes.confidence import (
    AllAlike,
    ClippedChannels,
    Explanation,
    PreparedCauses,
    PreparedSigma,
    SolvedSigma,
    SteepSlopes,
    UnknownSigma,
    all_shown,
    explanation_of,
    noise_at_rest,
    with_model_sigma,
    with_steep,
)
from gelform.slopes.confidence.causes import Clipped, either, outside_of_gel
from gelform.slopes.gradients import slopes_of_solution

# Values for an imported calibration without its own; they affect the contact mask and the anchor, but no slope.
USUAL_WIDTH_MM = 20.0  # mm, width of the frame on the gel; about that of a GelSight Mini
USUAL_SIGMA = 0.05  # mm/mm, standard deviation of a slope
BYTES_PER_PX = 80  # bytes that one frame allocates in all


class SeenImage(NamedTuple):
    """What an image shows, and what may be wrong with it: the first stage of reading its slopes.

    `image` is without its lost parts and markers; `unseen` are the pixels without gel or with too few usable channels.
    """

    raw: NDArray[Any]
    image: NDArray[Any]
    faults: FrameFaults
    flow: MarkerFlow | None
    markers: NDArray[np.bool_] | None
    hidden: NDArray[np.bool_] | None
    clipped: Clipped
    unseen: NDArray[np.bool_] | None
    light: FrameLight
    drifted: tuple[Finding, ...]


class ObservedSlopes(NamedTuple):
    """Slopes (H, W, 2) without the bias that the pixels at rest show, and their standard deviation by size and place."""

    gradients: NDArray[np.float32]
    sigma: NDArray[np.float32]
    model_sigma: NDArray[np.float32] | None
    at_rest: NDArray[np.bool_]
    step: Step | None
    findings: tuple[Finding, ...]


class ReadSlopes(NamedTuple):
    """The slopes of an image with their final sigma and confidence; see `Reconstructor._read`."""

    seen: SeenImage
    slopes: ObservedSlopes
    sigma: NDArray[np.float32] | None
    confidence: NDArray[np.float32]
    steep: NDArray[np.float32]
    stated_confidence: NDArray[np.float32]
    maps: dict[str, NDArray[np.float32]] | None


class FromCalibration:
    """The parts that follow from a calibration alone. They are immutable; threads and all background images share them."""

    def __init__(
        self, calibration: Calibration, solver: str, *, depth_sigma: bool, slope_sigma: bool
    ) -> None:
        self.calibration, self.slope_sigma, solver = calibration, slope_sigma, checked_solver(solver)
        if not slope_sigma and (depth_sigma or takes_weights(solver)):
            raise ValueError("Expected slope_sigma=True for a solver with weights and for depth_sigma=True.")
        shape, forward, known = calibration.image_shape, calibration.forward, calibration.slope_sigma
        self.pitch = calibration.mm_per_px or USUAL_WIDTH_MM / shape[1]
        self.full_confidence_sigma = known.full_confidence_sigma if known else USUAL_SIGMA
        self.stepped = SteppedSlopes(forward, shape, calibration.untouched_change)
        self.per_residual = np.float32(1 if forward is None else 1 / forward.residual_scale)
        self.slope_per_change = 1.0 if forward is None else forward.slope_per_change
        self.states_sigma = slope_sigma and known is not None
        self.steep_slopes: Callable[..., tuple[NDArray[np.float32], NDArray[np.float32]]] = all_shown
        if known is not None and slope_sigma:
            self.steep_slopes = SteepSlopes(known, calibration.carried)
        stated = depth_sigma and known is not None and calibration.mm_per_px is not None
        self.depth = FrameDepth(
            shape, self.pitch, solver, self.full_confidence_sigma,
            correlation=known.correlation if stated and known else None, gain_sigma=known.gain_sigma if known else 0.0,
        )  # fmt: skip
        self.missing_depth = MissingDepth(shape, self.pitch)
        self.limit = DepthLimit.of(shape, self.pitch, calibration.settings.gel_thickness_mm)
        blur_px = calibration.change.blur_px if known else None
        self.solved_sigma = SolvedSigma(known, shape, blur_px, calibration.unit_spread)


class FromBackground:
    """What follows from today's background image (H, W, 3) and the usual light. It is immutable; threads share it."""

    def __init__(
        self, fixed: FromCalibration, background: NDArray[np.float32], usual: FrameLight | None = None
    ) -> None:
        calibration, forward = fixed.calibration, fixed.calibration.forward
        change, noise = calibration.change, calibration.settings.image_noise
        self.untouched_image = PreparedBackground(background, change, usual)
        self.model = calibration.color_model.prepare(background, calibration.image_shape)
        self.health = FrameHealth(background)
        # If crosstalk is removed, a clipped channel affects all three.
        spare = int(fixed.stepped.steps and change.crosstalk is None)
        learnt = None if forward is None else forward.clipped
        outside = outside_of_gel(background)
        self.clipped = ClippedChannels(change.blur_px, learnt, spare, outside)
        self.causes: PreparedCauses | AllAlike = AllAlike()
        if fixed.slope_sigma:
            self.causes = PreparedCauses(
                background, change, full_confidence_sigma=fixed.full_confidence_sigma, levels=noise,
                walls=calibration.slope_sigma is not None, outside=outside, slope_per_change=fixed.slope_per_change,
            )  # fmt: skip
        rest_variance = noise_at_rest(self.model, self.untouched_image, noise)
        known = calibration.slope_sigma
        self.sigma: PreparedSigma | UnknownSigma = UnknownSigma(fixed.full_confidence_sigma)
        correlation = None
        if known is not None and fixed.slope_sigma:
            self.sigma = prepared = PreparedSigma(known, rest_variance)
            rest_variance, correlation = prepared.rest_variance, known.correlation
        self.surround = Surround(background)
        self.contact = PreparedContact(
            (fixed.pitch,) * 2, calibration.settings.relaxation_mm, rest_variance, correlation
        )


class Reconstructor:
    """Depth in mm from images of the sensor that a calibration belongs to.

    It is a pure function of the image: the same image gives the same bytes, whatever came before, and threads can share
    it. It can be pickled, so that process pools and data loaders accept it; each of them prepares it again.

    First it removes the bias of the slopes, which it reads from the pixels at rest. Then depth is the weighted
    least-squares surface: every slope counts by its confidence, and pixels at rest are softly anchored at 0. The order
    matters, because an anchor alone would bend the surface to hide the bias.

    Parameters
    ----------
    calibration : of this sensor and gel, or the path of its file
    background : (H, W, 3), 0-255, optional
        Today's background image; the calibration's own by default. It is an image of the calibrated size;
        `image_from_frame(frame, calibration.view)` makes one of a frame.
    solver : "auto" or a name in `gelform.depth.solvers.SOLVERS`
        "auto" is `multigrid`. Solvers that treat all slopes alike (`dct`, `dct4`) use neither weights nor anchor.
    depth_sigma : whether results have `depth_sigma_mm`; without it a frame takes a quarter less time
    slope_sigma : whether results have `gradients_sigma` and the confidence that follows from it. False needs a solver that
        treats all slopes alike, and `depth_sigma` False; confidence is 1 then, and depth and contact stay the same

    Attributes
    ----------
    own_background : whether the background in use is the calibration's own, pixel for pixel
    findings : findings about a starter calibration, and about a background that is not the calibration's own
    solved_sigma : function from the standard deviation of the read slopes to that of the solved depth's slopes
    steep_slopes : function to the standard deviation of slopes that presses have not shown, and to the stated confidence
    markers : finds the gel's markers in an image; its length is 0 if there are none. A `MarkerTracker` of it has memory

    Raises
    ------
    CalibrationError
        The background given is clearly not of the calibrated sensor, or the file cannot be read.
    ValueError, TypeError
        A background of another size than the calibrated images, an unknown solver, or one that needs slope_sigma.
    """

    def __init__(
        self,
        calibration: Calibration | str | PathLike[str],
        background: ArrayLike | None = None,
        *,
        solver: str = "auto",
        depth_sigma: bool = True,
        slope_sigma: bool = True,
    ) -> None:
        self.calibration = calibration = as_calibration(calibration)
        self._calibrated = FromCalibration(
            calibration, solver, depth_sigma=depth_sigma, slope_sigma=slope_sigma
        )
        self.solver = self._calibrated.depth.solver
        self.findings: tuple[Finding, ...] = calibration.findings
        self.background = calibration.background
        self._checked = partial(check_viewed_image, calibration.background, calibration.view.frame_shape)
        if background is not None:
            today = self._checked(background, "background")
            check_untouched_image(today, calibration.background)
            self.findings += check_own_background(today, calibration.background)
            self.background = today.astype(np.float32)
        self.own_background = background_digest(self.background) == calibration.background_digest
        self._today = FromBackground(self._calibrated, self.background)
        self.solved_sigma, self.steep_slopes = self._calibrated.solved_sigma, self._calibrated.steep_slopes
        self.markers = MarkerFollower(self.background, calibration.mm_per_px)
        self._start: Callable[[Work], Work] = lambda work: work
        self._pool = Pool(lambda: np.empty((*calibration.image_shape, 3), dtype=np.float32))
        keep_freed_memory(BYTES_PER_PX * int(np.prod(calibration.image_shape)))

    def with_background(
        self, background: NDArray[np.float32], usual: FrameLight | None = None
    ) -> Reconstructor:
        """The same Reconstructor for a newer background (H, W, 3), 0-255, of the same gel; nothing is checked.

        The markers keep their places; the rest is as if it had been made with this background, and takes as long as a
        frame. `usual` is the light of the frames before, relative to this background.
        """
        today = FromBackground(self._calibrated, background, usual)
        return self._with(background=background, own_background=False, _today=today)

    def with_helper(self, start: Callable[[Work], Work]) -> Reconstructor:
        """The same one with a helper for `depth_sigma_mm`: `start(work)` begins the work, and what it returns ends it."""
        return self._with(_start=start)

    def _with(self, **attributes: Any) -> Reconstructor:
        other = object.__new__(type(self))
        vars(other).update(vars(self), **attributes)
        return other

    __copy__ = _with

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle the arguments; unpickling prepares the Reconstructor again, which takes as long as making it.

        The calibration's report and a helper are left out; neither changes a byte of a result.
        """
        fixed, calibration = self._calibrated, replace(self.calibration, report=None)
        depth_sigma, slope_sigma = fixed.depth.sigma is not None, fixed.slope_sigma
        today = None if self.own_background else self.background
        state = {"findings": self.findings, "markers": self.markers}
        return _prepared_again, (type(self), calibration, self.solver, depth_sigma, slope_sigma, today), state

    def __call__(self, frame: ArrayLike | Frame) -> Reconstruction:
        """Reconstruct one frame: apply the calibration's view, then `from_image`.

        Parameters
        ----------
        frame : (H, W, 3) uint8 or float 0-255, RGB, as the camera gave it, or an image that has another size; or a Frame

        Raises
        ------
        ValueError, TypeError
            No RGB image, or of another size than the view's frames and images.
        CalibrationError
            As `from_image`.
        """
        if isinstance(frame, Frame):
            result = self(frame.image)
            return replace(result, index=frame.index, time_s=frame.time_s, wall_time_ns=frame.wall_time_ns)
        pixels = whole_levels(check_image(frame, name="frame"))
        return self.from_image(image_from_frame(pixels, self.calibration.view))

    def from_image(self, image: ArrayLike, *, markers: MarkerFlow | None = None) -> Reconstruction:
        """Reconstruct one image that has already passed through the calibration's view, such as a press from a folder.

        Parameters
        ----------
        image : (H, W, 3) uint8 or float 0-255, RGB, of the calibrated size; never turned, cropped or resized
        markers : the markers' positions, from a `MarkerTracker`; by default each is searched for within half the markers'
            spacing of its place at rest

        Raises
        ------
        ValueError, TypeError
            No RGB image, or of another size than the calibrated ones.
        CalibrationError
            The background is clearly not of this image, or the image is mirrored, turned or BGR.
        """
        with self._pool.one() as change:
            read = self._read(self._checked(image), change, markers)
            albedo = self._albedo_source(change)
        faults, fixed = read.seen.faults, self._calibrated
        solution, depth_sigma, difference = fixed.depth(
            read.slopes.gradients, read.sigma, read.confidence, read.slopes.at_rest, self._start
        )
        depth_mm, too_deep = fixed.limit.bound(solution.depth_mm)
        most_mm = fixed.limit.ignorance_mm
        faults.widen(depth_sigma, most_mm)
        gradients = slopes_of_solution(depth_mm, (fixed.pitch, fixed.pitch))
        known = faults.without_lost(solution.known)
        solved_sigma, wall = self.solved_sigma.with_walls(read.sigma, gradients)
        observed, at_rest = read.slopes.gradients, read.slopes.at_rest
        deviations = SlopeDeviations.of(read.sigma, solved_sigma, at_rest)
        contact = self._today.contact(depth_mm, depth_sigma, deviations, known)
        # What follows makes no contact less certain: an error of all depths in proportion, and depth that is missing.
        if depth_sigma is not None:
            add_in_proportion(depth_sigma, solution.depth_mm, fixed.depth.gain_sigma, most_mm)
        depth_sigma, difference, at_least = fixed.missing_depth(
            observed, read.steep, wall, at_rest, depth_mm, depth_sigma, difference
        )
        touched = partial(self._today.untouched_image.touched, read.seen.image)
        unsure = unknown_contact(contact, at_rest, known, touched)
        findings = *read.slopes.findings, *too_deep, *at_least, *unsure
        return Reconstruction(
            depth=depth_mm if self.calibration.mm_per_px else depth_mm / np.float32(fixed.pitch),
            depth_sigma_mm=depth_sigma,
            gradients=gradients,
            gradients_sigma=with_steep(solved_sigma, read.steep),
            observed_gradients=observed,
            confidence=read.stated_confidence,
            contact=contact,
            known=known,
            mm_per_px=self.calibration.mm_per_px,
            mm_per_px_sigma=self.calibration.mm_per_px_sigma,
            solver=solution.solver,
            curl_rms=solution.curl_rms,
            health=(*self.findings, *faults.findings, *read.seen.drifted, *findings),
            markers=read.seen.flow,
            outside_change=self._today.surround(read.seen.image, contact),
            calibration_digest=self.calibration.digest,
            force_model=self.calibration.force,
            albedo_source=albedo,
            difference_source=difference,
        )

    def explain(self, image: ArrayLike) -> Explanation:
        """The reasons for each pixel's confidence: the sigma that each cause adds, and its share.

        It is of the slopes as read; the solver's weights are without the cause `steep`. It takes longer than a frame.
        Image and errors are those of `from_image`.
        """
        if isinstance(self._today.causes, AllAlike):
            raise GelformError("Expected a Reconstructor with slope_sigma=True, which alone knows of causes.")
        image, change = self._checked(image), np.empty((*self.calibration.image_shape, 3), dtype=np.float32)
        read = self._read(image, change, explains=True)
        assert read.maps is not None
        read.maps["steep"], sigma = read.steep, np.asarray(with_steep(read.slopes.sigma, read.steep))
        return explanation_of(
            read.maps, sigma, read.stated_confidence, self._calibrated.full_confidence_sigma
        )

    def _read(
        self,
        image: NDArray[Any],
        change: NDArray[np.float32],
        flow: MarkerFlow | None = None,
        *,
        explains: bool = False,
    ) -> ReadSlopes:
        """The slopes of an image and their sigma and confidence; writes the image's color change to `change`.

        It has three stages: what the image shows, which slopes its colors mean, and how far they are to be believed.
        """
        seen = self._seen(whole_levels(image), flow)
        return self._believed(seen, self._observed(seen, change), change if explains else None)

    def _seen(self, raw: NDArray[Any], flow: MarkerFlow | None) -> SeenImage:
        """An image with its faults, markers, exposure and unusable channels."""
        today = self._today
        faults = today.health(raw)
        image = faults.image  # lost pixels show the background image and have no weight
        flow = self.markers(image) if flow is None and len(self.markers) else flow
        markers = self.markers.hidden(image, flow)
        if markers is not None:
            image = today.untouched_image.bridged(image, markers)
        light, drifted = today.untouched_image.compare(image)
        hidden = faults.hidden(markers)
        clipped = today.clipped(as_levels(image), hidden)
        unseen = either(hidden, clipped.unseen)
        return SeenImage(raw, image, faults, flow, markers, hidden, clipped, unseen, light, drifted)

    def _observed(self, seen: SeenImage, change: NDArray[np.float32]) -> ObservedSlopes:
        """The slopes that an image's colors mean; writes its color change to `change`."""
        fixed, today = self._calibrated, self._today
        pending = today.untouched_image.pending(seen.image, seen.light)
        direct, model_sigma = gradients_from_pending(today.model, pending, out=change)
        step = fixed.stepped(change, direct, seen.unseen, seen.clipped.channels)
        gradients, variance = (direct, None) if step is None else (step.gradients, step.variance)
        reference = reference_from_color_change(
            change, gradients, self.calibration.untouched_change, seen.hidden
        )
        at_rest, sigma = today.sigma(change, gradients, reference, seen.hidden, variance)
        unsure = today.untouched_image.light_sigma(seen.light)
        if unsure is not None:
            np.hypot(sigma, np.float32(fixed.slope_per_change) * unsure, out=sigma)
        return ObservedSlopes(gradients, sigma, model_sigma, at_rest, step, reference.findings)

    def _believed(
        self, seen: SeenImage, slopes: ObservedSlopes, explained: NDArray[np.float32] | None
    ) -> ReadSlopes:
        """The slopes with the sigma that each cause adds, and their confidence; maps of causes if a change is given."""
        fixed, causes = self._calibrated, self._today.causes
        sigma, step = slopes.sigma, slopes.step
        maps: dict[str, NDArray[np.float32]] | None = None if explained is None else {}
        own = sigma if explained is None else sigma.copy()
        residual = None if step is None else (step.residual * fixed.per_residual, step.variance)
        confidence = causes(slopes.gradients, sigma, seen.unseen, seen.raw, residual, maps)
        if maps is not None and explained is not None and isinstance(causes, PreparedCauses):
            maps = causes.maps_of(
                maps, own, seen.raw, clipped=seen.clipped.channels, markers=seen.markers, lost=seen.faults.lost,
                color_change=explained,
            )  # fmt: skip
        stated = sigma if fixed.states_sigma else None
        observed_sigma, confidence = with_model_sigma(
            stated, confidence, slopes.model_sigma, fixed.full_confidence_sigma
        )
        steep, stated_confidence = self.steep_slopes(slopes.gradients, sigma, confidence)
        return ReadSlopes(seen, slopes, observed_sigma, confidence, steep, stated_confidence, maps)

    def _albedo_source(self, change: NDArray[np.float32]) -> Callable[[], NDArray[np.float32]] | None:
        """A function that computes the albedo on demand; None if the color model has no albedo."""
        model = self._today.model
        return partial(model.albedo_from_color, change.copy()) if isinstance(model, AlbedoModel) else None


def _prepared_again(
    kind: type[Reconstructor],
    calibration: Calibration,
    solver: str,
    depth_sigma: bool,
    slope_sigma: bool,
    background: NDArray[np.float32] | None,
) -> Reconstructor:
    """The unpickled Reconstructor, without its findings and markers, which follow as its state."""
    made = kind(calibration, solver=solver, depth_sigma=depth_sigma, slope_sigma=slope_sigma)
    return made if background is None else made.with_background(background)
