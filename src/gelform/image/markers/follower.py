"""The markers of one gel, prepared once: their positions in an image, and the pixels that they darken.

Each dot is searched for near its expected position. A dot that is not found there is searched for at the candidates
nearest to the prediction of its neighbors, ring by ring. A dot is rejected if it moves unlike its neighbors, or if another
dot has its place. A tracker has memory, one for each sequence, and follows dots however far they move.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from gelform.arrays import Array, Floats, Map, Mask, Numbers
from gelform.foundations.checks import check_image, check_mm_per_px
from gelform.image.markers.finder import END_PX, CandidateFinder, MarkerFinder, MarkerPatches, logs_from_image

_SHAPES = {"rest_px": (2,), "now_px": (2,), "seen": (), "sigma_px": ()}


@dataclass(frozen=True, eq=False)
class MarkerFlow:
    """The displacement of each marker of a gel from rest, which shows the shear of the surface.

    Markers keep their order from frame to frame.
    """

    rest_px: Floats  # (N, 2) float32, x and y, positions at rest
    now_px: Floats  # (N, 2) float32, in this image; that of an unseen marker is predicted from its neighbors
    seen: Mask  # (N,), whether the marker itself was measured
    sigma_px: Floats  # (N,) float32, one standard deviation of `now_px`, for x and y alike; large if not seen
    mm_per_px: float | tuple[float, float] | None = None  # or (x, y); None if the scale is unknown

    def __post_init__(self) -> None:
        count = len(self.rest_px)
        for name, columns in _SHAPES.items():
            got = np.shape(getattr(self, name))
            if got != (count, *columns):
                raise ValueError(f"Expected {name} of shape {(count, *columns)}, as rest_px, got {got}.")

    def __len__(self) -> int:
        return len(self.rest_px)

    def __repr__(self) -> str:
        return f"MarkerFlow({self.in_words()})"

    @property
    def displacement_px(self) -> Floats:
        """Displacement (N, 2) of each marker from rest, x to the right and y down, pixels."""
        return self.now_px - self.rest_px

    @property
    def displacement_mm(self) -> Floats | None:
        """Displacement (N, 2) on the gel, mm; None if the scale is unknown."""
        return None if self.mm_per_px is None else self.displacement_px * self._pitch

    @property
    def sigma_mm(self) -> Floats | None:
        """One standard deviation (N,) of the displacement, mm; None if the scale is unknown."""
        return None if self.mm_per_px is None else self.sigma_px * self._pitch.max()

    def in_words(self) -> str:
        """One line for people: the number of seen markers, and their displacement."""
        if not self.seen.any():
            return f"none of {len(self)} seen"
        scaled = self.displacement_mm
        moved, unit = (self.displacement_px, "px") if scaled is None else (scaled, "mm")
        away = np.linalg.norm(moved[self.seen], axis=1)
        return (
            f"{np.count_nonzero(self.seen)} of {len(self)} seen, moved {np.median(away):.3f} {unit} (median), "
            f"{away.max():.3f} {unit} at most"
        )

    def facts(self) -> dict[str, Any]:
        """All of it, as values that JSON can hold; one list entry for each marker."""
        millimeters = self.displacement_mm
        return {
            "in_words": self.in_words(),
            **{name: values.tolist() for name, values in self.arrays().items()},
            "displacement_px": self.displacement_px.tolist(),
            "displacement_mm": None if millimeters is None else millimeters.tolist(),
        }

    def arrays(self) -> dict[str, Array]:
        """The arrays of a file, by the names of the attributes."""
        return {name: getattr(self, name) for name in _SHAPES}

    @property
    def _pitch(self) -> Floats:
        return np.array(check_mm_per_px(self.mm_per_px), dtype=np.float32)


# Spacings: a dot found further from its search position is another one; so is one that memory has lost and that is found
# further from its neighbors' prediction.
HALF, AGAIN = 0.5, 0.3


class Neighbors:
    """The neighbors of dots; the gel's surface moves smoothly, so a dot moves nearly as they do."""

    def __init__(self, rest_px: Array) -> None:
        self._rest = np.asarray(rest_px, dtype=np.float64)
        count = len(self._rest)
        found = scipy.spatial.cKDTree(self._rest).query(self._rest, k=min(1 + 8, count))  # itself, and eight
        self.spacing_px, self._index = float(np.median(found[0][:, 1])), np.asarray(found[1])[:, 1:]

    def astray_px(self, shift_px: Array, sure: Mask) -> Numbers:
        """Distance (N,) of each dot's shift from the median of its sure neighbors; 0 without any."""
        theirs = np.where(sure[self._index][..., None], shift_px[self._index], np.inf)
        theirs.sort(axis=1)
        count = np.count_nonzero(np.isfinite(theirs[..., 0]), axis=1)
        lower, upper = np.maximum(count - 1, 0) // 2, np.minimum(count // 2, theirs.shape[1] - 1)
        number = np.arange(len(theirs))
        middle = (theirs[number, lower] + theirs[number, upper]) / 2
        away = shift_px - np.where((count > 0)[:, None], middle, shift_px)
        return np.asarray(np.hypot(away[:, 0], away[:, 1]))

    def predicted_px(self, shift_px: Array, sure: Mask, of: Mask) -> Numbers:
        """Shifts (M, 2) of some dots (`of`, (N,) bool) from those of the sure ones around.

        They lie on a plane through the shifts around, weighted by nearness. It is pulled to their mean where they do not
        determine a plane.
        """
        away = self._rest[sure] - self._rest[of][:, None]
        square = np.sum(away**2, axis=-1) / self.spacing_px**2
        weight = np.exp(-0.5 * (square - square.min(axis=1, keepdims=True)))
        weight /= weight.sum(axis=1, keepdims=True)
        mean, place = weight @ shift_px[sure], np.einsum("mk,mkc->mc", weight, away)
        offset = away - place[:, None]
        spread = np.einsum("mk,mkc,mkd->mcd", weight, offset, offset)
        spread += 0.3 * self.spacing_px**2 * np.eye(2)  # neighbors that spread less do not determine a plane
        lean = np.einsum("mk,mkc,mkd->mcd", weight, offset, shift_px[sure] - mean[:, None])
        slope = np.linalg.solve(spread, lean)  # definite by what was added
        return np.asarray(mean - np.einsum("mc,mcd->md", place, slope))


