"""The linear clock law."""

import numpy as np
import pytest
import torch

from dcgrid_env import LinearDvfs, PrefillDecodeDvfs
from dcgrid_env.devices import DataCenterParams, speed_share

SITE = DataCenterParams(
    p_rated_kw=np.array([1000.0, 200.0]),
    p_idle_kw=np.array([230.0, 0.0]),
    p_dynamic_kw=np.array([770.0, 200.0]),
    f_min_mhz=np.array([210.0, 210.0]),
    f_max_mhz=np.array([1410.0, 1000.0]),
    s_rated_kva=np.array([1100.0, 200.0]),
    q_max_kvar=np.array([330.0, 66.0]),
)


@pytest.mark.parametrize(
    ("f_mhz", "ceiling_kw"),
    [((1410.0, 1000.0), (770.0, 200.0)), ((705.0, 500.0), (385.0, 100.0)), ((141.0, 210.0), (77.0, 42.0))],
)
def test_clock_sets_the_ceiling(f_mhz, ceiling_kw):
    plenty = np.array([1e6, 1e6])
    rate, power = LinearDvfs().serve(SITE, np.array(f_mhz), plenty)
    np.testing.assert_allclose(rate, ceiling_kw, rtol=1e-14)
    np.testing.assert_allclose(power, ceiling_kw, rtol=1e-14)


def test_work_that_is_not_there_is_not_served():
    rate, power = LinearDvfs().serve(SITE, np.array([705.0, 500.0]), np.array([384.0, 0.0]))
    assert rate.tolist() == power.tolist() == [384.0, 0.0]


def test_the_more_limiting_of_clock_and_work_decides_in_every_row():
    f = np.array([[1410.0, 1000.0], [705.0, 500.0], [705.0, 1000.0]])
    work = np.array([[100.0, 300.0], [500.0, 100.0], [385.0, 150.0]])
    rate, _ = LinearDvfs().serve(SITE, f, work)
    np.testing.assert_allclose(rate, [[100.0, 200.0], [385.0, 100.0], [385.0, 150.0]], rtol=1e-14)


def test_derivatives_follow_whichever_limits():
    site = DataCenterParams(*map(torch.tensor, SITE))
    f = torch.tensor([705.0, 1000.0], dtype=torch.float64, requires_grad=True)
    work = torch.tensor([500.0, 150.0], dtype=torch.float64, requires_grad=True)
    rate, _ = LinearDvfs().serve(site, f, work)
    rate.sum().backward()
    assert f.grad is not None
    assert work.grad is not None
    np.testing.assert_allclose(f.grad, [770.0 / 1410.0, 0.0])
    np.testing.assert_allclose(work.grad, [0.0, 1.0])


F_MHZ = np.array([[1410.0, 1000.0], [705.0, 250.0], [282.0, 500.0]])
CLOCK = F_MHZ / SITE.f_max_mhz


def test_speed_under_the_linear_law_is_the_clocks_share():
    np.testing.assert_allclose(speed_share(LinearDvfs(), SITE, F_MHZ), CLOCK[..., None], rtol=1e-12)


def test_speed_under_the_phase_law_is_each_work_classs_own():
    found = speed_share(PrefillDecodeDvfs(decode_clock_share=0.05), SITE, F_MHZ)
    slow = 1.0 / (1.0 + 0.05 * (1.0 / CLOCK - 1.0))
    np.testing.assert_allclose(found, np.stack((CLOCK, slow), axis=-1), rtol=1e-12)


def test_speed_is_found_where_a_site_can_do_more_than_its_rating():
    class Twice:
        """Up to twice the dynamic power, falling with the square of the clock."""

        def serve(self, params, f_mhz, work_kw):
            done = np.minimum(work_kw, 2.0 * params.p_dynamic_kw * (f_mhz / params.f_max_mhz) ** 2)
            return done, done

    np.testing.assert_allclose(speed_share(Twice(), SITE, F_MHZ), CLOCK[..., None] ** 2, rtol=1e-12)
