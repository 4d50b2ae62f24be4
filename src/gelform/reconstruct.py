"""Reconstructor: the path from a frame to depth in one method."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from functools import partial
from os import PathLike
from threading import RLock
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gelform.arrays import Array, Floats, Map, Mask, Slopes
from gelform.calibration_file import Calibration, as_calibration
from gelform.depth.coarse import CoarseDepth
from gelform.depth.contact import PreparedContact, SlopeDeviations, Surround, off_rest, unknown_contact
from gelform.depth.integrate import FrameDepth, Integration
from gelform.depth.sigma import DepthErrors, DepthSigma, Purpose, contradicted_slopes, steep_finding
from gelform.errors import Finding
from gelform.foundations.checks import check_image, value_range
from gelform.foundations.pool import Pool, keep_freed_memory, once
from gelform.image.agreement import (
    background_digest,
    check_own_background,
    check_viewed_image,
    touch_in,
    touched_finding,
)
from gelform.image.background import PreparedBackground
from gelform.image.health import DepthLimit, FrameFaults, FrameHealth, check_untouched_image
from gelform.image.light import FrameLight
from gelform.image.markers import MarkerFlow, MarkerFollower
from gelform.image.view import Frame, as_levels, image_from_frame, whole_levels
from gelform.result import Reconstruction, ShapeErrors
from gelform.slopes.budget import (
    OUTLIER,
    Budget,
    ExplainedFrame,
    Explanation,
    PreparedBudget,
    ReadSlopes,
    explanation_of,
    for_both,
    noise_at_rest,
    without_bias,
)
from gelform.slopes.color_models.forward_response import PreparedStep
from gelform.slopes.gradients import slopes_of_solution
from gelform.slopes.sigma import Clipped, ClippedChannels, SlopeSigma, either, excess_noise, outside_of_gel


class FromCalibration:
    """The parts that follow from a calibration alone. They are immutable; threads and all background images share them."""

    def __init__(self, calibration: Calibration) -> None:
        self.calibration, self.known = calibration, calibration.slope_sigma
        shape, forward = calibration.image_shape, calibration.forward
        # An imported calibration without its own has a slope's deviation of 0.05 and a width of 20 mm, as of a GelSight
        # Mini: they affect the contact mask and the anchor, but no slope.
        self.slope_sigma = sigma = self.known or SlopeSigma(
            rest=0.05, per_step=0.05, full_confidence_sigma=0.05, correlation_px=1.0, shown=(1e3, 1e3)
        )
        self.pitch = calibration.mm_per_px or 20.0 / shape[1]
        self.step = None if forward is None or forward.step_sigma is None else PreparedStep(forward)
        self.coarse_depth = CoarseDepth(shape, calibration.untouched_change)
        self.outlier = OUTLIER if forward is None else OUTLIER * forward.residual_scale
        self.slope_per_change = 1.0 if forward is None else forward.slope_per_change
        self.depth = FrameDepth(shape, self.pitch, sigma.full_confidence_sigma)
        self.limit = DepthLimit.of(shape, self.pitch, calibration.settings.gel_thickness_mm)
        self.depth_sigma = None
        if self.known is not None and calibration.mm_per_px is not None:
            self.depth_sigma = DepthSigma(
                shape, self.pitch, full_confidence_sigma=sigma.full_confidence_sigma,
                factor=sigma.depth_factor, gain_sigma=sigma.gain_sigma,
            )  # fmt: skip

    def stepped(
        self, change: Map, gradients: Slopes, hidden: Mask | None, clipped: NDArray[np.uint8] | None
    ) -> tuple[Slopes, Map | None, Map | None, Map | None]:
        """Slopes (H, W, 2) after a step by the forward response with the frame's depth, their variance and residual.

        The last is that depth on the coarser grid, px.

        Without a response or its `step_sigma` slopes stay as they were read. Pixels without gel are `hidden` (H, W),
        unusable channels are `clipped` (H, W, 3).
        """
        if self.step is None:
            return gradients, None, None, None
        depth_px = self.coarse_depth.signed(change, gradients, hidden)
        return *self.step(change, gradients, np.maximum(depth_px, 0), clipped), depth_px


class FromBackground:
    """What follows from today's background image (H, W, 3) and the usual light. It is immutable; threads share it."""

    def __init__(self, fixed: FromCalibration, background: Map, usual: FrameLight | None = None) -> None:
        calibration, forward = fixed.calibration, fixed.calibration.forward
        change, noise = calibration.change, calibration.settings.image_noise
        self.untouched_image = PreparedBackground(background, change, usual)
        self.model = model = calibration.color_model.prepare(background, calibration.image_shape)
        # What not every model can, asked once.
        self.in_one_pass = getattr(model, "gradients_in_one_pass", None)
        self.albedo_from_color = getattr(model, "albedo_from_color", None)
        self.health = FrameHealth(background, calibration.view.turn != "none")
        # If crosstalk is removed, a clipped channel affects all three.
        spare = int(fixed.step is not None and change.crosstalk is None)
        learnt = None if forward is None else forward.clipped
        self.outside = outside_of_gel(background)
        self.clipped = ClippedChannels(change.blur_px, learnt, spare, self.outside)
        self._levels = np.inf if noise is None else float(np.sqrt(np.mean(np.square(noise))))
        self._pixels = as_levels(background)
        sigma = fixed.slope_sigma
        self.budget = PreparedBudget(
            sigma, noise_at_rest(self.model, self.untouched_image, noise), self.untouched_image,
            walls=fixed.known is not None, slope_per_change=fixed.slope_per_change, spread=calibration.unit_spread,
            carried=calibration.carried,
        )  # fmt: skip
        self.surround = Surround(background)
        correlation = None if fixed.known is None else sigma.correlation
        self.contact = PreparedContact(
            (fixed.pitch,) * 2, calibration.settings.relaxation_mm, self.budget.rest_variance, correlation
        )

    def noise_levels(self, image: Array) -> float:
        """The noise of an image (H, W, 3) beyond the calibrated images', gray levels."""
        return excess_noise(as_levels(image), self._pixels, self._levels)


