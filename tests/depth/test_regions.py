"""Regions of a contact mask: their labels, and what is measured of each. The color change around a contact over that
inside, of images that are written out.
"""

import cv2
import numpy as np
import pytest
from scipy import ndimage

from gelform._native import Kernel
from gelform.depth import contact as regions_module
from gelform.depth.contact import Surround, contacts_from_mask, off_rest, unknown_contact
from gelform.errors import Finding
from gelform.foundations.checks import value_range
from kernel_agreement import assert_kernel_agrees

LABEL_REGIONS = Kernel("label_regions", "bool[h,w] mask, out u16[h,w] labels, out i32[n] work")
UNEVEN_PITCH = (0.05, 0.08)


def ellipse(shape, center, axes_mm, angle_deg):
    """Mask of an ellipse with full axes in mm, its major axis turned from x toward y."""
    y, x = np.mgrid[: shape[0], : shape[1]].astype(float)
    u, v = (x - center[0]) * UNEVEN_PITCH[0], (y - center[1]) * UNEVEN_PITCH[1]
    c, s = np.cos(np.deg2rad(angle_deg)), np.sin(np.deg2rad(angle_deg))
    return ((u * c + v * s) * 2 / axes_mm[0]) ** 2 + ((v * c - u * s) * 2 / axes_mm[1]) ** 2 < 1


@pytest.mark.parametrize("angle", [-80, -30, 0, 20, 75])
def test_the_axes_of_an_ellipse(angle):
    mask = ellipse((120, 200), (90.3, 61.2), (4.0, 2.0), angle)
    ((found,), _) = contacts_from_mask(mask, np.ones(mask.shape), mm_per_px=UNEVEN_PITCH)
    assert found.axes_mm == pytest.approx((4, 2), rel=0.01)
    assert found.angle_deg == pytest.approx(angle, abs=1)
    assert found.centroid_px == pytest.approx((90.3, 61.2), abs=0.1)
    assert found.area_mm2 == pytest.approx(np.pi * 2, rel=0.01)


def test_volume_and_deepest_place_of_a_paraboloid():
    y, x = np.mgrid[:120, :200].astype(float)
    r2 = ((x - 120) * UNEVEN_PITCH[0]) ** 2 + ((y - 40) * UNEVEN_PITCH[1]) ** 2
    depth = 0.6 * (1 - r2 / 1.5**2)
    ((found,), _) = contacts_from_mask(depth > 0, depth, mm_per_px=UNEVEN_PITCH)
    assert found.volume_mm3 == pytest.approx(0.6 * np.pi * 1.5**2 / 2, rel=0.01)
    assert found.deepest_px == (120, 40)
    assert found.deepest_mm == pytest.approx(0.6)


def test_several_contacts_come_largest_first_and_corners_connect():
    mask = np.zeros((30, 40), dtype=bool)
    mask[2:4, 2:4] = mask[4:6, 4:6] = mask[10:20, 10:20] = True
    found, labels = contacts_from_mask(mask, mask * 0.5, mm_per_px=0.1)
    assert [one.area_px for one in found] == [100, 8]
    for one in found:
        assert (labels == one.label).sum() == one.area_px
        assert labels[one.deepest_px[::-1]] == one.label
    assert [one.volume_mm3 for one in found] == pytest.approx([0.5, 0.04])


@pytest.mark.parametrize("side", [np.s_[0, 5], np.s_[-1, 5], np.s_[5, 0], np.s_[5, -1]])
def test_every_border_cuts(side):
    mask = np.zeros((12, 12), dtype=bool)
    mask[5, 5] = True
    assert not contacts_from_mask(mask, mask * 1.0, mm_per_px=1.0)[0][0].cut_by_border
    mask[side] = True
    cut = [one.cut_by_border for one in contacts_from_mask(mask, mask * 1.0, mm_per_px=1.0)[0]]
    assert sum(cut) == 1


def test_one_pixel_is_a_contact_of_a_pixel_s_size_and_none_is_no_contact():
    mask = np.zeros((12, 12), dtype=bool)
    found, labels = contacts_from_mask(mask, np.zeros(mask.shape), mm_per_px=0.1)
    assert found == ()
    assert (labels.shape, labels.dtype, labels.any()) == ((12, 12), np.uint16, False)
    mask[7, 3] = True
    ((found,), _) = contacts_from_mask(mask, np.full(mask.shape, -0.2), mm_per_px=0.1)
    assert found.axes_mm == pytest.approx((0.1 * 4 / 12**0.5,) * 2)
    assert (found.deepest_mm, found.volume_mm3) == pytest.approx((-0.2, -0.002))


