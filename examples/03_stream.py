"""A simulated sensor as a stream: always the newest depth, however slow the loop, and the sensor's findings.

python examples/03_stream.py
"""

import tempfile
import time
from pathlib import Path

import numpy as np

import gelform
from gelform.simulate import LAYOUTS, simulate_ball_presses

# A calibration of the sensor, as a user makes one from presses of a ball.
sensor = LAYOUTS["three-edges"]
presses = simulate_ball_presses(
    sensor, ball_diameters_mm=[6.0], count=8, rng=np.random.default_rng(0), oversample=1
)
folder = gelform.save_simulated_presses(Path(tempfile.mkdtemp()) / "presses", presses)
calibration = gelform.calibrate(gelform.read_presses(folder), color_model="polynomial")

deepest, ages_s = 0.0, []
with gelform.stream("simulated", calibration) as stream:
    for result in stream:
        deepest = max(deepest, result.peak_mm)
        ages_s.append(time.monotonic() - result.time_s)
        time.sleep(0.2)  # a slow loop: frames are skipped, none is old
        if len(ages_s) == 12:
            break
    stats = stream.stats
    # A control loop asks for what is new enough, or learns that there is nothing.
    newest = stream.latest(max_age_s=1.0)

print(
    f"{stats.results} results at {stats.rate_hz:.0f} a second, {stats.latency_ms:.0f} ms after their capture"
)
print(f"seen 5 times a second: {1e3 * np.median(ages_s):.0f} ms old; deepest {deepest:.2f} mm")
print(f"wrong with the sensor: {[finding.name for finding in newest.health] or 'nothing'}")

assert stats.results > len(ages_s), "capture goes on while the loop sleeps"
assert 0.3 < deepest < 0.9, "the simulated ball goes 0.55 mm deep"
assert newest.index > 0
