from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from fracbench.data.datasets.particles.flows import FLOWS, make_flow

SHAPE = (64, 80)
CENTRE = (39.5, 31.5)
RNG = np.random.default_rng(3)


def pixels(shape=SHAPE) -> tuple[np.ndarray, np.ndarray]:
    y, x = np.mgrid[: shape[0], : shape[1]].astype(float)
    return x, y


def displacement(name: str, **settings) -> np.ndarray:
    x, y = pixels()
    x1, y1 = make_flow(name, SHAPE, **settings).trace(x, y)
    return np.stack((x1 - x, y1 - y))


def turned(angle: np.ndarray) -> np.ndarray:
    """The displacement of every pixel that turns about the centre, clockwise in the image."""
    x, y = pixels()
    z = (x - CENTRE[0]) + 1j * (y - CENTRE[1])
    moved = z * np.exp(1j * angle) - z
    return np.stack((moved.real, moved.imag))


@pytest.mark.parametrize("fastest", [0.5, 5.0, 12.0])
class TestClosedForms:
    def test_rankine_turns_as_a_solid_in_its_core_and_as_1_over_r_outside(self, fastest):
        x, y = pixels()
        r, core = np.hypot(x - CENTRE[0], y - CENTRE[1]), 8.0
        speed = np.where(r < core, r / core, core / r)
        expected = turned(fastest * speed / speed.max() / r)
        np.testing.assert_allclose(displacement("rankine", displacement=fastest), expected, atol=2e-6)

    def test_lamb_oseen(self, fastest):
        x, y = pixels()
        r, core = np.hypot(x - CENTRE[0], y - CENTRE[1]), 8.0
        speed = (1.0 - np.exp(-((r / core) ** 2))) / r
        expected = turned(fastest * speed / speed.max() / r)
        np.testing.assert_allclose(displacement("lamb_oseen", displacement=fastest), expected, atol=2e-6)

    def test_shear_layers_and_jet_flow_to_the_right(self, fastest):
        s = np.broadcast_to((np.arange(64.0)[:, None] - CENTRE[1]) / 64.0, SHAPE)
        for name, profile in (("shear", s), ("mixing_layer", np.tanh(s / 0.08)), ("jet", np.cosh(s / 0.1) ** -2)):
            u, v = displacement(name, displacement=fastest)
            np.testing.assert_allclose(u, fastest * profile / np.abs(profile).max(), atol=1e-9)
            assert not v.any()

    def test_stagnation_stretches_along_x_and_shrinks_along_y(self, fastest):
        x, y = pixels()
        rate = fastest / np.hypot(*CENTRE)
        u, v = displacement("stagnation", displacement=fastest)
        np.testing.assert_allclose(u, (x - CENTRE[0]) * np.expm1(rate), atol=2e-6)
        np.testing.assert_allclose(v, (y - CENTRE[1]) * np.expm1(-rate), atol=2e-6)


def test_taylor_green_has_two_periods_on_the_shorter_side():
    flow = make_flow("taylor_green", (64, 64), displacement=2.0)
    x, y = RNG.uniform(0, 64, (2, 50))
    k = 2 * np.pi / 32
    u, v = flow.velocity(x, y)
    np.testing.assert_allclose((u, v), (2 * np.sin(k * x) * np.cos(k * y), -2 * np.cos(k * x) * np.sin(k * y)))


@pytest.mark.parametrize("name", FLOWS)
class TestEveryFlow:
    def test_the_fastest_pixel_has_the_speed_that_is_asked_for(self, name):
        flow = make_flow(name, SHAPE, displacement=4.0)
        x, y = pixels()
        inside = flow.inside(x, y)
        assert np.hypot(*flow.velocity(x, y))[inside].max() == pytest.approx(4.0)
        x1, y1 = flow.trace(x, y)
        assert np.hypot(x1 - x, y1 - y)[inside].max() == pytest.approx(4.0, rel=0.1)

    def test_no_divergence(self, name):
        """Central differences of the velocity at random points, against its gradient."""
        flow, h = make_flow(name, SHAPE, displacement=5.0), 1e-4
        x, y = RNG.uniform(1, 79, 300), RNG.uniform(1, 63, 300)
        inside = flow.inside(x, y)
        du = (flow.velocity(x + h, y)[0] - flow.velocity(x - h, y)[0]) / (2 * h)
        dv = (flow.velocity(x, y + h)[1] - flow.velocity(x, y - h)[1]) / (2 * h)
        du_dy = (flow.velocity(x, y + h)[0] - flow.velocity(x, y - h)[0]) / (2 * h)
        away = inside & (np.abs(np.hypot(x - CENTRE[0], y - CENTRE[1]) - 8.0) > 0.1)  # Rankine's kink
        assert np.abs(du + dv)[away].max() < 1e-6
        assert max(np.abs(du)[away].max(), np.abs(du_dy)[away].max()) > 0.01

    def test_trajectories_equal_those_of_another_solver(self, name):
        flow = make_flow(name, SHAPE, displacement=12.0)
        x, y = RNG.uniform(4, 75, 12), RNG.uniform(4, 59, 12)
        inside = flow.inside(x, y)
        x, y = x[inside], y[inside]
        got = flow.trace(x, y)
        for i in range(len(x)):
            one = solve_ivp(
                lambda _, p: np.array(flow.velocity(p[:1], p[1:])).ravel(),
                (0, 1),
                (x[i], y[i]),
                "RK45",
                rtol=1e-11,
                atol=1e-11,
                max_step=0.05,
            )
            np.testing.assert_allclose((got[0][i], got[1][i]), one.y[:, -1], atol=1e-5)

    def test_a_trajectory_is_no_step_of_euler(self, name):
        flow = make_flow(name, SHAPE, displacement=8.0)
        x, y = pixels()
        straight = np.array(flow.velocity(x, y))
        bent = np.hypot(*(displacement(name, displacement=8.0) - straight))[flow.inside(x, y)].max()
        assert (bent > 0.1) == (name not in ("shear", "mixing_layer", "jet"))


