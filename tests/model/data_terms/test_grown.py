"""The weight of the data that grows towards the coarse scales, against one energy in pixels of the frames."""

from __future__ import annotations

import numpy as np
import pytest

from fracbench.methods.registry import get_method
from fracbench.model.coarse_to_fine import coarse_to_fine
from fracbench.model.data_terms.brightness import Brightness
from fracbench.model.data_terms.choose import residual_factory
from fracbench.model.energy import attachment, regularity
from fracbench.model.operators.reflect import ReflectGradient
from fracbench.model.params import FlowParams
from fracbench.model.v_steps import ChannelStep, MultiplierStep, PenaltyStep
from fracbench.model.warping import Linearization


def smooth_image(shape, side):
    """A smooth image of the unit square, sampled at the centres of pixels; its flow is `smooth_flow`."""
    y, x = (np.arange(n) + 0.5 for n in shape)
    return 100.0 * np.add.outer(np.cos(2 * np.pi * y / side), np.cos(3 * np.pi * x / side))


@pytest.mark.parametrize("alpha", [1.0, 2.0, 3.0])
def test_with_a_growth_of_alpha_minus_1_two_scales_have_one_energy(alpha):
    """The sampled energies of both scales tend to integrals: their ratio of data to regularity must agree."""
    ratios = []
    for side, step in ((256, 1), (128, 2)):
        frame0 = smooth_image((side, side), side)
        frame1 = smooth_image((side, side), side) + 5.0
        params = FlowParams(lambda_growth=alpha - 1.0, dtype="float64")
        full = np.zeros((256, 256))
        data = residual_factory(full, full, params)(frame0, frame1, params)
        flow = 3.0 / step * smooth_image((side, side), side) / 100.0
        operator = ReflectGradient(alpha, (side, side), np.float64)
        linear = data.at(np.zeros((2, side, side)))
        rows = slice(8 // step, -8 // step)  # the stencils of the border leave the image
        inner = Linearization(linear.rho_c[rows, rows], linear.gradient[:, rows, rows])
        data_energy = attachment(np.stack([flow, flow])[:, rows, rows], inner, params.lambda_)
        ratios.append(data_energy / regularity(operator, flow))
    assert ratios[0] == pytest.approx(ratios[1], rel=0.03)


@pytest.mark.parametrize("step", [PenaltyStep, MultiplierStep, ChannelStep])
def test_a_weight_of_the_residual_is_one_of_lambda(step):
    """The v-steps solve with |w rho| as they do with w lambda: they need not know the weight."""
    rng = np.random.default_rng(3)
    shape, w = (6, 7), 2.5
    k = (3,) if step is ChannelStep else ()
    rho, gradient = rng.normal(0, 5, (*k, *shape)), rng.normal(0, 8, (*k, 2, *shape))
    u = rng.normal(0, 1, (2, *shape))
    params = FlowParams(dtype="float64", lambda_gradient=0.2)
    more = params.replace({"lambda": params.lambda_ * w, "lambda_gradient": 0.2 * w})
    plain, weighted = step(u, more), step(u, params)
    for _ in range(3):
        expected = plain.target(u, Linearization(rho, gradient)).copy()
        np.testing.assert_allclose(weighted.target(u, Linearization(w * rho, w * gradient)), expected, atol=1e-9)


@pytest.mark.parametrize("growth", [0.0, 1.0, 2.5])
def test_each_scale_has_its_weight(growth):
    """Frames of 48 x 64 at half and a quarter of their size: weights of 2^g and 4^g, and none on the finest."""
    rng = np.random.default_rng(0)
    frame = rng.uniform(0, 255, (48, 64))
    params = FlowParams(lambda_growth=growth, dtype="float64")
    make = residual_factory(frame, frame, params)
    for shape, r in (((48, 64), 1.0), ((24, 32), 2.0), ((12, 16), 4.0)):
        pair, u = rng.uniform(0, 255, (2, *shape)), rng.normal(0, 0.5, (2, *shape))
        got, plain = make(*pair, params).at(u), Brightness(*pair, params).at(u)
        np.testing.assert_allclose(got.rho_c, r**growth * plain.rho_c, rtol=1e-12)
        np.testing.assert_allclose(got.gradient, r**growth * plain.gradient, rtol=1e-12)


def test_a_scale_alone_does_not_know_growth():
    frames = np.random.default_rng(1).uniform(0, 255, (2, 20, 24))
    method = get_method("tvl1_sb_alpha_map")
    flows = [
        method.estimate(*frames, FlowParams(n_scales=1, lambda_growth=growth, max_iter=3)).flow
        for growth in (0.0, 2.0)
    ]
    np.testing.assert_array_equal(*flows)


def test_the_papers_driver_has_no_growth():
    assert coarse_to_fine.__kwdefaults__["prepare_data"](None, None, None) is Brightness
