"""ROS names and messages of a made-up result: units and signs by hand, NaN where unknown, levels of findings.

Depth for LeRobot: every whole micrometer is recovered, and nothing is clipped.
"""

import re
import sys
from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gelform import DataError, Frame, Reconstruction
from gelform.depth.force import ForceModel, ForcePart
from gelform.errors import Finding
from gelform.image.markers import MarkerFlow
from gelform.robots import depth_from_lerobot_levels, lerobot_levels_from_depth
from gelform.robots.ros_messages import RosMessages, optical_pose
from gelform.robots.topics import TOPICS, check_sensor_name, check_topics, sensor_name_from
from made.rigid_contacts import contact_of, pose, texture


def test_a_name_is_made_of_any_text_and_what_ros_refuses_is_refused():
    for text, name in [
        ("GelSight Mini", "gelsight_mini"),
        ("digit", "digit"),
        ("-- R1.5/b --", "r1_5_b"),
        ("3rd gel", "sensor_3rd_gel"),
        ("", "sensor"),
        ("ゲル", "sensor"),
    ]:
        assert sensor_name_from(text) == name
        assert check_sensor_name(name) == name
    for name in ["", "Left", "a__b", "_a", "a_", "3a", "a-b", "a/b", "a b", "a\n"]:
        with pytest.raises(ValueError, match="name of ROS"):
            check_sensor_name(name)


def test_topics_have_whole_names_and_come_in_the_tables_order():
    names = " ".join(topic.of("left") for topic in TOPICS.values())
    assert names == (
        "/left/image_raw /left/indentation /left/points /left/wrench /left/object_pose /diagnostics "
        "/left/image_raw/compressed"
    )
    assert all(re.fullmatch(r"\w+_msgs/msg/\w+", topic.type) for topic in TOPICS.values())
    assert check_topics(["points", "image", "points"]) == ("image", "points")
    assert check_topics("points") == ("points",)
    for wrong in ([], ["depth"], ["image", "camera_info"]):
        with pytest.raises(ValueError, match="Expected topics among image, indentation, points"):
            check_topics(wrong)


STAMP_NS = 1_700_000_000_000_000_009
FRAME = Frame(np.arange(2 * 3 * 3, dtype=np.uint8).reshape(2, 3, 3)[:, ::-1], 0.0, STAMP_NS, 0)
DEPTH_MM = np.array([[0.0, 0.5, -0.125], [1.0, 2.0, 0.25]], np.float32)


@pytest.fixture(scope="module")
def result():
    maps = np.ones((2, 3), np.float32)
    known = np.array([[True, True, True], [True, True, False]])
    slopes = np.zeros((2, 3, 2), np.float32)
    return Reconstruction(DEPTH_MM, None, slopes, None, maps, known, known, (0.5, 0.25))


@pytest.fixture(scope="module")
def made():
    pytest.importorskip("rosbags", reason="the extra ros is not installed")
    return RosMessages("left", "S1")


def decoded(made, message, kind):
    return made.store.deserialize_cdr(bytes(message), kind)


def test_depth_points_and_images_by_hand(made, result):
    image = decoded(made, made.indentation(FRAME, result, STAMP_NS), "sensor_msgs/msg/Image")
    meters = image.data.view("<f4").reshape(2, 3)
    np.testing.assert_allclose(meters, [[0, 5e-4, -1.25e-4], [1e-3, 2e-3, np.nan]], rtol=1e-6)
    assert (image.header.stamp.sec, image.header.stamp.nanosec) == (1_700_000_000, 9)
    cloud = decoded(made, made.points(FRAME, result, STAMP_NS), "sensor_msgs/msg/PointCloud2")
    points = cloud.data.view("<f4").reshape(2, 3, 3)
    np.testing.assert_allclose(points[0, 2], [5e-4, -1.25e-4, 1.25e-4], rtol=1e-6)
    np.testing.assert_allclose(points[1, 0], [-5e-4, 1.25e-4, -1e-3], rtol=1e-6)
    assert np.isnan(points[1, 2]).all()
    assert not cloud.is_dense
    image = decoded(made, made.image(FRAME, result, STAMP_NS), "sensor_msgs/msg/Image")
    np.testing.assert_array_equal(image.data.reshape(2, 3, 3), FRAME.image)