class SeenImage(NamedTuple):
    """What an image shows, and what may be wrong with it: the first stage of reading its slopes."""

    raw: Array
    image: Array  # without its lost parts and markers
    faults: FrameFaults
    flow: MarkerFlow | None
    markers: Mask | None
    hidden: Mask | None
    clipped: Clipped
    light: FrameLight
    findings: tuple[Finding, ...]


@dataclass(frozen=True, eq=False)
class FrameRecord:
    """What the depth of a frame was solved from. The rest of its result follows on first use; threads can share it."""

    fixed: FromCalibration
    today: FromBackground
    seen: SeenImage
    slopes: ReadSlopes
    solution: Integration
    depth_mm: Map  # (H, W), within the limit
    range_mm: tuple[float, float]  # its smallest and largest value
    known: Mask
    findings: tuple[Finding, ...]  # those that are known with the depth
    albedo: Callable[[], Map] | None  # (H, W), if the color model gives it

    @once
    def gradients(self) -> Slopes:
        """Slopes (H, W, 2) of the solved depth."""
        return slopes_of_solution(self.depth_mm, (self.fixed.pitch, self.fixed.pitch))

    @once
    def budget(self) -> Budget:
        """Standard deviations of the slopes."""
        return self.today.budget(self.slopes, *self.fixed_rows, depth=self.depth_mm)

    @property
    def fixed_rows(self) -> tuple[float, Floats | None]:
        """The image's noise beyond the usual, gray levels, and the slopes' deviation (H, W) from its light, or None."""
        light = self.today.untouched_image.light_sigma(self.seen.light)
        light = None if light is None else np.float32(self.fixed.slope_per_change) * light
        return self.today.noise_levels(self.seen.raw), light

    @once
    def gradients_sigma(self) -> Map | None:
        """Standard deviation (H, W, 2) of the solved slopes; None if neither calibration nor model knows that of all."""
        if self.fixed.known is not None:
            return self.budget.gradients_sigma
        of_model = self.slopes.model_sigma
        return None if of_model is None or not of_model.all() else for_both(of_model)

    @once
    def depth_errors(self) -> DepthErrors | None:
        """The errors of the depth; None if the calibration does not know those of slopes, or has no scale."""
        if self.fixed.depth_sigma is None:
            return None
        maps = self.gradients, self.depth_mm, self.slopes.at_rest, self.known
        return self.fixed.depth_sigma(*maps, self.budget.read, self.budget.steep)

    @once
    def depth_sigma_mm(self) -> Map | None:
        """Standard deviation (H, W) of the depth, mm."""
        return self._sigma("stated")

    def _sigma(self, purpose: Purpose) -> Map | None:
        """The depth's deviation (H, W) for a purpose, mm, if it is known; nothing is known of lost pixels."""
        errors, lost = self.depth_errors, self.seen.faults.lost
        return None if errors is None else errors.sigma(self.fixed.limit.ignorance_mm, purpose, lost)

    @property
    def contact(self) -> Mask:
        """Where something touches (H, W)."""
        return self.touch[0]

    @once
    def touch(self) -> tuple[Mask, Map | None]:
        """The contact, and the depth's deviation (H, W) by which it stands, mm."""
        errors, depth, contact = self.depth_errors, self.depth_mm, self.today.contact
        by_slopes = self.deviations
        if errors is None:
            return contact(depth, None, by_slopes, self.known), None
        how = self.fixed.limit.ignorance_mm, self.seen.faults.lost, by_slopes, self.known
        return contact.judged(depth, errors.of_contacts, *how)

    @property
    def deviations(self) -> SlopeDeviations | None:
        """Those of the slopes, if they are known."""
        if self.fixed.known is None:
            return None
        return SlopeDeviations(self.budget.read, self.budget.solved, self.slopes.at_rest)

    @once
    def health(self) -> tuple[Finding, ...]:
        """All findings."""
        (contact, sigma), depth, known = self.touch, self.depth_mm, self.known
        is_touched = partial(touch_in, self.seen.image, self.today.untouched_image.background)
        maps = contact, depth, sigma, self.slopes.at_rest, known
        unknown = unknown_contact(*maps, is_touched, self.seen.hidden, self.fixed.pitch)
        of_depth: tuple[Finding, ...] = ()
        if self.depth_errors is not None:
            of_depth = steep_finding(depth, contact, self.budget.steep, self.depth_errors)
            if -self.range_mm[0] > self.range_mm[1]:
                judged, touched = self.today.contact.pressed_background, bool(contact.any())
                of_depth += judged(depth, self._sigma("valley"), self.deviations, known, touched=touched)
            if not any(one.name == "background_pressed" for one in of_depth):
                of_known = self.range_mm if known.all() else value_range(depth * known)
                of_depth += off_rest(depth, of_known, self.depth_sigma_mm, contact, known, unknown)
        elif self.fixed.known is None:
            slopes = self.slopes.gradients, self.gradients
            of_depth = contradicted_slopes(*slopes, depth, contact)
        return *self.findings, *of_depth, *unknown

    @property
    def confidence(self) -> Map:
        """Confidence (H, W) of the slopes as read."""
        return self.budget.confidence

    @property
    def curl_rms(self) -> float:
        """RMS of the curl of the slopes as read."""
        return self.solution.curl_rms

    @once
    def color_changes(self) -> tuple[float | None, float | None]:
        """Color change outside the contact, and inside it."""
        return self.today.surround(self.seen.image, self.contact)

    @property
    def outside_change(self) -> float | None:
        """Median color change outside the contact over its mean inside."""
        outside, inside = self.color_changes
        return outside / inside if outside is not None and inside else None

    @property
    def inside_change(self) -> float | None:
        """Mean color change inside the contact."""
        return self.color_changes[1]

    @once
    def shape_errors(self) -> ShapeErrors | None:
        """How the errors of the depth hang together; None if they are not known."""
        errors, sigma = self.depth_errors, self.fixed.slope_sigma
        if errors is None:
            return None
        maps = errors.coarse_variance[np.newaxis], errors.common_mm[np.newaxis]
        blur_px = self.fixed.calibration.change.blur_px
        return ShapeErrors(*maps, sigma.gain_sigma, sigma.correlation_px, sigma.correlated_share, blur_px)


