"""The camera as LeRobot finds, parses, makes and reads it; what cannot be."""

import logging
import time
from dataclasses import replace
from importlib.metadata import distributions
from itertools import pairwise

import numpy as np
import pytest
from lerobot.cameras import Camera
from lerobot.configs.video import RGBEncoderConfig
from lerobot.utils.errors import DeviceAlreadyConnectedError, DeviceNotConnectedError
from lerobot_camera_gelform import GelformCamera, GelformCameraConfig, is_lossless, lossless_rgb_encoder
from record import camera_of

import gelform
from gelform.depth.force import ForceModel, ForcePart
from gelform.robots import depth_from_lerobot_levels


@pytest.fixture(scope="module")
def connected():
    camera = camera_of({})
    camera.connect()
    yield camera
    camera.disconnect()


def test_the_distribution_has_the_name_that_lerobot_looks_for():
    assert "lerobot_camera_gelform" in {one.metadata["Name"] for one in distributions()}


def test_lerobots_own_factory_makes_it(connected):
    assert isinstance(connected, GelformCamera)
    assert isinstance(connected, Camera)
    assert (connected.height, connected.width) == connected.calibration.image_shape
    assert (connected.use_rgb, connected.use_depth, connected.config.type) == (True, True, "gelform")
    assert {"type": "gelform", "id": "simulated"}.items() <= connected.find_cameras()[-1].items()


def test_shapes_and_types(connected):
    size = (connected.height, connected.width)
    for color in (connected.read(), connected.async_read(2000), connected.read_latest(2000)):
        assert (color.shape, color.dtype) == ((*size, 3), np.uint8)
    for depth in (
        connected.read_depth(),
        connected.async_read_depth(2000),
        connected.read_latest_depth(2000),
    ):
        assert (depth.shape, depth.dtype) == ((*size, 1), np.uint16)


def test_the_force_needs_loads(connected, tmp_path):
    with pytest.raises(RuntimeError, match="gelform force calibrate"):
        connected.read_latest_force(2000)
    bare, normal = connected.calibration, ForcePart(((0.05,),), (0.001, 100.0), 0.2, 0.0, 9)
    force = ForceModel(normal, None, None, (), ("ball",), bare.digest, "2026-01-01T00:00:00Z")
    replace(bare, force=force).save(tmp_path / "cal.npz")
    with camera_of({"calibration": str(tmp_path / "cal.npz")}) as camera:
        seen = [camera.read_latest_force(2000) for _ in range(60) if camera.read_depth() is not None]
    assert {(one.shape, one.dtype) for one in seen} == {((3,), np.dtype(np.float32))}
    assert np.nanmin(np.array(seen)[:, 2]) < 0  # it pushes toward the camera


def test_depth_is_that_of_the_result_in_whole_micrometers(connected):
    for _ in range(5):
        levels = connected.read_latest_depth(2000)
        seen = connected._stream.newest(-1, 0.0)
        if seen.index == connected._consumed["depth"]:
            break
    wrong_mm = depth_from_lerobot_levels(levels)[..., 0] - seen.result.depth_mm
    assert np.abs(wrong_mm).max() <= 0.51e-3


def test_async_reads_never_give_a_frame_twice_and_wait_for_the_next(connected):
    indices = []
    for _ in range(6):
        connected.async_read(2000)
        indices.append(connected._consumed["color"])
        connected.async_read_depth(2000)
    assert all(later > earlier for earlier, later in pairwise(indices))


def test_too_late_and_too_old_are_timeouts_that_say_how_the_sensor_is(connected):
    connected.async_read(2000)
    with pytest.raises(TimeoutError, match=r"within 0 ms, none came\. The sensor is running"):
        connected.async_read(0)
    with pytest.raises(TimeoutError, match="at most 0 ms old"):
        connected.read_latest(0)


def test_a_camera_is_connected_once_and_can_be_again():
    camera = camera_of({})
    with pytest.raises(DeviceNotConnectedError):
        camera.read()
    with pytest.raises(DeviceNotConnectedError):
        camera.disconnect()
    for _ in range(2):
        camera.connect()
        with pytest.raises(DeviceAlreadyConnectedError):
            camera.connect()
        camera.disconnect()
        assert not camera.is_connected


def test_a_sensor_that_is_not_there_is_a_sentence(tmp_path):
    camera_of({}).calibration.save(tmp_path / "cal.npz")
    camera = camera_of({"source": "2BKR0000", "calibration": str(tmp_path / "cal.npz")})
    with pytest.raises(ConnectionError, match=r"GelformCamera\(2BKR0000\): "):
        camera.connect()
    assert not camera.is_connected


def test_a_recording_that_ends_says_so(tmp_path):
    import cv2

    camera_of({}).calibration.save(tmp_path / "cal.npz")
    background = np.rint(camera_of({}).calibration.background).astype(np.uint8)
    (tmp_path / "frames").mkdir()
    for k in range(3):
        cv2.imwrite(str(tmp_path / "frames" / f"{k}.png"), background[..., ::-1])
    camera = camera_of({"source": str(tmp_path / "frames"), "calibration": str(tmp_path / "cal.npz")})
    with camera:
        time.sleep(0.5)
        camera.async_read(0)
        with pytest.raises(TimeoutError, match="The sensor is ended"):
            camera.async_read(100)


def test_wrong_settings_are_sentences():
    with pytest.raises(ValueError, match="Switch one on"):
        GelformCameraConfig(use_rgb=False, use_depth=False)
    with pytest.raises(ValueError, match="calibration of source 'S1', got none"):
        GelformCameraConfig(source="S1")
    with pytest.raises(ValueError, match=r"Expected height \d+ and width \d+"):
        camera_of({"width": 7})
    with pytest.raises((gelform.GelformError, ValueError), match=r"missing\.npz"):
        camera_of({"source": "S1", "calibration": "missing.npz"})
    only_depth = camera_of({"use_rgb": False})
    with only_depth, pytest.raises(RuntimeError, match="use_rgb=True"):
        only_depth.read()


def test_a_lossy_encoder_is_warned_of_and_a_lossless_one_is_not(caplog):
    assert is_lossless(lossless_rgb_encoder())
    assert not is_lossless(RGBEncoderConfig())
    assert not is_lossless(RGBEncoderConfig(vcodec="h264", pix_fmt="yuv444p", crf=10))
    with caplog.at_level(logging.WARNING), camera_of({}):
        pass
    assert "lossy" in caplog.text
    caplog.clear()
    with caplog.at_level(logging.WARNING), camera_of({"warn_lossy_rgb": False}):
        pass
    with caplog.at_level(logging.WARNING), camera_of({"use_rgb": False}):
        pass
    assert "lossy" not in caplog.text


def test_connecting_without_warmup_returns_at_once_and_has_nothing_yet():
    camera = camera_of({})
    camera.connect(warmup=False)
    started = time.monotonic()
    while time.monotonic() - started < 20:
        try:
            camera.read_latest(2000)
            break
        except RuntimeError as problem:
            assert "has given nothing yet" in str(problem)  # noqa: PT017
            time.sleep(0.01)
    camera.disconnect()