def test_the_deepest_pixel_is_a_known_one():
    """Unknown pixels that are deeper, or next to it, say so; those that are neither do not."""
    mask, known = np.zeros((12, 20), bool), np.ones((12, 20), bool)
    mask[3:9, 2:8] = mask[3:9, 11:17] = True
    depth = 0.1 * mask
    depth[5, 4], depth[5, 6], depth[5, 13] = 0.5, 0.3, 0.4
    known[5, 4] = False

    def found():
        contacts, _ = contacts_from_mask(mask, depth, mm_per_px=0.1, known=known)
        return [(one.deepest_mm, one.deepest_px, one.at_least) for one in contacts]

    assert found() == [(pytest.approx(0.3), (6, 5), True), (pytest.approx(0.4), (13, 5), False)]
    depth[5, 4] = 0.2
    assert found()[0] == (pytest.approx(0.3), (6, 5), False)
    known[4, 7] = False
    assert found()[0] == (pytest.approx(0.3), (6, 5), True)
    known[mask] = False
    assert found()[0] == (pytest.approx(0.3), (6, 5), True)
    assert "at least 0.300 mm deep" in repr(contacts_from_mask(mask, depth, mm_per_px=0.1, known=known)[0][0])


@pytest.mark.parametrize(
    ("wrong", "error", "text"),
    [
        ({"contact": np.zeros((8, 8))}, TypeError, "contact as bool"),
        ({"contact": [[1, 2], [3]]}, ValueError, "contact as an array, got a list of unequal parts"),
        ({"contact": np.zeros((8, 7), bool)}, ValueError, r"one frame, \(H, W\), got \(8, 7\)"),
        ({"mm_per_px": 0}, ValueError, "mm_per_px > 0"),
    ],
)
def test_wrong_input(wrong, error, text):
    usual = {"contact": np.zeros((8, 8), bool), "depth": np.zeros((8, 8)), "mm_per_px": 1.0}
    with pytest.raises(error, match=text):
        contacts_from_mask(**usual | wrong)


def test_a_gel_that_changed_without_a_contact_is_said():
    rest, known, none = np.ones((40, 50), bool), np.ones((40, 50), bool), np.zeros((40, 50), bool)

    def found(contact, is_touched=True):
        return unknown_contact(
            contact,
            np.float32(0.01) * ~rest,
            np.full(rest.shape, 0.01, np.float32),
            rest,
            known,
            lambda: is_touched,
        )

    assert found(none) == ()
    rest[10:30, 10:30] = False
    (one,) = found(none)
    assert (one.name, one.figure) == ("contact_unknown", pytest.approx(0.2))
    assert one.message.endswith("Depth reads up to 0.01 +- 0.01 mm at (10, 10) px.")
    assert found(~rest) == ()
    assert found(none, False) == (), "here and there, as by compression"
    known[5:35, 5:35] = False  # another fault, without a depth that is sure
    assert found(none) == ()


def test_a_touched_region_that_is_unknown_in_part_is_said():
    """An imprint of which most is unknown beside one that is known, dust in it, and dots that hide it."""
    contact, known = np.zeros((2, 60, 90), bool)
    contact[10:30, 10:30] = contact[40:50, 50:60] = True
    rest = ~cv2.dilate(contact.astype(np.uint8), np.ones((9, 9), np.uint8)).astype(bool)
    depth, known[:], hidden = np.float32(0.3) * ~rest, True, np.zeros((60, 90), bool)

    def found(**other):
        given = {
            "contact": contact,
            "depth": depth,
            "sigma": np.full(rest.shape, 0.01, np.float32),
            "hidden": hidden,
        }
        given |= {"at_rest": rest, "known": known, "is_touched": lambda: True, "pitch": 0.1}
        return [(one.name, round(one.figure, 2)) for one in unknown_contact(**given | other)]

    assert found() == []
    known[12:14, 12:14] = known[7, 7] = False
    assert found() == [], "dust"
    known[10:30, 16:30] = contact[10:30, 16:30] = False
    assert found() == [("contact_unknown", 0.71)]
    assert found(hidden=~known) == [], "dots"
    contact[10:30, 10:16] = False
    assert found() == [("contact_unknown", 1.0)], "all of it, while another stands"
    assert found(depth=0.15 * depth) == [], "no depth that is sure"
    assert found(pitch=0.01) == [], "a speck"