def test_levels_of_findings(made, result):
    def status(of):
        kind = "diagnostic_msgs/msg/DiagnosticArray"
        return decoded(made, made.diagnostics(FRAME, of, STAMP_NS), kind).status[0]

    found = (Finding("dust", "Clean it.", 0.25), Finding("drift", "Take a background.", 2.0))
    fine, warned = status(result), status(replace(result, health=found))
    lost = status(replace(result, health=found, known=np.zeros((2, 3), bool)))
    assert [one.level for one in (fine, warned, lost)] == [0, 1, 2]
    assert (fine.message, warned.message, fine.hardware_id) == ("OK", "dust, drift", "S1")
    assert fine.name == "gelform: left"
    said = [(pair.key, pair.value) for pair in warned.values]
    assert said == [("dust", "0.25: Clean it."), ("drift", "2: Take a background.")]


MODEL = ForceModel(
    ForcePart(((2.0,),), (0.1, 9.0), 0.2, 0.1, 9),
    ForcePart(((1.0, *[0.0] * 5), (0, 1.0, *[0.0] * 4)), (0.1, 2.0), 0, 0.1, 9),
    ForcePart(((*[0.0] * 5, 30.0),), (1.0, 40.0), 0, 1.0, 9), ((0.0, 0.0), (0.2, 0.0), (0.0, 0.2)), ("ball",), "", "",
)  # fmt: skip


def test_silence_is_an_error_and_the_next_frame_is_told_at_once(result):
    pytest.importorskip("rosbags", reason="the extra ros is not installed")
    told = RosMessages("left", topics=["diagnostics"])

    def count(of):
        return len(list(told.due(FRAME, of, STAMP_NS)))

    assert [count(result), count(result), count(torn(result))] == [1, 0, 1]
    kind = "diagnostic_msgs/msg/DiagnosticArray"
    status = decoded(told, told.silence("reconnecting", "unplugged", STAMP_NS), kind).status[0]
    assert (status.level, status.message) == (2, "no_frame")
    assert status.values[0].value == "reconnecting: unplugged"
    assert count(torn(result)) == 1


def torn(result):
    return replace(result, health=(Finding("torn", "Torn.", 0.5),))


def test_a_change_of_the_findings_is_looked_for_as_often_as_asked(made, result):
    told, times_s = RosMessages("left", topics=["diagnostics"], look_s=0.125), np.arange(0, 2, 1 / 60)
    # OK until 0.25 s, then torn: it is told at the next look, and once more a second later.
    said = [
        time_s
        for time_s in times_s
        if list(told.due(FRAME, torn(result) if time_s > 0.25 else result, int(time_s * 1e9)))
    ]
    assert said[:2] == pytest.approx([0, 0.383], abs=0.02)
    assert said[2:] == pytest.approx([said[1] + 1], abs=0.02)


def test_what_nobody_wants_is_not_made_but_the_pose_follows_all_the_same(monkeypatch, result):
    pytest.importorskip("rosbags", reason="the extra ros is not installed")
    told = RosMessages("left", topics=TOPICS)
    made = []
    for name in TOPICS:
        monkeypatch.setattr(told, name, lambda *_, name=name: made.append(name))
    list(told.due(FRAME, result, STAMP_NS, {"points"}.__contains__))
    assert made == ["points", "pose"]
    list(told.due(FRAME, result, STAMP_NS))
    assert made[2:] == list(TOPICS)