@pytest.mark.parametrize("slope", [5 / 3, 3.0])
def test_the_spectrum_of_the_random_field_has_the_slope_that_is_asked_for(slope):
    """The energy of windowed transforms in rings of wave numbers, in the mean of seeds, falls as k^-slope."""
    n, rings = 64, np.arange(2, 7)
    x, y = pixels((n, n))
    window = np.outer(np.hanning(n), np.hanning(n))
    k = np.hypot(*np.meshgrid(np.fft.fftfreq(n, 1 / n), np.fft.fftfreq(n, 1 / n)))
    energy = np.zeros(len(rings))
    for seed in range(40):
        velocity = make_flow("solenoidal", (n, n), displacement=1.0, slope=slope, seed=seed).velocity(x, y)
        power = sum(np.abs(np.fft.fft2(window * part)) ** 2 for part in velocity)
        energy += [power[np.rint(k) == ring].sum() for ring in rings]
    assert np.polyfit(np.log(rings), np.log(energy), 1)[0] == pytest.approx(-slope, abs=0.35)


def test_seeds_give_different_random_fields():
    fields = [displacement("solenoidal", displacement=3.0, seed=seed) for seed in (0, 0, 1)]
    np.testing.assert_array_equal(fields[0], fields[1])
    assert np.abs(fields[0] - fields[2]).max() > 1.0


class TestBackstep:
    flow = make_flow("backstep", (128, 128), displacement=6.0)

    def test_the_floor_falls_and_the_flow_stands_still_at_floor_and_ceiling(self):
        x, y = pixels((128, 128))
        heights = self.flow.inside(x, y).sum(axis=0)
        assert heights[0] < 0.7 * 128 < 0.9 * 128 < heights[-1] < 128 and (np.diff(heights) >= 0).all()
        ceiling = self.flow.velocity(np.arange(128.0), np.full(128, -0.5))
        np.testing.assert_allclose(ceiling, 0.0, atol=1e-12)
        along = np.arange(128.0)
        low, high = np.zeros(128), np.full(128, 200.0)
        for _ in range(60):
            middle = 0.5 * (low + high)
            fluid = self.flow.inside(along, middle)
            low, high = np.where(fluid, middle, low), np.where(fluid, high, middle)
        np.testing.assert_allclose(self.flow.velocity(along, low), 0.0, atol=1e-9)

    def test_all_that_flows_in_flows_out(self):
        y = np.linspace(-0.5, 127.5, 4001)
        flux = []
        for at in (0.0, 40.0, 60.0, 127.0):
            x = np.full(y.shape, at)
            flux.append(np.trapezoid(np.where(self.flow.inside(x, y), self.flow.velocity(x, y)[0], 0.0), y))
        np.testing.assert_allclose(flux, flux[0], rtol=1e-3)

    def test_the_flow_runs_back_behind_the_step_alone(self):
        x, y = pixels((128, 128))
        back = (self.flow.velocity(x, y)[0] < -0.1) & self.flow.inside(x, y)
        rows, cols = np.nonzero(back)
        assert len(rows) > 100 and cols.min() > 0.25 * 128 and cols.max() < 0.75 * 128 and rows.min() > 64

    def test_what_is_in_a_wall_stays_and_the_fluid_stays_out_of_it(self):
        x, y = pixels((128, 128))
        x1, y1 = self.flow.trace(x, y)
        inside = self.flow.inside(x, y)
        assert (x1 == x)[~inside].all() and (y1 == y)[~inside].all()
        assert self.flow.inside(x1[inside], y1[inside] - 1e-6).all()
