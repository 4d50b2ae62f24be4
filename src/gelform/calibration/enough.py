"""The number of presses that each part of a calibration needs, with the reasons.

They count accepted presses (`circles.locate`), except where a row says something else. docs/press-folder.md shows
the same table. A color model states the needs of its own settings (`variants`).
"""

from __future__ import annotations

from typing import NamedTuple

from gelform.color_models import DEFAULT_MODEL, PLAIN_MODEL


class Need(NamedTuple):
    """A number of presses, its purpose, and the reason that no fewer are enough."""

    presses: int
    what: str
    why: str


NEEDED = {
    "model": Need(2, "a color model that circles are moved with", "one press agrees with itself, wherever its circle is"),
    "places": Need(3, "a calibration; presses at different places", "each fold is held out from two others at least"),
    "interval": Need(3, "a figure's interval, a bin of the gain curve", "two drawn with replacement say nothing of others"),
    "spread": Need(3, "the note that all presses lie in one part of the image", "two lie in one part by chance"),
    "median": Need(5, "the check for a contact in the background (images)", "their median shows the gel at rest"),
    "guided": Need(5, "a calibration from presses that the live page guides (images)", "each of five folds holds one out"),
    "forecast": Need(6, "the live page's forecast (images)", "a half and three quarters of them train, the others test"),
    "whole": Need(6, "circles moved by presses alone that the border does not cut", "fewer leave the model without places"),
    "learning curve": Need(8, "a learning curve", "with fewer nothing is left to hold out"),
    "learning law": Need(10, "a point of the curve that its law is fitted to", "fewer follow no law: circles are uncertain"),
    "judged gain": Need(10, "a bin of the gain curve that counts for the verdict", "the chance of few presses is no fault"),
    "fair": Need(10, "the verdict fair on presses used", "fewer leave whole parts of the gel unseen"),
    "edge": Need(12, "the contact's edge, measured", "fewer do not know the light at every place: 0.85 is taken"),
    "size": Need(12, "a size of ball that another one is read by", "fewer do not know the light at every place"),
    "guided well": Need(12, "the live page to say that they are enough (images)", "the contact's edge is measured then"),
    "advised": Need(20, "no note that more presses are advised", "10 read contacts within 2.4 degrees, 20 within 1.9"),
    "good": Need(30, "the verdict good on presses used", "normals hardly improve with more"),
    "settings": Need(30, "a learning curve of the chosen settings alone", "up to there simpler settings may be better"),
}  # fmt: skip

SAMPLED = 24  # presses that stand for all in a median
FOLDS = 5  # groups of presses, each held out in turn: the other four fifths train

# Position degrees of the polynomial that moves uncertain circles, from a number of presses on.
REFINING = ((0, (1,)), (6, (2, 1)), (9, (3, 2, 0)))

# Candidates of "auto", from a number of presses on: a color model with its settings, or with all its variants (None). With 5
# presses a polynomial of few terms has an error of 7.6 degrees, `hierarchical` of 10.5; from 12 on `hierarchical` is better.
AUTO_MODELS = (
    (0, PLAIN_MODEL, (("position_degrees", (1,)),)),
    (6, PLAIN_MODEL, (("position_degrees", (2, 1)),)),
    (12, DEFAULT_MODEL, None),
)


def enough(what: str, presses: int) -> bool:
    """Whether a number of presses is enough for a row of the table."""
    return presses >= NEEDED[what].presses