def test_compressed_is_the_camera_s_jpeg_or_the_pixels_without_loss(made, result):
    kind = "sensor_msgs/msg/CompressedImage"
    own = decoded(
        made, made.compressed(replace(FRAME, encoded=b"jpeg of the camera"), result, STAMP_NS), kind
    )
    assert (own.format, own.data.tobytes()) == ("jpeg", b"jpeg of the camera")
    assert own.header.frame_id == "left_camera_optical_frame"
    plain = decoded(made, made.compressed(FRAME, result, STAMP_NS), kind)
    assert plain.format == "png"
    np.testing.assert_array_equal(cv2.imdecode(plain.data, cv2.IMREAD_COLOR)[..., ::-1], FRAME.image)


def test_a_wrench_by_hand(made, result):
    """What presses into the gel pushes toward the camera; what is not known is NaN, and the diagnostics say why."""
    rest = (np.array(MODEL.rest_mm) / (0.5, 0.25)).astype(np.float32)
    moved = rest + np.array([0.6, -0.4], np.float32) / np.array([0.5, 0.25], np.float32)
    flow = MarkerFlow(rest, moved, np.ones(3, bool), np.ones(3, np.float32), (0.5, 0.25))
    inside = np.array([[False, False, False], [False, True, False]])
    touched = replace(result, contact=inside, outside_change=0.1, force_model=MODEL, markers=flow)

    wrench = RosMessages("left", topics="wrench")

    def sent(of):
        ((_, message),) = wrench.due(FRAME, of, STAMP_NS)
        return decoded(made, message, "geometry_msgs/msg/WrenchStamped")

    message = sent(touched)
    assert message.header.frame_id == "left_gel_optical_frame"
    force, torque = message.wrench.force, message.wrench.torque
    assert np.isnan(force.z), "the contact lies in the border band of so small an image"
    assert (force.x, force.y, torque.z) == pytest.approx((0.6, -0.4, 0.03), abs=1e-5)
    assert np.isnan([torque.x, torque.y]).all()
    kind = "diagnostic_msgs/msg/DiagnosticArray"
    status = decoded(made, made.diagnostics(FRAME, touched, STAMP_NS), kind).status[0]
    assert [(pair.key, "border" in pair.value) for pair in status.values] == [("no_force", True)]
    known, contact = np.ones((60, 80), bool), np.zeros((60, 80), bool)
    contact[20:30, 20:30] = True
    depth, slopes, ones = (
        0.4 * contact.astype(np.float32),
        np.zeros((60, 80, 2), np.float32),
        np.float32(known),
    )
    pressed = Reconstruction(depth, None, slopes, None, ones, contact, known, 0.1, outside_change=0.1)
    alone = sent(replace(pressed, force_model=MODEL)).wrench
    assert alone.force.z == pytest.approx(-2 * 0.4), "1 mm^2 and 0.4 mm deep, at 2 N/mm^3"
    assert np.isnan([alone.force.x, alone.torque.z]).all()
    assert list(wrench.due(FRAME, pressed, STAMP_NS)) == []


def test_the_pose_of_the_object_in_the_optical_frame(made):
    """Meters; z away from the camera, so a deeper object has a smaller z, and turns about x and y change their sign."""
    true, kind = pose(0.3, -0.2, 0.05, 2.0, 0.0, 4.0), "geometry_msgs/msg/PoseWithCovarianceStamped"
    fresh = RosMessages("left")
    contacts = [
        contact_of(texture(), one, radius_mm=mm) for one, mm in ((None, 3.2), (None, 0.1), (true, 3.2))
    ]
    first, none, second = (fresh.pose(FRAME, one, STAMP_NS) for one in contacts)
    assert none is None, "a lost frame has no message"
    at = decoded(made, first, kind).pose
    assert (at.pose.position.x, at.pose.orientation.w) == (0, 1)
    message = decoded(made, second, kind)
    assert message.header.frame_id == "left_gel_optical_frame"
    at = message.pose.pose
    place = [at.position.x, at.position.y, at.position.z]
    np.testing.assert_allclose(place, true[:3, 3] * [1e-3, 1e-3, -1e-3], atol=1e-5)
    half = np.array([at.orientation.x, at.orientation.y, at.orientation.z]) * 2
    np.testing.assert_allclose(half, np.radians([-2.0, 0.0, 4.0]), atol=3e-3)
    covariance = message.pose.covariance.reshape(6, 6)
    np.testing.assert_allclose(covariance, covariance.T)
    assert (np.linalg.eigvalsh(covariance) > 0).all()
    assert 1e-6 < np.sqrt(covariance[0, 0]) < 1e-4
    fresh.reset_pose()
    at = decoded(made, fresh.pose(FRAME, contacts[2], STAMP_NS), kind).pose.pose.position
    assert (at.x, at.y, at.z) == (0, 0, 0), "this contact is the origin now"
    unsure = RosMessages("left", place_error=0.05)
    for again in range(2):  # the second time after a reset
        unsure.pose(FRAME, contacts[0], STAMP_NS)
        wider = decoded(made, unsure.pose(FRAME, contacts[2], STAMP_NS), kind).pose.covariance.reshape(6, 6)
        assert wider[0, 0] > covariance[0, 0] + (0.01 * 0.3e-3) ** 2, again
        unsure.reset_pose()


