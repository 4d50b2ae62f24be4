"""Markers on the gel: found at rest, followed in frames, and hidden from depth."""

from gelform.image.markers.finder import MarkerFinder, Markers, markers_from_image
from gelform.image.markers.follower import MarkerFlow, MarkerFollower, MarkerTracker

__all__ = ["MarkerFinder", "MarkerFlow", "MarkerFollower", "MarkerTracker", "Markers", "markers_from_image"]
