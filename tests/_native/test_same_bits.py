"""A whole frame, from image to depth and its sigma, gives the same bits on every instruction set."""

from __future__ import annotations

import os
import subprocess
import sys

import numpy as np
import pytest

from kernel_agreement import usable_isas

PROGRAM = """
import hashlib, sys
import numpy as np
import gelform

image = np.load(sys.argv[2])
result = gelform.Reconstructor(gelform.load_calibration(sys.argv[1]))(image)
for name in ("depth_mm", "depth_sigma_mm", "gradients", "confidence", "contact", "known"):
    print(name, hashlib.sha256(np.ascontiguousarray(getattr(result, name)).tobytes()).hexdigest())
"""


@pytest.mark.slow
def test_a_frame_is_the_same_on_every_instruction_set(calibration, simulated, tmp_path):
    calibration.save(tmp_path / "calibration.npz")
    np.save(tmp_path / "image.npy", simulated.presses[0].image)
    files = [str(tmp_path / name) for name in ("calibration.npz", "image.npy")]
    digests = {}
    for isa in usable_isas():
        done = subprocess.run(
            [sys.executable, "-c", PROGRAM, *files],
            env={**os.environ, "GELFORM_ISA": isa},
            capture_output=True,
            text=True,
            check=True,
        )
        digests[isa] = done.stdout
    assert "depth_sigma_mm" in digests["base"]
    assert all(digest == digests["base"] for digest in digests.values())
