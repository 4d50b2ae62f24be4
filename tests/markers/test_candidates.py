"""Candidates are where dots are, and nowhere on a gel without them."""

import numpy as np

from gelform.markers.candidates import CandidateFinder
from gelform.markers.patches import logs_from_image
from made.dots import RADIUS, grid, image_of_dots

REST = grid()


def test_candidates_stand_on_the_dots():
    finder = CandidateFinder(logs_from_image(image_of_dots(REST, noise=1.0)), REST, RADIUS)
    places = np.add(REST, [3.0, 5.0])
    found = finder(logs_from_image(image_of_dots(places, noise=1.0, seed=1, light=0.5)))
    apart = np.linalg.norm(found[:, None] - places, axis=-1)
    inside = np.all((places > 4) & (places < [123, 91]), axis=1)
    assert apart.min(axis=0)[inside].max() < 1.5
    assert apart.min(axis=1).max() < 1.5


def test_no_candidates_without_dots():
    finder = CandidateFinder(logs_from_image(image_of_dots(REST)), REST, RADIUS)
    assert finder(logs_from_image(image_of_dots(REST[:0], noise=2.0, light=0.6))).shape == (0, 2)
