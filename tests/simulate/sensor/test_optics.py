"""Lenses and cameras that cannot be."""

import re

import pytest

from gelform.simulate import Optics

REFUSED = [
    (lambda: Optics(height_mm=0.1), "height_mm"),
    (lambda: Optics(distortion=(-0.6, 0)), "fold"),
    (lambda: Optics(jpeg_quality=0), "jpeg_quality"),
    (lambda: Optics(response_gamma=0), "response_gamma"),
]


@pytest.mark.parametrize(("make", "message"), REFUSED)
def test_bad_settings_are_refused_with_the_reason(make, message):
    with pytest.raises(ValueError, match=re.escape(message)):
        make()
