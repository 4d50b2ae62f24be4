"""Depth and force added to a data set that LeRobot wrote, as LeRobot reads it: from videos, and from images in tables."""

import json
from dataclasses import replace

import numpy as np
import pytest
from lerobot.datasets import LeRobotDataset
from lerobot_camera_gelform import lossless_rgb_encoder
from record import camera_of

import gelform
from gelform.batch import BatchSettings, run_batch, verify_output
from gelform.depth.force import ForceModel, ForcePart
from gelform.robots import depth_from_lerobot_levels

KEY, RATE_HZ, EPISODES = "observation.images.finger", 30, (7, 5)
DEPTH, FORCE, KNOWN = f"{KEY}_depth", "observation.force.finger", "observation.force.finger_known"
PRESSED_MM = 0.1


@pytest.fixture(scope="module")
def calibration():
    """With a normal force of 0.05 N/mm^3."""
    bare, normal = camera_of({}).calibration, ForcePart(((0.05,),), (0.001, 100.0), 0.2, 0.0, 9)
    force = ForceModel(normal, None, None, (), ("ball",), bare.digest, "2026-01-01T00:00:00Z")
    return replace(bare, force=force)


@pytest.fixture(scope="module")
def frames():
    """Of the simulated sensor while it is pressed."""
    camera, frames = camera_of({"warn_lossy_rgb": False}), []
    reconstruct = gelform.Reconstructor(camera.calibration)
    with camera:
        while len(frames) < sum(EPISODES):
            frame = camera.async_read(5000)
            if reconstruct.from_image(frame).depth_mm.max() > PRESSED_MM:
                frames.append(frame)
    return frames


@pytest.fixture(scope="module", params=["video", "image"])
def recorded(request, frames, tmp_path_factory):
    """What LeRobot writes of them; gives its folder."""
    root = tmp_path_factory.mktemp(request.param) / "set"
    feature = {"dtype": request.param, "shape": frames[0].shape, "names": ["height", "width", "channels"]}
    features = {KEY: feature, "action": {"dtype": "float32", "shape": (2,), "names": None}}
    encoder = {"rgb_encoder": lossless_rgb_encoder()} if request.param == "video" else {}
    use_videos = request.param == "video"
    data = LeRobotDataset.create(
        "tactile/press", RATE_HZ, features, root=root, use_videos=use_videos, **encoder
    )
    todo = iter(frames)
    for length in EPISODES:
        for k in range(length):
            action = np.array([k, 0.5], dtype=np.float32)
            data.add_frame({KEY: next(todo), "action": action, "task": f"press {length}"})
        data.save_episode()
    data.finalize()
    return root


@pytest.fixture(scope="module")
def added(recorded, calibration, tmp_path_factory):
    """The same with depth."""
    output = tmp_path_factory.mktemp("added") / "out"
    summary = run_batch(recorded, calibration, output, BatchSettings("lerobot"), dataset=KEY)
    assert (summary.complete, summary.frames, summary.errors) == (True, sum(EPISODES), 0)
    assert verify_output(output)[1:] == (0, [])
    return output / "frames"


def test_every_depth_comes_back_to_a_micrometer(added, frames, calibration):
    reconstruct, errors_um, deepest = gelform.Reconstructor(calibration), [], 0.0
    data = LeRobotDataset("tactile/press", root=added, return_uint8=True)
    assert len(data) == sum(EPISODES)
    assert data.meta.depth_keys == [DEPTH]
    for index, frame in enumerate(frames):
        item, truth = data[index], reconstruct.from_image(frame).depth_mm
        read = depth_from_lerobot_levels(item[DEPTH].numpy())
        assert item[DEPTH].shape == (1, *truth.shape)
        errors_um.append(1e3 * (read[0].astype(float) - truth))
        deepest = max(deepest, float(truth.max()))
    assert deepest > PRESSED_MM
    print(
        f"depth RMS {np.sqrt(np.mean(np.square(errors_um))):.3f} um, worst {np.abs(errors_um).max():.3f} um"
    )
    assert np.abs(errors_um).max() < 0.51


def test_the_rest_is_as_it_was(recorded, added):
    before, after = (
        LeRobotDataset("tactile/press", root=root, return_uint8=True) for root in (recorded, added)
    )
    assert after.meta.total_episodes == len(EPISODES)
    for index in (0, 6, 7, 11):
        old, new = before[index], after[index]
        assert old["task"] == new["task"]
        assert set(new) == {*old, DEPTH, FORCE, KNOWN}
        for key in (KEY, "action", "timestamp", "frame_index"):
            np.testing.assert_array_equal(old[key].numpy(), new[key].numpy())


def test_statistics_are_what_lerobot_itself_would_see(added):
    data = LeRobotDataset("tactile/press", root=added)
    levels = np.stack([data[k][DEPTH].numpy() for k in range(len(data))])
    stats = data.meta.stats[DEPTH]
    assert stats["mean"].shape == (1, 1, 1)
    assert stats["mean"].item() == pytest.approx(levels.mean(), rel=1e-6)
    assert stats["std"].item() == pytest.approx(levels.std(), rel=1e-6)
    assert (stats["min"].item(), stats["max"].item()) == (levels.min(), levels.max())
    assert stats["count"].item() == len(data)


def test_the_force_is_three_numbers(added, frames, calibration):
    data = LeRobotDataset("tactile/press", root=added)
    reconstruct = gelform.Reconstructor(calibration)
    true = np.array([reconstruct.from_image(frame).force.vector_n for frame in frames])
    found, known = (np.array([data[k][key].numpy() for k in range(len(data))]) for key in (FORCE, KNOWN))
    assert np.isfinite(true[:, 2]).any()
    np.testing.assert_allclose(found, np.nan_to_num(true), rtol=1e-5)
    np.testing.assert_array_equal(known, np.isfinite(true))
    stats = data.meta.stats[FORCE]
    np.testing.assert_allclose(stats["mean"], np.nan_to_num(true).mean(axis=0), rtol=1e-5)
    assert stats["count"].item() == len(data)


def test_windows_and_batches(added):
    """As a policy is trained: several times at once, by LeRobot's own loader."""
    from torch.utils.data import DataLoader

    data = LeRobotDataset("tactile/press", root=added, delta_timestamps={DEPTH: [-1 / RATE_HZ, 0.0]})
    batch = next(iter(DataLoader(data, batch_size=4)))
    assert batch[DEPTH].shape[:2] == (4, 2)
    single = LeRobotDataset("tactile/press", root=added)[2]
    np.testing.assert_array_equal(batch[DEPTH][3, 0].numpy(), single[DEPTH].numpy())


def test_lerobot_can_merge_it(added, tmp_path):
    from lerobot.datasets.aggregate import aggregate_datasets

    names = ["tactile/a", "tactile/b"]
    aggregate_datasets(names, "tactile/both", roots=[added, added], aggr_root=tmp_path / "both")
    both = LeRobotDataset("tactile/both", root=tmp_path / "both")
    first = LeRobotDataset("tactile/press", root=added)
    assert len(both) == 2 * len(first)
    for index in (0, len(first) - 1, len(first), 2 * len(first) - 1):
        for key in (DEPTH, FORCE, KNOWN):
            np.testing.assert_array_equal(both[index][key].numpy(), first[index % len(first)][key].numpy())
    info = json.loads((tmp_path / "both/meta/info.json").read_text())["features"][DEPTH]["info"]
    assert info["video.use_log"] is False
