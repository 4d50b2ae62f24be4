"""All checks that look at some ten seconds together."""

from __future__ import annotations

from gelform.findings import Finding
from gelform.streams.evidence import Evidence
from gelform.streams.health.light import room_light_finding
from gelform.streams.health.marks import Marks
from gelform.streams.health.place import Place


class Examination:
    """Holds each evidence against the untouched image of the start; remembers what stayed from one to the next."""

    def __init__(self) -> None:
        self._marks = Marks()
        self._place: Place | None = None
        self._start: object = None

    def __call__(self, evidence: Evidence) -> tuple[Finding, ...]:
        """The findings: `camera_moved`, `other_gel`, `room_light`, `scratch`, `dust`, `tear`.

        The first cause stands for what follows from it: in light from outside the gel looks like another one, and on a gel
        that has moved every speck is new.
        """
        if self._place is None or evidence.start is not self._start:
            self._place, self._marks, self._start = Place(evidence.start), Marks(), evidence.start
        outside = room_light_finding(evidence)
        return outside or self._place(evidence) or self._marks(evidence)
