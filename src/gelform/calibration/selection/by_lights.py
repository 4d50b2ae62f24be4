"""Whether colours are carried to depth 0 by the law of near lights before slopes are read: judged by that law itself.

Errors on balls that were left out do not see how the gel around contacts is read, so they cannot choose. Whether the law
is that of the sensor they do see: where near lights explain the colours in the contacts, what they say of the depth holds.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial

from gelform.calibration.circles.refine import Refined
from gelform.calibration.circles.samples import PreparedPress
from gelform.calibration.selection.select import Selection, worse_on_balls
from gelform.calibration.selection.trials import HeldOutPresses
from gelform.color_models import DepthByLightsModel, HierarchicalModel

LEAST_PRESSES = 25  # the rule was made and judged on 30; a calibration takes half as long again
# Part of the colours, root mean square, that near lights may leave unexplained. On simulated sensors in the open they leave
# 0.05-0.21; on a real GelSight Mini 0.49, where the law says nothing true of the depth.
MOST_UNEXPLAINED = 0.28


def judged_by_lights(
    by_offset: Mapping[float, Sequence[PreparedPress]],
    refined: Refined,
    selection: Selection,
    held_out: HeldOutPresses,
) -> tuple[Selection, tuple[str, ...]]:
    """The selection, with `depth_by_lights` in the place of a chosen `hierarchical`.

    That is where there are 25 presses, near lights explain their colours, and balls that were left out are not read worse.

    Parameters
    ----------
    by_offset, refined, held_out : what the selection was made from
    selection : by `auto`, and by punches where there are any
    """
    chosen = selection.chosen
    fits = chosen.model == HierarchicalModel.name and chosen.start is None
    if not fits or len(refined.accepted) < LEAST_PRESSES:
        return selection, ()
    samples = chosen.samples(*refined.of_accepted(by_offset[chosen.change_offset]))
    _, unexplained = DepthByLightsModel.lights_of(samples)
    if unexplained > MOST_UNEXPLAINED:
        return selection, ()
    lit = partial(replace, model=DepthByLightsModel.name)
    (trial,) = held_out.try_candidates([lit(chosen)])
    said = f"Near lights explain all but {100 * unexplained:.0f} % of the colours, and so what depth does to them: "
    if worse_on_balls(trial, selection):
        return selection, (f"{said}{DepthByLightsModel.name} reads balls worse, though, and was not chosen.",)
    return selection.exchanged(trial, lit), (f"{said}{DepthByLightsModel.name} was chosen.",)