def test_the_sums_of_touched_regions_are_those_of_numpy():
    def summed(contact, known, at_rest, hidden, depth, sigma, sums, work, factor, least, least_unknown):
        unknown = ~(known | at_rest | (False if hidden is None else hidden))
        labels, count = ndimage.label(contact | unknown, np.ones((3, 3)))
        if not unknown.any() or unknown.sum() < least_unknown:
            return sums
        deep = contact | (depth > np.float32(factor) * (np.float32(0) if sigma is None else sigma))
        y, x = np.indices(depth.shape)
        rows = [
            [at.sum(), unknown[at].sum(), x[at].sum(), y[at].sum()]
            for at in (labels == k for k in range(1, count + 1))
            if at.sum() >= np.float32(least) and deep[at].any()
        ]
        large = sum((labels == k).sum() >= np.float32(least) for k in range(1, count + 1))
        return np.concatenate([np.reshape(rows, (-1, 4)), np.zeros((large - len(rows), 4)), sums[large:]])

    assert_kernel_agrees(regions_module._touched_regions, summed)


def test_depth_that_no_contact_makes_is_said():
    """A valley deeper than any contact, and a hill that none was found in; neither up to what rest is known to."""
    contact, known = np.zeros((40, 50), bool), np.ones((40, 50), bool)
    depth, sigma = np.zeros((40, 50), np.float32), np.full((40, 50), 0.03, np.float32)

    def found():
        return [
            (round(one.figure, 2), one.message)
            for one in off_rest(depth, value_range(depth * known), sigma, contact, known, unknown)
        ]

    unknown = ()
    depth[3, 4] = 0.05
    assert found() == []
    depth[3, 4] = 0.2
    ((figure, message),) = found()
    assert figure == 0.2
    assert "pressed in by 0.20 +- 0.03 mm at (4, 3) px" in message
    unknown = (Finding("contact_unknown", "", 0.5),)
    assert found() == [], "that a contact is unknown says it"
    contact[3, 4] = True
    assert found() == []
    depth[30, 2] = -0.15
    assert found() == []
    depth[30, 2] = -0.25
    ((figure, message),) = found()
    assert figure == 0.25
    assert "rise by 0.25 +- 0.03 mm at (2, 30) px" in message
    known[30, 2] = False
    assert found() == []


def test_moments_agree_with_numpy():
    def by_numpy(labels, depth, moments):
        y, x = np.indices(labels.shape).astype(float)
        rows = np.zeros(moments.shape)
        for k in set(labels.ravel().tolist()) - {0}:
            here = labels == k
            top = np.argmax(np.where(here, depth, -9))
            u, v, z = x[here], y[here], depth[here].astype(float)
            sums = [len(u), u.sum(), v.sum(), (u * u).sum(), (u * v).sum(), (v * v).sum(), z.sum(), z.max()]
            rows[k - 1] = [*sums, x.flat[top], y.flat[top], u.min(), u.max(), v.min(), v.max()]
        return rows

    assert_kernel_agrees(regions_module._region_moments, by_numpy)


def test_labels_agree_with_scipy():
    def by_scipy(mask, labels, work):
        labels, count = ndimage.label(mask, np.ones((3, 3)))
        firsts = np.argsort([np.argmax(labels == k) for k in range(1, count + 1)])
        order = np.zeros(count + 1, np.uint16)
        order[firsts + 1] = np.arange(1, count + 1)
        return order[labels]

    assert_kernel_agrees(LABEL_REGIONS, by_scipy)


def test_labels_and_moments_are_those_of_the_steps():
    def by_steps(contact, depth, labels, moments, work):
        moments = moments.copy()
        regions = moments[: LABEL_REGIONS(contact, labels, work)]
        regions_module._region_moments(labels, depth, regions)
        return labels, moments

    assert_kernel_agrees(regions_module._contact_moments, by_steps)


def test_more_regions_than_labels_are_told():
    mask = np.zeros((600, 600), bool)
    mask[::2, ::2] = True
    with pytest.raises(ValueError, match="at most 65535 separate contacts, got 90000"):
        contacts_from_mask(mask, np.zeros(mask.shape), mm_per_px=1.0)


