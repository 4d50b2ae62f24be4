"""A whole frame, from image to depth and its sigma, gives the same bits on every instruction set and kernel of OpenBLAS."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from kernel_agreement import usable_isas
from kernels_of_blas import environment, usable_kernels

PROGRAM = """
import hashlib, sys
import numpy as np
import gelform

image = np.load(sys.argv[2])
result = gelform.Reconstructor(gelform.load_calibration(sys.argv[1]))(image)
for name in ("depth_mm", "depth_sigma_mm", "gradients", "confidence", "contact", "known"):
    print(name, hashlib.sha256(np.ascontiguousarray(getattr(result, name)).tobytes()).hexdigest())
for solver in ("auto", "dct", "multigrid", "curl_gated"):
    depth = gelform.depth_from_gradients(result.gradients, mm_per_px=result.mm_per_px, solver=solver)
    print(solver, hashlib.sha256(depth.tobytes()).hexdigest())
"""

FITTED = """
import sys
import numpy as np
import gelform
from made.rigid_contacts import contact_of, pose, texture

moved = gelform.motion_between(contact_of(texture(), seed=1), contact_of(texture(), pose(0.3, yaw=3), seed=2))
result = gelform.Reconstructor(gelform.calibrate(gelform.read_presses(sys.argv[1])))(np.load(sys.argv[2]))
maps = {name: getattr(result, name) for name in ("depth_mm", "depth_sigma_mm", "gradients")}
np.savez(sys.argv[3], pose=moved.pose, covariance=1e3 * moved.covariance, **maps)
"""
# As in docs/guarantees.md: what is fitted moves with LAPACK's rounding, which decides which pixels a robust fit trusts.
MOST = {"depth_mm": 1e-3, "depth_sigma_mm": 1e-3, "gradients": 2e-3, "pose": 1e-9, "covariance": 1e-9}


@pytest.fixture(scope="module")
def files(calibration, simulated, tmp_path_factory):
    folder = tmp_path_factory.mktemp("frame")
    calibration.save(folder / "calibration.npz")
    np.save(folder / "image.npy", simulated.presses[0].image)
    return [str(folder / name) for name in ("calibration.npz", "image.npy")]


def digests(files, variables):
    command = [sys.executable, "-c", PROGRAM, *files]
    return subprocess.run(command, env=variables, capture_output=True, text=True, check=True).stdout


@pytest.mark.slow
def test_a_frame_is_the_same_on_every_instruction_set(files):
    found = {isa: digests(files, {**os.environ, "GELFORM_ISA": isa}) for isa in usable_isas()}
    assert "depth_sigma_mm" in found["base"]
    assert set(found.values()) == {found["base"]}


@pytest.mark.slow
def test_a_frame_is_the_same_on_every_kernel_of_openblas(files):
    """No step of it rests on LAPACK, whose rounding differs; with one and with two threads."""
    cases = [(kernel, 1 + k % 2) for k, kernel in enumerate(["", *usable_kernels()])]
    found = {case: digests(files, environment(*case)) for case in cases}
    assert "multigrid" in found[cases[0]]
    assert set(found.values()) == {found[cases[0]]}


@pytest.mark.slow
def test_what_is_fitted_moves_little_between_kernels(folder, press, tmp_path):
    np.save(tmp_path / "image.npy", press.image)
    found = []
    for kernel in {usable_kernels()[0], usable_kernels()[-1]}:
        path = tmp_path / f"fitted-{kernel}.npz"
        command = [sys.executable, "-c", FITTED, str(folder), str(tmp_path / "image.npy"), str(path)]
        paths = os.pathsep.join([str(Path(__file__).parents[1]), os.environ.get("PYTHONPATH", "")])
        subprocess.run(command, env={**environment(kernel, 1), "PYTHONPATH": paths}, check=True)
        found.append(np.load(path))
    for name, most in MOST.items():
        np.testing.assert_allclose(found[0][name], found[-1][name], rtol=0, atol=most, err_msg=name)
