"""A data set: every frame of a folder tree to depth, in one call that can be interrupted and repeated.

`gelform batch sessions/ -c cal.npz -o depth` does the same; docs/batch.md explains many processes and machines.
"""

import csv
import tempfile
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

import gelform
from gelform.batch import BatchSettings, run_batch, verify_output
from gelform.simulate import LAYOUTS, Ball, press_poses, simulate_ball_presses, simulate_sequence

# 1. A calibrated sensor, and two recording sessions of 6 frames each, as image folders.
place = Path(tempfile.mkdtemp())
rng = np.random.default_rng(0)
sensor = replace(LAYOUTS["three-edges"], shape=(120, 160), mm_per_px=0.127)
presses = simulate_ball_presses(sensor, ball_diameters_mm=[6.0], count=10, rng=rng, oversample=1)
folder = gelform.save_simulated_presses(place / "presses", presses)
gelform.calibrate(gelform.read_presses(folder), color_model="polynomial").save(place / "cal.npz")
deepest_mm = {}
for session, radius_mm in (("monday", 3.0), ("tuesday", 5.0)):
    (place / "sessions" / session).mkdir(parents=True)
    for k, press in enumerate(simulate_sequence(sensor, Ball(radius_mm), press_poses(0.5, 6), rng=rng)):
        cv2.imwrite(str(place / "sessions" / session / f"frame{k}.png"), press.image[..., ::-1])  # BGR
        deepest_mm[session, k] = float(press.depth_mm.max())
(place / "sessions/tuesday/frame9.png").write_bytes(b"torn")  # disks fill up; one frame is no picture

# 2. The first call does all of it. A torn frame is a row with its reason, and the others are done.
settings = BatchSettings(form="png")  # depth in 16 bits
summary = run_batch(place / "sessions", place / "cal.npz", place / "depth", settings, table="csv")
print(f"{summary.frames} frames, {summary.errors} with an error")

# 3. The same call again finds that everything is there. Killed half-way, it would do what is missing.
again = run_batch(place / "sessions", place / "cal.npz", place / "depth", settings, table="csv")
print(f"again: {again.frames} frames to do, {again.frames_before} were there")
assert again.frames == 0
checked, known_errors, problems = verify_output(place / "depth")  # reads every byte again
assert (checked, known_errors, list(problems)) == (12, 1, [])

# 4. One row per frame: what a learner filters by.
with open(place / "depth/frames.csv", newline="") as table:
    rows = list(csv.DictReader(table))
for row in rows:
    found = f"{float(row['deepest_mm']):.3f} mm" if not row["error"] else row["error"]
    print(row["sequence"], row["frame"], found)
assert sum(bool(row["error"]) for row in rows) == summary.errors == 1
good = [row for row in rows if not row["error"] and deepest_mm[row["sequence"], int(row["index"])] > 0.2]
assert len(good) == 6
assert all(abs(float(r["deepest_mm"]) - deepest_mm[r["sequence"], int(r["index"])]) < 0.05 for r in good)