def test_a_contact_is_one_short_line():
    mask = np.zeros((20, 30), bool)
    mask[5:10, 0:8] = True
    ((found,), _) = contacts_from_mask(mask, np.full(mask.shape, 0.5), mm_per_px=0.1)
    assert repr(found) == "Contact(1: 0.4 mm^2, 0.500 mm deep, around (4, 7) px, cut by the border)"
    ((found,), _) = contacts_from_mask(mask, np.full(mask.shape, 5.0), mm_per_px=None)
    assert repr(found) == "Contact(1: 40 px, around (4, 7) px, cut by the border)"


SHAPE = (120, 160)


def images(inside, outside, level=90.0):
    """Background, image and contact: a square whose gray levels changed by one amount, all else by another."""
    background = np.full((*SHAPE, 3), level, dtype=np.float32)
    contact = np.zeros(SHAPE, dtype=bool)
    contact[42:81, 60:99] = True
    image = background + np.where(contact, inside, outside)[..., None]
    return background, image.astype(np.float32), contact


def ratio(changes):
    outside, inside = changes
    return outside / inside


@pytest.mark.parametrize(
    ("inside", "outside", "wanted"), [(40, 0, 0), (40, 10, 0.25), (-40, 20, 0.5), (20, 30, 1.5)]
)
def test_the_part_of_the_change_that_is_outside(inside, outside, wanted):
    background, image, contact = images(inside, outside)
    for given in (image, image.astype(np.uint8)):
        assert ratio(Surround(background)(given, contact)) == pytest.approx(wanted, rel=0.05)


def test_a_contact_over_most_of_the_image_or_on_dark_gel():
    background, _, contact = images(0, 0)
    wide = np.zeros(SHAPE, dtype=bool)
    wide[6:114, 6:154] = True
    image = background + np.where(wide, 40, 20)[..., None].astype(np.float32)
    assert ratio(Surround(background)(image, wide)) == pytest.approx(0.5, rel=0.05)
    background[:, 70:] = 20  # not of one half: means and medians would be alike
    change = np.where(contact, 0.5, 0.1)[..., None] * (background + 10)
    assert ratio(Surround(background)(background + change, contact)) == pytest.approx(0.2, rel=0.05)


def test_none_without_an_inside_or_an_outside_and_small_odd_images():
    background, image, contact = images(40, 0)
    assert Surround(background)(image, np.zeros_like(contact))[1] is None
    assert Surround(background)(image, np.ones_like(contact))[0] is None
    assert Surround(background)(background, contact) == (0, 0)
    rest = np.full((37, 53, 3), 90, dtype=np.float32)
    contact = np.zeros((37, 53), dtype=bool)
    contact[10:20, 10:20] = True
    touched = rest + 20 * contact[..., None].astype(np.float32)
    assert ratio(Surround(rest)(touched, contact)) == pytest.approx(0, abs=1e-6)


def test_color_changes_agree_with_numpy():
    """Pixels between which an image is sampled, in single precision: 8-bit levels are rounded."""

    def places(small, large):
        at = (np.arange(small) + 0.5) * (large / small) - 0.5
        first = np.clip(at.astype(int), 0, max(large - 2, 0))
        return first, np.minimum(first + 1, large - 1), np.clip(at - first, 0, 1).astype(np.float32)

    def by_numpy(pixels, levels, contact, gain, rest, coarse, work, changes):
        image = (levels if pixels is None else pixels).astype(np.float32)
        (rows, columns), (h, w) = gain.shape[:2], contact.shape
        (up, low, down), (left, right, along) = places(rows, h), places(columns, w)
        down, along = down[:, None, None], along[:, None]
        above, below = (
            image[at][:, left] + along * (image[at][:, right] - image[at][:, left]) for at in (up, low)
        )
        found = above + down * (below - above)
        found = found if pixels is None else np.floor(found + np.float32(0.5))
        inside = contact[np.arange(rows) * h // rows][:, np.arange(columns) * w // columns]
        outside = ~ndimage.binary_dilation(inside, np.ones((3, 3)))
        change = np.sqrt(np.square(found.astype(float) * gain - rest).mean(-1))
        around = np.sort(change[outside])
        return found, np.array(
            [around[len(around) // 2] if len(around) else 0, change[inside].mean() if inside.any() else 0]
        )

    assert_kernel_agrees(regions_module._color_around, by_numpy)
