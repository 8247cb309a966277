"""Constant density: coefficients of the article, its equations by quadrature written down again, its haze."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad
from skies import COLOURS, unit_scene, unit_vector, views

import skyfit
from skyfit.atmosphere import Aerosol, Exponential, HOFFMAN_WAVELENGTHS, Layered, Ozone, Rayleigh
from skyfit.scene import relative_airmass
from skyfit.transport import Uniform


# what is held here is each integral itself, not how far its sky may be off under a low sun
pytestmark = pytest.mark.filterwarnings("ignore::skyfit.LowSunWarning")

RGB = np.array(HOFFMAN_WAVELENGTHS)
AIR = Rayleigh(formula="paper", profile=Exponential(8400.0))


def lobe(cosine, g):
    return (1.0 - g**2) / (4.0 * np.pi * (1.0 + g**2 - 2.0 * g * cosine) ** 1.5)


def kasten(zenith_deg):
    return 1.0 / (np.cos(np.radians(zenith_deg)) + 0.15 * (93.885 - zenith_deg) ** -1.253)


def test_the_air_has_the_coefficients_of_the_article():
    """6.95e-6, 1.18e-5, 2.44e-5 per metre: half a unit of the last digit."""
    clear = Uniform().path(
        skyfit.Atmosphere(AIR, None, None), unit_scene(30.0, views([90.0], [0.0]), RGB), jnp.array([1e4])
    )
    found = -np.log(np.asarray(clear.transmittance, float))[0] / 1e4
    np.testing.assert_allclose(found, [6.95e-6, 1.18e-5, 2.44e-5], atol=0.5e-7)
    np.testing.assert_allclose(found[0], 6.95e-6, atol=0.5e-8)


def test_the_airmass_is_kastens_to_the_horizon_and_held_below_it(x64):
    pvlib = pytest.importorskip("pvlib", reason="pvlib is absent")
    zenith = np.array([0.0, 30.0, 60.0, 75.0, 85.0, 89.0, 90.0])
    found = relative_airmass(jnp.radians(zenith))
    np.testing.assert_allclose(found, kasten(zenith), rtol=1e-12)
    np.testing.assert_allclose(found, pvlib.atmosphere.get_relative_airmass(zenith, "kasten1966"), rtol=1e-9)
    below = jnp.radians(jnp.array([90.0 + 1e-9, 91.0, 93.885, 120.0, 180.0]))
    np.testing.assert_allclose(relative_airmass(below), found[-1], rtol=1e-6)
    assert np.all(jax.vmap(jax.grad(relative_airmass))(below) == 0.0)
    assert np.all(np.isfinite(jax.vmap(jax.grad(relative_airmass))(jnp.radians(jnp.asarray(zenith)))))


def shells_by_quadrature(sun, view, azimuth, wavelength, lengths, betas, albedos, absorbed):
    """One wavelength: scatterers of the given ground coefficients that end at the given optical lengths."""
    cosine = unit_vector(sun, 0.0) @ unit_vector(view, azimuth)
    phases = (3.0 / (16.0 * np.pi * (1.0 + 2.0 * s)) * (1.0 + 3.0 * s + (1.0 - s) * cosine**2), lobe(cosine, 0.7))
    airmass = kasten(view)
    light = np.exp(-kasten(sun) * (absorbed + sum(b * length for b, length in zip(betas, lengths, strict=True))))

    def integrand(s):
        dense = [float(s < length * airmass) for length in lengths]
        depth = sum(b * min(s, length * airmass) for b, length in zip(betas, lengths, strict=True))
        return np.exp(-depth) * sum(b * a * p * d for b, a, p, d in zip(betas, albedos, phases, dense, strict=True))

    ends = sorted(length * airmass for length in lengths)
    whole = sum(
        quad(integrand, low, high, epsabs=0.0, epsrel=1e-11, limit=200)[0]
        for low, high in zip([0.0, *ends[:-1]], ends, strict=True)
    )
    return light * whole


s = 0.0279 / (2.0 - 0.0279)  # spread of the default depolarisation of air


@pytest.mark.parametrize("haze_length", [1250.0, 12000.0])
def test_the_sky_is_the_integral_through_two_shells(x64, haze_length):
    """Either constituent may be the outer shell."""
    atmosphere = skyfit.Atmosphere(AIR, Aerosol(0.3, 1.2, 0.9, profile=Exponential(haze_length)), Ozone())
    zenith, azimuth = [0.0, 50.0, 85.0, 90.0], [0.0, 100.0]
    for sun in (0.0, 60.0, 88.0):
        found = Uniform().radiance(atmosphere, unit_scene(sun, views(zenith, azimuth), COLOURS))
        for i, nm in enumerate(COLOURS):
            air, haze, ozone = (
                float(c.optical_depth_at(jnp.array([nm]))[0])
                for c in (atmosphere.rayleigh, atmosphere.aerosol, Ozone())
            )
            expected = [
                shells_by_quadrature(
                    sun, v, a, nm, (8400.0, haze_length), (air / 8400.0, haze / haze_length), (1.0, 0.9), ozone
                )
                for v in zenith
                for a in azimuth
            ]
            np.testing.assert_allclose(found[:, i], expected, rtol=1e-8)


def test_a_path_is_equation_four_and_composites_by_equation_one(x64):
    haze = skyfit.hoffman_haze("heavy haze", RGB, absorption=5e-5)
    atmosphere = skyfit.Atmosphere(AIR, haze, None)
    # level, up and down: the density does not change
    scene = unit_scene(40.0, views([90.0, 60.0, 120.0], [0.0]), RGB)
    distance = jnp.array([0.0, 2e3, 3e4])
    path = Uniform().path(atmosphere, scene, distance)
    scattering = np.array([8e-5, 1e-4, 1.2e-4])
    air = np.asarray(AIR.optical_depth_at(jnp.asarray(RGB)), float) / 8400.0
    beta = air + scattering + 5e-5
    light = np.exp(-kasten(40.0) * (air * 8400.0 + (scattering + 5e-5) * 1250.0))
    for i, (zenith, way) in enumerate(zip([90.0, 60.0, 120.0], np.asarray(distance), strict=True)):
        cosine = unit_vector(40.0, 0.0) @ unit_vector(zenith, 0.0)
        rayleigh = 3.0 / (16.0 * np.pi * (1.0 + 2.0 * s)) * (1.0 + 3.0 * s + (1.0 - s) * cosine**2)
        source = air * rayleigh + scattering * lobe(cosine, 0.75)
        np.testing.assert_allclose(path.transmittance[i], np.exp(-beta * way), rtol=1e-10)
        np.testing.assert_allclose(path.inscatter[i], light * source / beta * (1.0 - np.exp(-beta * way)), rtol=1e-9)
    background = jnp.full((3, 3), 0.2)
    np.testing.assert_allclose(path.over(background), path.transmittance * 0.2 + path.inscatter)
    np.testing.assert_array_equal(path.over(background)[0], 0.2)


def test_absorption_darkens_and_a_long_path_forgets_the_object():
    scene = unit_scene(40.0, views([90.0], [0.0, 120.0]), RGB)
    clear, sooty = (
        Uniform().path(
            skyfit.Atmosphere(AIR, skyfit.hoffman_haze("light haze", RGB, absorption=k), None), scene, jnp.full(2, 1e7)
        )
        for k in (0.0, 5e-5)
    )
    assert np.all(np.asarray(clear.transmittance) == 0.0)
    assert np.all(sooty.inscatter < 0.6 * clear.inscatter)


@pytest.mark.parametrize(
    "kind, betas",
    [
        ("light haze", [2e-5, 3e-5, 4e-5]),
        ("heavy haze", [8e-5, 1e-4, 1.2e-4]),
        ("light fog", [9e-4, 1e-3, 1.1e-3]),
        ("heavy fog", [1e-2, 1e-2, 1e-2]),
    ],
)
def test_the_hazes_are_the_articles_table(x64, kind, betas):
    haze = skyfit.hoffman_haze(kind, RGB)
    np.testing.assert_allclose(haze.optical_depth / 1250.0, betas, rtol=1e-12)
    np.testing.assert_allclose(haze.single_scattering_albedo_at(jnp.asarray(RGB)), 1.0)
    assert 0.0 < float(haze.phase.asymmetry) < 1.0
    spectrum = np.arange(380.0, 781.0, 10.0)
    smooth = np.asarray(skyfit.hoffman_haze(kind, spectrum).optical_depth)
    assert np.all(smooth > 0.0) and np.all(np.diff(smooth) <= 1e-12)


def test_what_the_article_does_not_have_is_refused():
    with pytest.raises(ValueError, match="`kind` must be one of light haze"):
        skyfit.hoffman_haze("pea soup", RGB)
    for absorption in (-1e-9, 6e-5, float("nan")):
        with pytest.raises(ValueError, match="`absorption` must be between"):
            skyfit.hoffman_haze("light haze", RGB, absorption)
    with pytest.raises(ValueError, match="geometry"):
        Uniform("spherical")
    aloft = skyfit.Scene.from_degrees(30.0, views([0.0], [0.0]), RGB, irradiance="unit", height=100.0)
    with pytest.raises(ValueError, match="`height`"):
        Uniform().radiance(skyfit.Atmosphere(AIR, None, None), aloft)


def test_the_flux_is_the_sky_over_the_hemisphere(x64):
    """Independent quadrature; the sum of sun and sky stays below the light that came in."""
    atmosphere = skyfit.Atmosphere(AIR, skyfit.hoffman_haze("light haze", RGB), None)
    x, weight = np.polynomial.legendre.leggauss(40)
    mu = 0.5 * (x + 1.0)
    view = views(np.degrees(np.arccos(mu)), 360.0 * (np.arange(64) + 0.5) / 64)
    sky = np.asarray(Uniform().radiance(atmosphere, unit_scene(50.0, view, RGB))).reshape(40, 64, 3)
    expected = 2.0 * np.pi * (0.5 * weight * mu) @ sky.mean(axis=1)
    flux = Uniform().fluxes(atmosphere, unit_scene(50.0, view, RGB))
    np.testing.assert_allclose(flux.diffuse_down, expected, rtol=2e-3)
    assert np.all(flux.direct + flux.diffuse_down < np.cos(np.radians(50.0)))


def test_a_layer_that_begins_aloft_keeps_its_light_out_of_the_sun(x64):
    """No density at the ground: the model cannot place it, but its depth still dims the beam."""
    cloud = Aerosol(0.5, 0.0, 1.0, profile=Layered([0.0, 1000.0, 2000.0], [0.0, 1.0]))
    flux = Uniform().fluxes(skyfit.Atmosphere(None, cloud, None), unit_scene(60.0, views([0.0], [0.0])))
    assert float(flux.direct[0]) == pytest.approx(0.5 * np.exp(-0.5 * kasten(60.0)), rel=1e-9)


def test_gradients_are_those_of_differences(x64):
    scene = unit_scene(50.0, views([0.0, 60.0, 85.0], [30.0, 150.0]), COLOURS)

    def sky(p):
        haze = Aerosol(p[0], p[1], p[2], phase=skyfit.HenyeyGreenstein(p[3]), profile=Exponential(p[4] * 1e3))
        turned = skyfit.Scene(p[5], 0.0, scene.view, COLOURS, scene.solar_irradiance)
        atmosphere = skyfit.Atmosphere(AIR, haze, Ozone(p[6] * 1e3))
        path = Uniform().path(atmosphere, turned, jnp.full(6, 5e3))
        return jnp.stack([Uniform().radiance(atmosphere, turned), path.inscatter, path.transmittance])

    start = jnp.array([0.2, 1.3, 0.9, 0.65, 1.2, 0.9, 0.3])
    slopes = jax.jacfwd(sky)(start)
    for i in range(start.size):
        step = 1e-6 * jnp.eye(start.size)[i]
        central = (sky(start + step) - sky(start - step)) / 2e-6
        assert float(jnp.max(jnp.abs(central))) > 1e-4
        np.testing.assert_allclose(slopes[..., i], central, atol=1e-6 * float(jnp.max(jnp.abs(central))))


def test_shells_of_one_length_have_the_gradient_of_differences(x64):
    """Two scale heights are equal; the sky is differentiable there in each of them."""
    scene = unit_scene(50.0, views([0.0, 60.0, 85.0], [30.0]), COLOURS)

    def sky(heights):
        haze = Aerosol(1.0, profile=Exponential(heights[1]))
        return Uniform().radiance(skyfit.Atmosphere(Rayleigh(profile=Exponential(heights[0])), haze, None), scene)

    start = jnp.array([2000.0, 2000.0])
    slopes = jax.jacfwd(sky)(start)
    for i in range(2):
        step = 0.01 * jnp.eye(2)[i]
        central = (sky(start + step) - sky(start - step)) / 0.02
        np.testing.assert_allclose(slopes[..., i], central, atol=1e-5 * float(jnp.max(jnp.abs(central))))


def test_a_path_without_end_is_finite():
    """A depth image holds infinity where nothing stands: the object is gone, the light is that of a long path."""
    atmosphere, scene = skyfit.Atmosphere(AIR, None, Ozone()), unit_scene(50.0, views([30.0, 90.0], [0.0]), RGB)
    long, endless = (Uniform().path(atmosphere, scene, jnp.full(2, d)) for d in (1e8, jnp.inf))
    np.testing.assert_array_equal(endless.transmittance, 0.0)
    np.testing.assert_allclose(endless.inscatter, long.inscatter, rtol=1e-6)
    slope = jax.grad(lambda d: jnp.sum(Uniform().path(atmosphere, scene, d).inscatter))(jnp.array([1e3, jnp.inf]))
    assert np.all(np.isfinite(slope))