class MarkerFollower:
    """Finds the moved markers of a gel: a pure function of the image and of the start of the search.

    It is prepared for a background image (H, W, 3), 0-255. `rest_px` (N, 2) float32 are the markers that are completely
    inside it; N is 0 if the gel has no markers. `mm_per_px` is None if it is unknown.
    """

    def __init__(self, background: ArrayLike, mm_per_px: float | tuple[float, float] | None = None) -> None:
        image = check_image(background, name="background")
        if mm_per_px is not None:
            check_mm_per_px(mm_per_px)
        self.mm_per_px = mm_per_px
        self._finder = MarkerFinder(image)
        found, radius = self._finder.untouched.centers_px, self._finder.untouched.radius_px
        far = np.array(image.shape[1::-1]) - 1 - radius
        whole = np.all((found >= radius) & (found <= far), axis=1)
        self.rest_px = found[whole]
        if len(self) < 2:
            self.rest_px = found[:0]
            return
        self._all = np.concatenate([self.rest_px, found[~whole]])
        self._neighbors = Neighbors(self._all)
        logs = logs_from_image(image)
        self._patches = MarkerPatches(logs, self.rest_px, radius)
        self._candidates = CandidateFinder(logs, self._patches)
        # Positions (M, 2) of the pixels that dots darken at rest, and the nearest dot (M,) of each.
        self._dark = np.stack(np.nonzero(self._finder.untouched.mask)[::-1], axis=-1)
        self._owner = np.asarray(scipy.spatial.cKDTree(self._all).query(self._dark)[1])

    def __len__(self) -> int:
        return len(self.rest_px)

    @property
    def radius_px(self) -> float:
        """Radius of a dot, from their median area."""
        return self._patches.radius_px

    @property
    def spacing_px(self) -> float:
        """Median distance between neighboring dots at rest."""
        return self._neighbors.spacing_px

    def __call__(self, image: Array, start_px: Array | None = None) -> MarkerFlow:
        """The positions of the markers in an image (H, W, 3), 0-255.

        `start_px` (N, 2) are displacements at the start of the search; 0 by default, which finds dots that have moved less
        than half a spacing.
        """
        expected = np.zeros((len(self), 2)) if start_px is None else np.asarray(start_px, dtype=np.float64)
        shift, seen, sigma = self._resolved(logs_from_image(image), expected)
        # A fit's residual is no white noise; both numbers were measured on simulated shear.
        sigma = np.hypot(1.5 * sigma, END_PX).astype(np.float32)
        sigma[~seen] = 0.2 * self.spacing_px
        now = (self.rest_px + shift).astype(np.float32)
        return MarkerFlow(self.rest_px, now, seen, sigma, self.mm_per_px)

    def unlikeliness(self, flow: MarkerFlow) -> float:
        """Number of dots that are missing or move unlike their neighbors, for the choice between two flows of one image."""
        astray = self._neighbors.astray_px(*self._with_cut(flow.displacement_px, flow.seen))[: len(self)]
        return float(np.sum(~flow.seen) + np.sum(astray[flow.seen]) / self.spacing_px)

    def hidden(self, image: Array, flow: MarkerFlow | None) -> Mask | None:
        """Pixels (H, W) that the markers darken in the image or in the background; None if the gel has no markers.

        They include the dots at rest, because the color change is divided by the background, and the dots at the positions
        of the flow. Around the latter all pixels as dark as a dot are included, because contacts stretch dots.
        """
        if flow is None or not len(self):
            return None
        shift = self._of_all(flow.displacement_px, flow.seen)
        moved = np.zeros(image.shape[:2], dtype=np.uint8)
        at = self._dark + np.rint(shift).astype(np.intp)[self._owner]
        at = at[np.all((at >= 0) & (at < moved.shape[::-1]), axis=1)]
        moved[at[:, 1], at[:, 0]] = 1
        reach = int(self.radius_px) | 1
        near = cv2.dilate(moved, np.ones((2 * reach + 1,) * 2, dtype=np.uint8))
        near &= self._finder.mask(image).view(np.uint8)
        near |= cv2.dilate(moved, np.ones((3, 3), dtype=np.uint8))
        near |= self._finder.untouched.mask.view(np.uint8)
        return near > 0

    def _resolved(self, logs: Map, expected: Numbers) -> tuple[Any, Any, Any]:
        """Shifts (N, 2), whether each dot is seen, and its sigma, from the expected positions."""
        found = self._patches(logs, expected)
        shift, sigma = found.shift_px.astype(np.float64), found.sigma_px.copy()
        close = np.linalg.norm(shift - expected, axis=1) < HALF * self.spacing_px
        seen = self._agreeing(shift, found.ok & close)
        reach = (HALF if not expected.any() else AGAIN) * self.spacing_px
        candidates = None
        for _ in range(8):  # rings of lost dots, each searched for from those around
            guess = shift.copy()
            guess[~seen] = self._predicted(shift, seen) if seen.any() else expected[~seen]
            todo = np.nonzero(~seen & self._patches.inside(self.rest_px + guess))[0]
            if not len(todo):
                break
            candidates = self._candidates(logs) if candidates is None else candidates
            if reach < HALF * self.spacing_px:
                todo = todo[self._clear(self.rest_px[todo] + guess[todo], candidates)]
            if not len(todo):
                break
            start = self._at_candidates(guess, seen, todo, candidates, reach)
            again = self._patches(logs, start, todo)
            close = np.linalg.norm(again.shift_px - guess[todo], axis=1) < reach
            trial, taken = shift.copy(), seen.copy()
            trial[todo], taken[todo] = again.shift_px, again.ok & close
            taken = self._agreeing(trial, taken)
            if taken.sum() <= seen.sum():
                break
            shift[taken], sigma[todo], seen = trial[taken], again.sigma_px, taken
        if not seen.any():
            return expected.copy(), seen, sigma
        if not seen.all():
            shift, seen, sigma = self._with_stretched(logs, expected, shift, seen, sigma)
        if not seen.all():
            shift[~seen] = self._predicted(shift, seen)
        return shift, seen, sigma

    def _with_stretched(
        self, logs: Map, expected: Numbers, shift: Any, seen: Any, sigma: Any
    ) -> tuple[Any, Any, Any]:
        """The same of lost dots with an affine map: from where they are expected, then from the candidates."""
        guess, lost = shift.copy(), np.nonzero(~seen)[0]
        guess[lost] = self._predicted(shift, seen)
        reach, darkest = AGAIN * self.spacing_px, shift.copy()
        darkest[lost] = self._at_candidates(guess, seen, lost, self._candidates(logs), reach)
        for starts in (expected, darkest):
            todo = np.nonzero(~seen & self._patches.inside(self.rest_px + starts))[0]
            if not len(todo):
                continue
            guess = shift.copy()
            guess[~seen] = self._predicted(shift, seen)
            found = self._patches.stretched(logs, starts[todo], todo)
            trial, ok = shift.copy(), seen.copy()
            trial[todo], sigma[todo] = found.shift_px, found.sigma_px
            ok[todo] = found.ok & (np.linalg.norm(found.shift_px - guess[todo], axis=1) < reach)
            seen = self._agreeing(trial, ok) | seen
            shift = np.where(seen[:, None], trial, shift)
        return shift, seen, sigma

    def _at_candidates(
        self, guess: Array, seen: Mask, todo: NDArray[np.intp], candidates: Array, reach: float
    ) -> Numbers:
        """Shifts (M, 2) to the candidate, free of seen dots, that is nearest to each guess, within reach; else the guess."""
        start, taken = guess[todo].copy(), (self.rest_px + guess)[seen]
        if len(taken) and len(candidates):
            apart = np.linalg.norm(candidates[:, None] - taken, axis=-1).min(axis=1)
            candidates = candidates[apart > self.radius_px]
        if len(candidates):
            away = candidates[None] - (self.rest_px[todo] + guess[todo])[:, None]
            length = np.linalg.norm(away, axis=-1)
            best = length.argmin(axis=1)
            near = length.min(axis=1) < reach
            start[near] += away[np.arange(len(todo)), best][near]
        return start

    def _clear(self, places: Array, candidates: Array) -> Mask:
        """Whether one candidate is much nearer to each place (M, 2) than any other; never so for crowded dots."""
        if len(candidates) < 2:
            return np.ones(len(places), dtype=bool)
        apart = np.linalg.norm(places[:, None] - candidates, axis=-1)
        apart.partition(1, axis=1)
        return np.asarray(apart[:, 0] < 0.5 * apart[:, 1])

    def _agreeing(self, shift: Array, seen: Mask) -> Mask:
        """The seen dots that move like their neighbors and stand alone; of two dots at one place, the better one stays."""
        astray = self._neighbors.astray_px(*self._with_cut(shift, seen))[: len(self)]
        seen = seen & (astray < 0.45 * self.spacing_px)
        number = np.nonzero(seen)[0]
        place = (self.rest_px + shift)[number]
        pairs = scipy.spatial.cKDTree(place).query_pairs(self.radius_px, output_type="ndarray")
        first, second = pairs.T
        worse = np.where(astray[number[first]] > astray[number[second]], number[first], number[second])
        seen[worse] = False
        return seen

    def _predicted(self, shift: Array, seen: Mask) -> Numbers:
        """Shifts of the unseen dots, predicted from the seen ones."""
        full, sure = self._with_cut(shift, seen)
        of = ~sure
        of[len(self) :] = False
        return self._neighbors.predicted_px(full, sure, of)

    def _of_all(self, shift: Array, seen: Mask) -> Numbers:
        """Shifts of all dots; those of dots that the border cuts come from their neighbors."""
        full, sure = self._with_cut(shift, seen)
        cut = np.arange(len(full)) >= len(self)
        if seen.any() and cut.any():
            full[cut] = self._neighbors.predicted_px(full, sure, cut)
        return full

    def _with_cut(self, shift: Array, seen: Mask) -> tuple[Any, Any]:
        """Shifts of all dots and whether they are sure; dots that the border cuts at rest come last, not sure."""
        more = len(self._all) - len(self)
        full = np.concatenate([shift, np.zeros((more, 2))])
        return full, np.concatenate([seen, np.zeros(more, dtype=bool)])


