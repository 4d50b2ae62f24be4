"""Every press in the page: its circle in image pixels, its reason where it is rejected."""

import re

import numpy as np
import pytest

from gelform.calibration.report.page.presses import caps_section, presses_section, short_names


@pytest.mark.parametrize(
    ("names", "short"),
    [
        (["a/0/gelsight.png", "a/1/gelsight.png"], ["a/0", "a/1"]),
        (["0.png", "10.png"], ["0", "10"]),
        (["0.png", "1.jpg"], ["0.png", "1.jpg"]),
        (["x10.png", "y10.png"], ["x10", "y10"]),
        (["x" * 50 + ".png", "y.png"], ["x" * 13 + "…" + "x" * 14, "y"]),
        (["only.png"], ["only"]),
        ([".png", "a.png"], [".png", "a"]),
    ],
)
def test_names_lose_what_all_share(names, short):
    assert short_names(names) == short


def test_circles_are_in_image_pixels(content, presses):
    drawn = presses_section(content, [press.image for press in presses.presses])
    row = content["presses"][0]
    assert (
        f'cx="{row["center_x_px"]:.2f}" cy="{row["center_y_px"]:.2f}" r="{row["contact_radius_px"]:.2f}"'
        in drawn
    )
    assert drawn.count("<label") == len(content["presses"])


def test_rejected_presses_come_first_with_their_reasons(content, presses):
    rows = [dict(row) for row in content["presses"]]
    rows[-1] |= {"accepted": False, "reason": "not a ball <b>", "errors": None}
    drawn = presses_section({**content, "presses": rows}, [press.image for press in presses.presses])
    assert "Rejected: 1" in drawn
    assert "not a ball &lt;b&gt;" in drawn
    assert drawn.index("not a ball") < drawn.index("Used:")
    assert "Rejected" not in presses_section(content, [np.asarray(p.image) for p in presses.presses])


def test_every_held_out_press_has_its_depth_picture(content, calibration):
    drawn = caps_section(content, calibration.report.samples)
    rows = content["presses"]
    assert re.findall(r"<figcaption>(\d+) µm", drawn) == [
        f"{row['errors']['cap_free_um']:.0f}" for row in rows if row["errors"]
    ]
    assert caps_section(content, []) == ""
