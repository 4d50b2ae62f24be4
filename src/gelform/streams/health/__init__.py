"""What is wrong with a sensor, as only a sequence of frames shows it: named findings with figures."""

from gelform.streams.health.examination import Examination
from gelform.streams.health.frozen import FROZEN, Frozen
from gelform.streams.health.light import light_findings

__all__ = ["FROZEN", "Examination", "Frozen", "light_findings"]
