"""One file: it plays elsewhere as it was shown here, calibration and background included."""

import numpy as np
import pytest

import gelform
from gelform.errors import DataError
from gelform.live.replay.indexed import indexed
from gelform.live.replay.share import share
from gelform.sensors.recordings import attached_background, attached_calibration


@pytest.mark.parametrize("form", ["mcap", "recorded", "images", "video"])
def test_the_file_holds_frames_times_and_calibration(form, forms, frames, calibration, tmp_path):
    recording = indexed(forms[form])
    background = np.rint(calibration.background)
    path = share(recording, tmp_path / "one.mcap", calibration=calibration, background=background)
    again = indexed(path)
    np.testing.assert_allclose(again.times_s, recording.times_s, atol=1e-6)
    np.testing.assert_array_equal(again.frame(4).image, frames[4].image)
    assert attached_calibration(path).digest == calibration.digest
    np.testing.assert_array_equal(attached_background(path), background)
    here = gelform.Reconstructor(calibration, background=background)(recording.frame(4))
    there = gelform.Reconstructor(attached_calibration(path), background=attached_background(path))
    np.testing.assert_array_equal(there(again.frame(4)).depth_mm, here.depth_mm)


def test_progress_is_told_and_nothing_is_left_of_a_share_that_failed(forms, tmp_path):
    said = []
    recording = indexed(forms["recorded"])
    share(recording, tmp_path / "a.mcap", calibration=None, progress=lambda *what: said.append(what[:2]))
    assert said[-1] == (6, 7)
    with pytest.raises(DataError, match="already there"):
        share(recording, tmp_path / "a.mcap", calibration=None)
    assert attached_calibration(tmp_path / "a.mcap") is None

    def stop(done, *_):
        if done == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        share(recording, tmp_path / "b.mcap", calibration=None, progress=stop)
    assert [path.name for path in tmp_path.glob("*.mcap*")] == ["a.mcap"]
    assert not list(tmp_path.glob(".*"))
