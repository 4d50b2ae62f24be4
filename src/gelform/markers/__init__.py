"""Marker dots on the gel: found at rest, followed in frames, their pixels left out of depth."""

from gelform.markers.finder import MarkerFinder, Markers, markers_from_image
from gelform.markers.flow import MarkerFlow

__all__ = ["MarkerFinder", "MarkerFlow", "Markers", "markers_from_image"]