def test_the_covariance_is_moved_to_the_position():
    """A turn that is not sure shifts the position of an object that turns about a contact 10 mm away."""
    unsure = np.diag([0, 0, 0, 0, 0, 0.01**2])
    place, turn, covariance = optical_pose(np.eye(4), unsure, np.array([10.0, 0, 0]))
    np.testing.assert_allclose(np.sqrt(covariance[1, 1]), 10e-3 * 0.01)
    assert covariance[5, 5] == pytest.approx(1e-4)
    assert covariance[1, 5] < 0, (
        "x is 10 mm to the left of the contact: a turn from x to y moves it up, to smaller y"
    )
    np.testing.assert_allclose([*place, *turn], [0, 0, 0, 0, 0, 0, 1])


def test_without_the_extra_the_error_names_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "rosbags.typesys", None)
    with pytest.raises(
        DataError, match=r'message of ROS 2 needs the extra ros: pip install "gelform\[ros\]"'
    ):
        RosMessages("left")
    with pytest.raises(ValueError, match="name of ROS"):  # no installation mends it
        RosMessages("Left")


def test_every_level_comes_back_also_those_that_the_page_names():
    every = np.arange(1, 65536, dtype=np.uint16).reshape(1, -1)
    depth_mm = depth_from_lerobot_levels(every)
    assert depth_mm.dtype == np.float32
    np.testing.assert_array_equal(lerobot_levels_from_depth(depth_mm), every)
    assert depth_from_lerobot_levels(np.array([[1000.5]])) == pytest.approx(0.0005)
    depth_mm = np.array([[0.0, 0.001, -0.999, 1.0, 64.535]], np.float32)
    levels = lerobot_levels_from_depth(depth_mm)
    assert levels.dtype == np.uint16
    assert levels.tolist() == [[1000, 1001, 1, 2000, 65535]]
    np.testing.assert_array_equal(depth_from_lerobot_levels(levels), depth_mm)


@given(st.floats(-0.99, 64.5, allow_nan=False))
def test_any_depth_is_rounded_to_half_a_micrometer(depth_mm):
    back = depth_from_lerobot_levels(lerobot_levels_from_depth([[depth_mm]]))
    assert abs(float(back[0, 0]) - depth_mm) <= 0.0005 + 4e-6  # float32 at 64 mm


def test_out_of_range_or_no_number_is_an_error():
    for depth_mm in [-1.0, 64.536, -0.9996]:
        with pytest.raises(DataError, match=r"-0\.999 to 64\.535 mm"):
            lerobot_levels_from_depth(np.array([[0.0, depth_mm]]))
    with pytest.raises(ValueError, match="depth_mm"):
        lerobot_levels_from_depth(np.array([[np.nan]]))
    with pytest.raises((ValueError, TypeError)):
        depth_from_lerobot_levels(np.array([["a"]]))
