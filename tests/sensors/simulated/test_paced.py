"""What every simulated source shares: the pace, a frame's own noise, the end."""

import numpy as np
import pytest

from gelform.sensors.simulated.paced import PacedSimulation


class Grey(PacedSimulation):
    def levels_at(self, index):
        return np.full((*self.sensor.shape, 3), 90.0, np.float16)


def test_frames_come_in_order_at_their_times(sensor):
    with Grey(sensor, rate_hz=200.0) as source:
        frames = [frame for frame, _ in zip(source, range(4))]
    times = np.diff([frame.time_s for frame in frames])
    steps = np.diff([frame.index for frame in frames])
    np.testing.assert_allclose(times, steps / 200)
    assert (steps >= 1).all()


def test_noise_is_of_the_frame_and_the_seed(sensor):
    one, other = Grey(sensor, rate_hz=30.0, seed=1), Grey(sensor, rate_hz=30.0, seed=2)
    np.testing.assert_array_equal(one.image_at(5), one.image_at(5))
    assert (one.image_at(5) != one.image_at(6)).mean() > 0.2
    assert (one.image_at(5) != other.image_at(5)).mean() > 0.2


def test_facts_and_end(sensor):
    source = Grey(sensor, rate_hz=30.0)
    assert (source.name, source.serial, source.rate_hz) == (f"simulated {sensor.name}", None, 30.0)
    assert source.settings == {"width": 176, "height": 132, "fps": 30.0}
    source.close()
    assert list(source) == []
    with pytest.raises(ValueError, match="rate_hz"):
        Grey(sensor, rate_hz=0.0)
