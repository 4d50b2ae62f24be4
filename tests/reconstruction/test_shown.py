"""What a notebook shows: a picture and the figures, nothing from outside, no markup of others."""

import base64
import re
from dataclasses import replace

import cv2
import numpy as np


def test_a_notebook_shows_a_picture_and_the_figures(result):
    bump = np.zeros((24, 32), dtype=np.float32)
    bump[:, 24:] = 0.75
    shown = replace(result, depth=bump)._repr_html_()
    assert "&lt;b&gt;darker&lt;/b&gt; &amp; older" in shown
    assert "0.000 to 0.750 mm" in shown
    assert not re.search(r"https?://|<script", shown)
    png = base64.b64decode(re.search(r"base64,([^']+)'", shown)[1])
    picture = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR)
    assert picture.shape == (180, 240, 3)
    assert picture[90, 220].astype(int).sum() > picture[90, 20].astype(int).sum() + 200
    assert len(shown) < 100_000
    assert "0.750 mm" in repr(replace(result, depth=bump))
