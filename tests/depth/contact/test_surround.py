"""The color change around a contact over that inside, of images that are written out."""

import numpy as np
import pytest

from gelform.depth.contact import Surround

SHAPE = (120, 160)


def images(inside, outside, level=90.0):
    """Background, image and contact: a square whose gray levels changed by one amount, all else by another."""
    background = np.full((*SHAPE, 3), level, dtype=np.float32)
    contact = np.zeros(SHAPE, dtype=bool)
    contact[42:81, 60:99] = True
    image = background + np.where(contact, inside, outside)[..., None]
    return background, image.astype(np.float32), contact


@pytest.mark.parametrize(
    ("inside", "outside", "wanted"), [(40, 0, 0), (40, 10, 0.25), (-40, 20, 0.5), (20, 30, 1.5)]
)
def test_the_part_of_the_change_that_is_outside(inside, outside, wanted):
    background, image, contact = images(inside, outside)
    assert Surround(background)(image, contact) == pytest.approx(wanted, rel=0.05)
    whole = image.astype(np.uint8)
    assert Surround(background)(whole, contact) == pytest.approx(wanted, rel=0.05)


def test_a_contact_over_most_of_the_image():
    background, image, _ = images(0, 0)
    contact = np.zeros(SHAPE, dtype=bool)
    contact[6:114, 6:154] = True
    image = background + np.where(contact, 40, 20)[..., None].astype(np.float32)
    assert Surround(background)(image, contact) == pytest.approx(0.5, rel=0.05)


def test_dark_gel_counts_as_much_as_bright():
    background, _, contact = images(0, 0)
    background[:, 80:] = 20
    change = np.where(contact, 0.5, 0.1)[..., None]
    assert Surround(background)((background + change * (background + 10)), contact) == pytest.approx(
        0.2, rel=0.05
    )


def test_none_without_an_inside_or_an_outside():
    background, image, contact = images(40, 0)
    assert Surround(background)(image, np.zeros_like(contact)) is None
    assert Surround(background)(image, np.ones_like(contact)) is None
    assert Surround(background)(background, contact) is None


def test_small_and_odd_images():
    rest = np.full((37, 53, 3), 90, dtype=np.float32)
    contact = np.zeros((37, 53), dtype=bool)
    contact[10:20, 10:20] = True
    assert Surround(rest)(rest + 20 * contact[..., None].astype(np.float32), contact) == pytest.approx(
        0, abs=1e-6
    )
