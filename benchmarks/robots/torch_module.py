"""The PyTorch module compared with the numpy path, and a batch with single calls."""

from __future__ import annotations

from typing import Any

import numpy as np

from report import median_ms
from robots.bag import frames_and_results, reconstructor

BATCH = 64


def measure(quick: bool) -> dict[str, Any]:
    """Difference of depth as a fraction of its peak; ms of a batch and of as many single calls, alternating."""
    import torch

    import gelform
    from gelform.torch import Reconstruct

    torch.set_num_threads(1)
    calibration = reconstructor().calibration
    images = [frame.image for frame, _ in frames_and_results(gelform.Reconstructor(calibration))]
    run = gelform.Reconstructor(calibration, solver="dct", depth_sigma=False)
    module = Reconstruct(calibration).eval()
    expected = np.stack([run.from_image(image).depth_mm for image in images])
    count = 16 if quick else BATCH
    batch = torch.from_numpy(np.stack([images[k % len(images)] for k in range(count)])).permute(0, 3, 1, 2)
    batch = batch.contiguous()
    with torch.no_grad():
        found = module(batch[: len(images)]).depth_mm[:, 0].numpy()
        together, alone = median_ms(
            [lambda: module(batch), lambda: [module(batch[k : k + 1]) for k in range(count)]],
            rounds=5,
            seconds=60,
        )
    return {
        "torch": torch.__version__,
        "threads": 1,
        "batch": count,
        "difference_of_peak": float(np.abs(found - expected).max() / np.abs(expected).max()),
        "batch_ms": together,
        "calls_ms": alone,
        "calls_over_batch": alone / together,
    }


def rows(figures: dict[str, Any]) -> list[tuple[str, Any, Any]]:
    """(figure, required, measured)."""
    count = figures["batch"]
    return [
        ("torch against numpy: difference of depth, of the peak", 1e-4, figures["difference_of_peak"]),
        (f"torch: {count} calls over a batch of {count}, one thread", 1.0, figures["calls_over_batch"]),
        ("torch: ms a frame in the batch", "-", figures["batch_ms"] / count),
    ]
