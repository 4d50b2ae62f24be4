"""Whether the color model should know the depth, and how much of it: judged by flat punches of known height.

Errors on balls that were left out do not see how slopes around contacts are read, and with them the depth of a whole
contact. A punch of known height does. Depths that `depth_aware` reads grow almost evenly from those of its plain model
with the share of its terms of the depth that is used, so the share is a regression through the origin:
what the punches miss of their heights, on what the terms add. Without a punch nothing is judged.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import cv2
import numpy as np
from numpy.typing import NDArray

from gelform.calibration.circles.refine import Refined
from gelform.calibration.circles.samples import PreparedPress
from gelform.calibration.draft import fit_all
from gelform.calibration.presses.press_set import FlatPress, Presses
from gelform.calibration.selection.candidates import Candidate
from gelform.calibration.selection.select import Selection, worse_on_balls
from gelform.calibration.selection.trials import HeldOutPresses
from gelform.calibration_file import Calibration
from gelform.color_models import DepthAwareModel, HierarchicalModel
from gelform.reconstruct import Reconstructor
from gelform.reconstruction import Reconstruction

RELATIVE_SIGMA = 0.04  # of a height that is read: walls, tilt, the place
ABSOLUTE_SIGMA_MM = 0.01  # of a height as users know it
CLEAR = 2.0  # standard errors by which the share has to differ from 0
INFORMED = 0.5  # standard error of a share up to which it is used where the model was asked for by name
MOST = 1.25  # of the share; what punches ask for clearly beyond it has other causes
STEEP = 0.75  # of the steepest slopes that balls show: a punch with a steeper wall is read low for that
WALL = (0.3, 0.7)  # parts of the largest depth between which the wall is
STANDING = 0.5  # of the largest depth: more than that is the punch and a narrow strip around it
MIDDLE = 0.6  # of the radius of a disc as large as what stands: the face, without its edge
SMOOTHED_PX = 5
UNREAD = "cut by the border, without a face, or pressed in so far that the wall around the face is too steep to read"


@dataclass(frozen=True)
class HeightJudgement:
    """What punches of known height say of the terms of the depth.

    Attributes
    ----------
    known_mm : (N,) the heights of the punches whose face was found
    plain_mm, aware_mm : (N,) what the plain model reads, and the model with all of its terms of the depth
    share, share_sigma : of these terms that reads the heights best, and its standard error
    """

    known_mm: NDArray[np.float64]
    plain_mm: NDArray[np.float64]
    aware_mm: NDArray[np.float64]
    share: float
    share_sigma: float

    @property
    def used_share(self) -> float:
        """The share between 0 and 1.25."""
        return round(float(np.clip(self.share, 0, MOST)), 3)

    @property
    def clear(self) -> bool:
        """Whether the punches say clearly that terms of the depth read them better, and ask for no more than these."""
        return CLEAR * self.share_sigma < self.share < MOST + CLEAR * self.share_sigma

    @property
    def why_not(self) -> str:
        """Why the punches decide nothing."""
        if self.share > MOST + CLEAR * self.share_sigma:
            return "and more was asked for than these terms explain: check height_mm and mm_per_px."
        return "too unclear a difference to count."

    def percent(self, share: float) -> float:
        """Mean height over the known one with a share of the terms, per cent."""
        read = self.plain_mm + share * (self.aware_mm - self.plain_mm)
        return float(100 * np.mean(read / self.known_mm))


def judged_by_heights(
    presses: Presses,
    by_offset: Mapping[float, Sequence[PreparedPress]],
    refined: Refined,
    selection: Selection,
    held_out: HeldOutPresses,
    *,
    named: bool,
) -> tuple[Selection, tuple[str, ...]]:
    """The selection, with `depth_aware` chosen where flat punches of known height ask for it; and notes that say so.

    `depth_aware` takes the place of a chosen `hierarchical`, at its zone and settings, if the share of its terms is
    clearly above 0 and balls that were left out are not read worse.

    Parameters
    ----------
    presses : with `flats`; without them the selection stays
    by_offset, refined, held_out : what the selection was made from
    selection : made on presses of balls
    named : whether the color model was asked for by name: then only the share of a `depth_aware` is chosen
    """
    chosen = selection.chosen
    wanted = DepthAwareModel.name if named else HierarchicalModel.name
    if not presses.flats:
        return selection, ()
    if chosen.model != wanted or chosen.start is not None:
        return selection, (_unused(len(presses.flats), chosen),)
    whole = replace(chosen, model=DepthAwareModel.name)
    draft = fit_all(presses, by_offset[whole.change_offset], refined, whole)
    judged = judgement(draft, presses.flats)
    if judged is None:
        return selection, (f"{_counted(len(presses.flats))} of known height did not count: {UNREAD}.",)
    tells = judged.share_sigma <= INFORMED if named else judged.clear
    if not tells:
        return selection, (_said(judged, presses, judged.why_not),)
    with_share = partial(_aware, share=judged.used_share)
    (trial,) = held_out.try_candidates([with_share(chosen)])
    if not named and worse_on_balls(trial, selection):
        return selection, (_said(judged, presses, "but balls worse, so it was not chosen."),)
    return selection.exchanged(trial, with_share), (_said(judged, presses, "and was chosen."),)


def judgement(draft: Calibration, flats: Sequence[FlatPress]) -> HeightJudgement | None:
    """What punches say of the terms of a calibration's `depth_aware`; None where no face is found."""
    model = draft.color_model
    assert isinstance(model, DepthAwareModel)
    plain, aware = (
        _heights_read(replace(draft, color_model=one), flats) for one in (model.with_share(0), model)
    )
    known = np.array([flat.height_mm for flat in flats])
    found = np.isfinite(plain) & np.isfinite(aware)
    if not found.any():
        return None
    known, plain, aware = known[found], plain[found], aware[found]
    return HeightJudgement(known, plain, aware, *_share(known, plain, aware))


