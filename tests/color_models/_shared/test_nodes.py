"""Coefficients at nodes: fits on the same samples share what they can, and nothing else."""

from __future__ import annotations

import gc
from dataclasses import replace

import numpy as np

from gelform.color_models._shared import nodes
from gelform.color_models._shared.nodes import fitted_nodes, light_at_nodes
from made.color_samples import ball_samples, lambertian_change


def test_the_light_is_smoothed_alike_in_both_directions():
    background = np.random.default_rng(0).uniform(20, 200, (65, 65, 3)).astype(np.float32)
    turned = light_at_nodes(background.transpose(1, 0, 2))
    np.testing.assert_allclose(turned, light_at_nodes(background).transpose(0, 2, 1), atol=1e-4)


def anew(samples):
    """The same in arrays of their own, of which nothing is remembered."""
    parts = ("color_change", "x_px", "y_px", "gradients", "weight")
    return replace(samples, **{part: getattr(samples, part).copy() for part in parts})


def test_fits_one_after_the_other_are_those_of_each_alone():
    samples = ball_samples(lambertian_change)
    turned = replace(samples, gradients=-samples.gradients)
    lighter = replace(samples, weight=samples.weight * np.linspace(0.1, 1, len(samples.weight)))
    moved = replace(samples, x_px=samples.x_px[::-1].copy())
    for one in (samples, turned, samples, lighter, moved, samples):
        for degrees, ridge in (((2, 1), 1e-3), ((2, 1), 1e-5), ((1,), 1e-3)):
            found, _ = fitted_nodes(one, degrees, ridge)
            alone, _ = fitted_nodes(anew(one), degrees, ridge)
            np.testing.assert_array_equal(found, alone)


def test_columns_are_worked_out_once_and_go_with_their_samples():
    samples = anew(ball_samples(lambertian_change))
    fitted_nodes(samples, (2, 1), 1e-3)
    columns = nodes._kept["last"][-1].columns
    fitted_nodes(samples, (2, 1), 1e-4)
    assert nodes._kept["last"][-1].columns is columns
    del samples
    gc.collect()
    assert not nodes._kept