# What a result computes of its record.
ON_FIRST_USE = [one.name for one in fields(Reconstruction) if hasattr(FrameRecord, one.name)]


class Reconstructor:
    """Depth in mm from images of the sensor that a calibration belongs to.

    It is a pure function of the image: the same image gives the same bytes, whatever came before, and threads can share
    it. It can be pickled, so that process pools and data loaders accept it; each of them prepares it again.

    First it removes the bias of the slopes, which it reads from the pixels at rest. Then depth is the weighted
    least-squares surface: slopes whose color no slope gives count less, and pixels at rest are softly anchored at 0. The
    order matters, because an anchor alone would bend the surface to hide the bias. A result computes the rest on first use.

    Parameters
    ----------
    calibration : of this sensor and gel, or the path of its file
    background : (H, W, 3), 0-255, optional
        Today's background image; the calibration's own by default. It is an image of the calibrated size;
        `image_from_frame(frame, calibration.view)` makes one of a frame.

    Attributes
    ----------
    own_background : whether the background in use is the calibration's own, pixel for pixel
    findings : findings about a starter calibration, and about a background that is not the calibration's own
    markers : finds the gel's markers in an image; its length is 0 if there are none. A `MarkerTracker` of it has memory

    Raises
    ------
    CalibrationError
        The background given is clearly not of the calibrated sensor, or the file cannot be read.
    ValueError, TypeError
        A background of another size than the calibrated images.
    """

    def __init__(
        self, calibration: Calibration | str | PathLike[str], background: ArrayLike | None = None
    ) -> None:
        self.calibration = calibration = as_calibration(calibration)
        self._calibrated = FromCalibration(calibration)
        self.findings: tuple[Finding, ...] = calibration.findings
        self._checked = partial(check_viewed_image, calibration.background, calibration.view.frame_shape)
        self._pool = Pool(lambda: np.empty((*calibration.image_shape, 3), dtype=np.float32))
        keep_freed_memory(80 * int(np.prod(calibration.image_shape)))  # bytes that one frame allocates in all
        self._relate_to(calibration.background)
        if background is not None:
            today = self._checked(background, "background")
            check_untouched_image(today, calibration.background)
            found = check_own_background(today, calibration.background)
            # Another unit, or a gel that has moved, shows contacts that are none.
            if not {"background_touched", "background_pattern"} & {one.name for one in found}:
                found += self._contact_at_rest(today)
            self.findings += found
            self._relate_to(today.astype(np.float32))

    def _relate_to(self, background: Map) -> None:
        """Read frames relative to a background (H, W, 3), 0-255, from now on."""
        self.background = background
        self.own_background = background_digest(background) == self.calibration.background_digest
        self._today = FromBackground(self._calibrated, background)
        self.markers = MarkerFollower(background, self.calibration.mm_per_px)

    def __repr__(self) -> str:
        height, width = self.calibration.image_shape
        whose = "the calibration's" if self.own_background else "a newer"
        return f"Reconstructor({self.calibration.sensor_name}, {height}x{width} px, {whose} background)"

    def _contact_at_rest(self, image: Array) -> tuple[Finding, ...]:
        """The finding `background_touched` if an image (H, W, 3) of the gel at rest has contacts, such as faint ones."""
        contacts = [one for one in self.from_image(image).contacts if not one.cut_by_border]
        if not contacts:
            return ()
        first = max(contacts, key=lambda one: one.deepest_mm or 0.0)
        others = f", and {len(contacts) - 1} more of it" if len(contacts) > 1 else ""
        deep = "" if first.deepest_mm is None else f" {first.deepest_mm:.2g} mm deep"
        seen = f"is a contact{deep}{others}, compared with the calibration's"
        return (touched_finding(first.deepest_px, seen, first.deepest_mm or 0.0),)

    def with_background(
        self, background: Map, usual: FrameLight | None = None, findings: tuple[Finding, ...] | None = None
    ) -> Reconstructor:
        """The same Reconstructor for a newer background (H, W, 3), 0-255, of the same gel; nothing is checked.

        The markers keep their places; the rest is as if it had been made with this background, and takes as long as a
        frame. `usual` is the light of the frames before, relative to this background; `findings` are about it, or None.
        """
        today = FromBackground(self._calibrated, background, usual)
        found = self.findings if findings is None else self.calibration.findings + findings
        return self._with(background=background, own_background=False, _today=today, findings=found)

    def _with(self, **attributes: Any) -> Reconstructor:
        other = object.__new__(type(self))
        vars(other).update(vars(self), **attributes)
        return other

    __copy__ = _with

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle the arguments; unpickling prepares the Reconstructor again, which takes as long as making it.

        The calibration's report is left out; it does not change a byte of a result.
        """
        calibration = replace(self.calibration, report=None)
        today = None if self.own_background else self.background
        state = {"findings": self.findings, "markers": self.markers}
        return _prepared_again, (type(self), calibration, today), state

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
            return result.changed(index=frame.index, time_s=frame.time_s, wall_time_ns=frame.wall_time_ns)
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
        return self.result(self.record(image, markers))

    def record(self, image: ArrayLike, markers: MarkerFlow | None = None) -> FrameRecord:
        """The solved depth of an image and all that the rest of its result follows from.

        Arguments and errors are those of `from_image`.
        """
        fixed, today = self._calibrated, self._today
        with self._pool.one() as change:
            seen = self._seen(whole_levels(self._checked(image)).copy(), markers)
            slopes, at_bias = self._read(seen, change)
            albedo = None
            if today.albedo_from_color is not None:
                albedo = partial(today.albedo_from_color, change.copy())
        solution = fixed.depth(slopes)
        depth_mm, range_mm, too_deep = fixed.limit.bound(solution.depth_mm)
        lost = seen.faults.lost
        known = solution.known if lost is None else solution.known & ~lost
        findings = (*self.findings, *seen.findings, *at_bias, *too_deep)
        return FrameRecord(fixed, today, seen, slopes, solution, depth_mm, range_mm, known, findings, albedo)

    def _seen(self, raw: Array, flow: MarkerFlow | None) -> SeenImage:
        """An image with its faults, markers, light and unusable channels."""
        today = self._today
        faults = today.health(raw)
        image = faults.image  # lost pixels show the background image and have no weight
        flow = self.markers(image) if flow is None and len(self.markers) else flow
        markers = self.markers.hidden(image, flow)
        if markers is not None:
            image = today.untouched_image.bridged(image, markers)
        light, drifted = today.untouched_image.compare(image)
        hidden = either(markers, faults.lost)
        clipped = today.clipped(as_levels(image), hidden)
        findings = *faults.findings, *drifted
        return SeenImage(raw, image, faults, flow, markers, hidden, clipped, light, findings)

    def _read(self, seen: SeenImage, change: Map) -> tuple[ReadSlopes, tuple[Finding, ...]]:
        """The slopes that an image's colors mean, without their bias, and findings; the color change goes to `change`."""
        fixed, today = self._calibrated, self._today
        pending = today.untouched_image.pending(seen.image, seen.light)
        if today.in_one_pass is None:
            direct, model_sigma = today.model.gradients_from_color(pending.write(change))
        else:
            direct, model_sigma = today.in_one_pass(pending, change)
        unseen = either(seen.hidden, seen.clipped.unseen)
        stepped = fixed.stepped(change, direct, unseen, seen.clipped.channels)
        gradients, variance, residual, depth_px = stepped
        at_rest, found = without_bias(change, gradients, self.calibration.untouched_change, seen.hidden)
        of_model = None if model_sigma is None else np.ascontiguousarray(model_sigma.max(axis=-1))
        unseen = either(unseen, today.outside)
        slopes = ReadSlopes(gradients, at_rest, unseen, variance, residual, of_model, fixed.outlier, depth_px)
        return slopes, found

    def result(self, record: FrameRecord) -> Reconstruction:
        """The result of a record: its depth, and the rest on first use; the record goes with the last of it."""
        lock, calibration, slopes = RLock(), self.calibration, record.slopes
        later: dict[str, Any] = {name: once(partial(getattr, record, name), lock) for name in ON_FIRST_USE}
        # Both follow from the same errors, or are None.
        shape_errors = later["shape_errors"]
        later["depth_sigma_mm"] = once(lambda: shape_errors() and record.depth_sigma_mm, lock)
        own = record.depth_mm.copy()  # the caller's to write to; the record's stays
        read = slopes.gradients.view()
        read.flags.writeable = False
        return Reconstruction(
            depth=own if calibration.mm_per_px else own / np.float32(record.fixed.pitch),
            observed_gradients=read,
            known=record.known,
            mm_per_px=calibration.mm_per_px,
            mm_per_px_sigma=calibration.mm_per_px_sigma,
            solver=record.solution.solver,
            markers=record.seen.flow,
            calibration_digest=calibration.digest,
            force_model=calibration.force,
            albedo_source=record.albedo and once(record.albedo).__call__,
            **later,
        )

    def explain(self, image: ArrayLike) -> Explanation:
        """The reasons for each pixel's confidence: the sigma that each cause adds, and its share.

        It is of the slopes as read, and takes longer than a frame. Image and errors are those of `from_image`.
        """
        record = self.record(image)
        seen, slopes, today = record.seen, record.slopes, self._today
        change = today.untouched_image.change(seen.image, seen.light)
        budget = today.budget(slopes, *record.fixed_rows, depth=record.depth_mm, rows=True)
        return explanation_of(ExplainedFrame(
            budget, today.budget.full_confidence_sigma, as_levels(seen.raw), change, seen.clipped.channels,
            seen.markers, seen.faults.lost, today.outside, self.calibration.change.blur_px,
        ))  # fmt: skip


def _prepared_again(
    kind: type[Reconstructor], calibration: Calibration, background: Map | None
) -> Reconstructor:
    """The unpickled Reconstructor, without its findings and markers, which follow as its state."""
    made = kind(calibration)
    return made if background is None else made.with_background(background)
