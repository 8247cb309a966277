"""Double scattering against integrals over the sphere written down again."""

import numpy as np
import pytest
from skies import haze_over_air, unit_scene, unit_vector, views

import skyfit
from skyfit.atmosphere import Exponential, Ground, HenyeyGreenstein, Prescribed, RayleighPhase
from skyfit.transport import DoubleScattering, OrdersOfScattering, SingleScattering


def rayleigh(cosine):
    return 3.0 / (16.0 * np.pi) * (1.0 + cosine**2)


def lobe(asymmetry):
    def value(cosine):
        return (1.0 - asymmetry**2) / (4.0 * np.pi * (1.0 + asymmetry**2 - 2.0 * asymmetry * cosine) ** 1.5)

    return value


def difference_quotient(a, b, depth):
    """The integral of exp(-a t - b (depth - t)) over t from 0 to depth."""
    same = np.isclose(a, b)
    gap = np.where(same, 1.0, b - a)
    return np.where(same, depth * np.exp(-a * depth), (np.exp(-a * depth) - np.exp(-b * depth)) / gap)


def second_order(phase, depth, albedo, sun_deg, view_deg, azimuth_deg):
    r"""Radiance at the ground of light that is scattered exactly twice in a slab over a black ground.

    $\int d\omega' p p \int\int$ of exponentials of optical depth, in closed form over both depths; the sphere of
    directions between the two scatterings by Gauss points in the cosine and equal steps of azimuth.
    """
    x, weight = np.polynomial.legendre.leggauss(60)
    cosine, turns = np.concatenate([0.5 * (x - 1.0), 0.5 * (x + 1.0)]), 120
    weight = np.concatenate([weight, weight]) * 0.5 * 2.0 * np.pi / turns
    azimuth = 2.0 * np.pi * (np.arange(turns) + 0.5) / turns
    mu, phi = (v.ravel() for v in np.meshgrid(cosine, azimuth, indexing="ij"))
    weight = np.repeat(weight, turns)
    sine = np.sqrt(1.0 - mu**2)
    # the direction toward which one looks to meet the light between the two scatterings
    middle = np.stack([sine * np.cos(phi), sine * np.sin(phi), mu], axis=-1)
    sunward, viewward = unit_vector(sun_deg, 0.0), unit_vector(view_deg, azimuth_deg)
    a, b = 1.0 / sunward[2], 1.0 / viewward[2]
    c = 1.0 / np.abs(mu)
    nodes, node_weight = np.polynomial.legendre.leggauss(40)
    level, level_weight = 0.5 * depth * (nodes + 1.0), 0.5 * depth * node_weight
    total = 0.0
    for t, w in zip(level, level_weight, strict=True):
        # once-scattered light at optical depth t: from above (mu > 0) or from below
        above = difference_quotient(a, c, t)
        below = (np.exp(-a * t) - np.exp(-a * depth - c * (depth - t))) / (a + c)
        once = albedo * phase(middle @ sunward) * c * np.where(mu > 0.0, above, below)
        total += w * b * np.exp(-b * (depth - t)) * albedo * np.sum(weight * phase(middle @ viewward) * once)
    return total


# (asymmetry or None for air, single-scattering albedo), errors of `normal` and `fine` relative to the sky
CASES = [(None, 1.0, 4e-4, 1e-4), (0.5, 0.9, 6e-4, 1.5e-4), (0.7, 1.0, 6e-3, 5e-4)]


@pytest.mark.parametrize("asymmetry, albedo, normal, fine", CASES)
@pytest.mark.parametrize("depth", [0.1, 0.5])
def test_the_second_order_is_the_integral(x64, asymmetry, albedo, normal, fine, depth):
    phase = rayleigh if asymmetry is None else lobe(asymmetry)
    scatterer = RayleighPhase(0.0) if asymmetry is None else HenyeyGreenstein(asymmetry)
    air = Prescribed(np.array([depth]), Exponential(8000.0), scatterer, albedo)
    # the ground is not seen: it must not matter
    atmosphere = skyfit.Atmosphere(air, None, None, Ground(0.5))
    zenith, azimuth = [0.0, 40.0, 70.0, 80.0], [0.0, 60.0, 180.0]
    for sun in (20.0, 60.0, 75.0):
        scene = unit_scene(sun, views(zenith, azimuth))
        once = np.asarray(SingleScattering.fine("flat").radiance(atmosphere, scene))[:, 0]
        twice = np.ravel([[second_order(phase, depth, albedo, sun, v, a) for a in azimuth] for v in zenith])
        for preset, tolerance in (("normal", normal), ("fine", fine)):
            found = getattr(DoubleScattering, preset)("flat").radiance(atmosphere, scene)[:, 0]
            np.testing.assert_allclose(found, once + twice, rtol=tolerance, err_msg=f"{preset}, sun {sun}")


@pytest.mark.parametrize("geometry", ["flat", "spherical"])
def test_two_orders_lie_between_one_and_all_of_them(geometry):
    atmosphere, scene = haze_over_air(0.2, 0.2, ground=0.2), unit_scene(50.0, views([0.0, 60.0], [0.0, 90.0]))
    one, two, every = (
        kind.draft(geometry).radiance(atmosphere, scene)
        for kind in (SingleScattering, DoubleScattering, OrdersOfScattering)
    )
    assert np.all(two > 1.05 * one) and np.all(every > 1.02 * two)


def test_what_is_missing_shrinks_with_the_square_of_the_depth(x64):
    """All orders less the first two, over a black ground: the third order, tau^2 (log tau)^2 of the first."""
    scene, missing = unit_scene(40.0, views([0.0, 60.0], [30.0])), []
    for depth in (0.02, 0.04):
        atmosphere = haze_over_air(depth, 0.0)
        two, every = (
            k.normal("flat").radiance(atmosphere, scene)[:, 0] for k in (DoubleScattering, OrdersOfScattering)
        )
        missing.append((every - two) / every)
    ratio = missing[1] / missing[0]
    assert np.all((ratio > 3.0) & (ratio < 4.0)), ratio