def _share(
    known: NDArray[np.float64], plain: NDArray[np.float64], aware: NDArray[np.float64]
) -> tuple[float, float]:
    """The share and its standard error: by the scatter of the heights, if that is more than is usual."""
    sigma = np.hypot(RELATIVE_SIGMA * known, ABSOLUTE_SIGMA_MM)
    added, missed = (aware - plain) / sigma, (known - plain) / sigma
    square = max(float(added @ added), 1e-12)
    share = float(added @ missed) / square
    scatter = np.sqrt(np.sum((missed - share * added) ** 2) / max(len(known) - 1, 1))
    return share, float(max(scatter, 1.0)) / square**0.5


def _heights_read(calibration: Calibration, flats: Sequence[FlatPress]) -> NDArray[np.float64]:
    """Heights of the faces, NaN where there is none or the wall is steep."""
    reconstruct = Reconstructor(calibration, depth_sigma=False)
    known = calibration.slope_sigma
    steepest = np.inf if known is None or known.steepest is None else float(np.median(known.steepest))
    results = [reconstruct.from_image(flat.image) for flat in flats]
    return np.array(
        [
            face_height_mm(result.depth_mm) if wall_slope(result) < STEEP * steepest else np.nan
            for result in results
        ]
    )


def wall_slope(result: Reconstruction) -> float:
    """Slope that most of the wall around a face stays under."""
    part = result.depth_mm / max(float(result.depth_mm.max()), 1e-9)
    slopes = np.linalg.norm(result.gradients[(part > WALL[0]) & (part < WALL[1])], axis=-1)
    return float(np.quantile(slopes, 0.95)) if slopes.size else 0.0


def face_height_mm(depth_mm: NDArray[np.float32]) -> float:
    """Mean depth in the middle of the largest flat face of a depth map (H, W); NaN where it is cut by the border.

    The mean about the middle does not feel a small tilt. A punch has to be about as wide as it is long.
    """
    top = float(cv2.blur(depth_mm, (SMOOTHED_PX, SMOOTHED_PX)).max())
    standing = (depth_mm > STANDING * top).astype(np.uint8)
    count, _, stats, centers = cv2.connectedComponentsWithStats(standing)
    if top <= 0 or count < 2:
        return float("nan")
    largest = 1 + int(np.argmax(stats[1:, cv2.CC_STAT_AREA]))
    left, up, width, height, area = stats[largest]
    if left == 0 or up == 0 or left + width == depth_mm.shape[1] or up + height == depth_mm.shape[0]:
        return float("nan")
    rows, columns = np.ogrid[: depth_mm.shape[0], : depth_mm.shape[1]]
    square = (columns - centers[largest][0]) ** 2 + (rows - centers[largest][1]) ** 2
    return float(depth_mm[square <= max(MIDDLE**2 * area / np.pi, 1.0)].mean())


def _aware(candidate: Candidate, share: float) -> Candidate:
    return replace(candidate, model=DepthAwareModel.name, settings=(*candidate.settings, ("share", share)))


def _unused(count: int, chosen: Candidate) -> str:
    why = "a start is given" if chosen.start is not None else f"the color model is {chosen.model}"
    return f"{_counted(count)} of known height did not count: {why}, which has no terms of the depth."


def _counted(count: int) -> str:
    return "1 press of a flat punch" if count == 1 else f"{count} presses of a flat punch"


def _said(judged: HeightJudgement, presses: Presses, end: str) -> str:
    found = len(judged.known_mm)
    plain, share = judged.percent(0), judged.used_share
    lost = len(presses.flats) - found
    return (
        f"{_counted(found)} of known height: the color model without terms of the depth reads {plain:.1f} % of it, "
        f"depth_aware with the share {share:g} of its terms (+- {judged.share_sigma:.2f}) {judged.percent(share):.1f} %, "
        + end
        + (f" {lost} more did not count: {UNREAD}." if lost else "")
    )