class MarkerTracker:
    """Follows the markers of one gel through a sequence of images.

    Each marker is searched for where its motion so far leads. So it can move by many spacings, but by less than about half
    of one from frame to frame. After a gap in which the gel sprang back, it is found at rest again.

    Parameters
    ----------
    background : (H, W, 3), 0-255, background image; or a MarkerFollower of it, which can be shared
    mm_per_px : float or (x, y), mm; a follower uses its own
    """

    def __init__(
        self, background: ArrayLike | MarkerFollower, mm_per_px: float | tuple[float, float] | None = None
    ) -> None:
        if not isinstance(background, MarkerFollower):
            background, mm_per_px = MarkerFollower(background, mm_per_px), None
        if mm_per_px is not None:
            raise ValueError("Expected mm_per_px of the follower itself, got another. Leave it out here.")
        self._follower = background
        self.reset()

    def __len__(self) -> int:
        return len(self._follower)

    def reset(self) -> None:
        """Forget all motion; the search in the next image starts from rest."""
        self._shift = self._velocity = np.zeros((len(self), 2))
        self._seen = len(self)

    def update(self, image: ArrayLike) -> MarkerFlow | None:
        """The positions in the sequence's next image (H, W, 3), 0-255; None if the gel has no markers."""
        pixels = check_image(image)
        if not len(self):
            return None
        flow = self._follower(pixels, self._shift + self._velocity)
        # If too many dots are lost, they may be where they were, or at rest.
        if flow.seen.sum() < self._seen - 0.1 * len(self):
            others = [self._follower(pixels, self._shift), self._follower(pixels)]
            flow = min((flow, *others), key=self._follower.unlikeliness)
        moved = flow.displacement_px - self._shift
        # Slower dots are searched for at their last position, so that noise is not extrapolated.
        fast = np.linalg.norm(moved, axis=1) > 0.05 * self._follower.spacing_px
        self._velocity = np.where((fast & flow.seen)[:, None], moved, 0)
        self._shift, self._seen = flow.displacement_px.astype(np.float64), int(flow.seen.sum())
        return flow
