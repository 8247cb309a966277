"""What the instrument adds to a sky: calibration, clouds in its way, cone of view, channels; and the sun's beam."""

from dataclasses import replace

import jax
import numpy as np
import pytest
from made_skies import as_sky, by_hand, EXACT, FREE, HAZE, PLAIN, SOLVER

import skyfit
from skyfit.light import extraterrestrial_irradiance
from skyfit.retrieve import start_model, with_values
from skyfit.transport.optics import optics


TRUTH = np.array(list(HAZE.values()))
# at the mean distance of the sun
NO_DAY = np.array(["NaT"], "datetime64[ns]")


def made(radiance, noise=0.01, seed=40, **about):
    return as_sky(radiance, noise, seed, time=NO_DAY, **about)


def fitted(sky, free=FREE, **changes):
    return skyfit.invert(sky, free, SOLVER, measurement=replace(EXACT, **changes))


def off(fit, truth=TRUTH):
    """In standard deviations."""
    return np.abs(fit.values[0] - truth) / fit.sigma[0]


@pytest.fixture(scope="module")
def sky():
    with jax.enable_x64(True):
        return made(by_hand())


@pytest.fixture(scope="module")
def plain(sky):
    with jax.enable_x64(True):
        return fitted(sky)


def test_a_wavelength_that_is_too_bright_is_found_and_does_no_harm(x64, sky):
    bright = sky.radiance.copy()
    bright[:, :, 0] *= 1.03
    wrong = replace(sky, radiance=bright)
    # nothing but the calibration is to explain it
    alone = dict.fromkeys(("level", "colour", "pointing", "broad_level", "broad_colour"), 0.0) | {"loss": "squares"}
    kept, found = fitted(wrong, **alone), fitted(wrong, calibration=0.01, **alone)
    assert found.result == ("successful",)
    assert np.all(kept.calibration == 1.0) and np.all(kept.calibration_sigma == 0.0)
    scale, sigma = found.calibration[0], found.calibration_sigma[0]
    # the prior of 1 % draws it back a little, and no other with it
    assert scale[0] > 1.02 and abs(scale[0] - 1.03) < 2.0 * sigma[0]
    others = np.arange(1, 15)
    assert np.all(np.abs(scale[others] - 1.0) < 3.0 * sigma[others])
    assert np.all((sigma > 0.0) & (sigma < 0.01))
    np.testing.assert_allclose(
        found.model[0, :, 0] / found.model[0, :, 1], bright[0, :, 0] / bright[0, :, 1], rtol=0.05
    )
    # of what the calibration moves, the colour of the haze most
    assert abs(found.values[0, 1] - HAZE["angstrom_exponent"]) < abs(kept.values[0, 1] - HAZE["angstrom_exponent"])
    assert np.all(off(found) < 3.0) and not np.all(off(kept) < 3.0)
    # what is not known exactly leaves the parameters less sure
    assert np.all(found.sigma > 1.05 * kept.sigma / kept.scale)


def test_clouds_are_rejected_by_name_and_leave_the_haze_alone(x64, sky, plain):
    clouds = [2, 9, 17, 26, 33]
    bright = sky.radiance.copy()
    bright[:, clouds] *= 3.0
    cloudy = replace(sky, radiance=bright)
    squares, huber, cauchy = (fitted(cloudy, loss=loss) for loss in ("squares", "huber", "cauchy"))
    assert not plain.rejected.any()
    for fit in (huber, cauchy):
        assert np.flatnonzero(fit.rejected[0]).tolist() == clouds
        assert off(fit)[0] < 3.0
        assert np.all(fit.weight[0, clouds] < 0.5)
        others = np.delete(np.arange(40), clouds)
        assert np.mean(fit.weight[0, others]) > 0.8
    assert not squares.rejected.any() and np.all(squares.weight == 1.0)
    assert np.abs(squares.values[0, 0] - 0.2) > 10.0 * max(huber.sigma[0, 0], cauchy.sigma[0, 0])
    assert np.abs(squares.values[0, 0] - 0.2) > 5.0 * np.abs(cauchy.values[0, 0] - 0.2)
    # what was rejected counts in chi-square, and has no say in how large the errors of the others are
    assert huber.reduced_chi_square[0] > 100.0 and huber.scale[0] < 1.1 and cauchy.scale[0] < 1.1
    assert np.all(huber.common[0] < 0.01) and np.all(cauchy.common[0] < 0.01)
    # trusted as much as the others the clouds are levels of directions, and sigma says how far that leads astray
    assert squares.common[0, 0] > 0.4 and squares.scale[0] < 2.0 and np.all(off(squares) < 2.0)
    # of what a loss still trusts of them the influence widens sigma: of Huber much, of Cauchy little
    assert np.all(plain.sigma < cauchy.sigma) and np.all(cauchy.sigma < 1.5 * plain.sigma)
    assert np.all(off(huber) < 3.0) and np.all(huber.sigma > 1.5 * plain.sigma)
    assert np.all(squares.sigma > 10.0 * huber.sigma)


AUREOLE = np.radians([2.2, 2.5, 3.0, 3.5, 4.0, 5.0, 6.0, 8.0, 11.0, 15.0])
CONE = np.radians(3.0)


def aureole():
    """Ten angles above and beside the sun, and 20 directions beyond."""
    zenith = np.concatenate([0.9 - AUREOLE, np.full(10, 0.9), np.linspace(0.1, 1.2, 20)])
    return zenith, np.concatenate([np.full(10, 1.0), 1.0 + AUREOLE / np.sin(0.9), np.linspace(1.8, 4.5, 20)])


def rays_of_cones(zenith, azimuth, count=600):
    """Rays that fill the cone about each direction evenly, `[ray, direction]`, by unit vectors."""
    axis = np.stack([np.sin(zenith) * np.cos(azimuth), np.sin(zenith) * np.sin(azimuth), np.cos(zenith)])
    down = np.stack([np.cos(zenith) * np.cos(azimuth), np.cos(zenith) * np.sin(azimuth), -np.sin(zenith)])
    beside = np.cross(axis.T, down.T).T
    tilt = np.arccos(1.0 - (1.0 - np.cos(0.5 * CONE)) * (np.arange(count) + 0.5) / count)[:, None, None]
    turn = (np.pi * (3.0 - np.sqrt(5.0)) * np.arange(count))[:, None, None]
    x, y, z = np.moveaxis(np.cos(tilt) * axis + np.sin(tilt) * (np.cos(turn) * down + np.sin(turn) * beside), 1, 0)
    return np.arccos(z), np.arctan2(y, x)


def brightness(zenith, azimuth, asymmetry=0.85):
    aerosol = skyfit.Aerosol(0.2, 1.1, 0.95, 0.0, skyfit.HenyeyGreenstein(asymmetry))
    atmosphere = skyfit.Atmosphere(skyfit.Rayleigh(101325.0), aerosol, skyfit.Ozone(300.0), skyfit.Ground(0.1))
    sun = np.asarray(extraterrestrial_irradiance(PLAIN, 6.0), float)
    scene = skyfit.Scene(0.9, 1.0, skyfit.Directions(zenith, azimuth), PLAIN, sun)
    return np.asarray(SOLVER.radiance(atmosphere, scene), float)


def test_an_aureole_seen_through_a_wide_cone(x64):
    rays = rays_of_cones(*aureole())
    seen = brightness(*(np.ravel(angle) for angle in rays)).reshape(600, 40, -1).mean(axis=0)
    # brighter or darker than its axis by several times the noise
    assert np.max(np.abs(seen / brightness(*aureole()) - 1.0)) > 0.012
    view_zenith, view_azimuth = aureole()
    sky = replace(made(seen, 0.003), view_zenith=view_zenith, view_azimuth=view_azimuth)
    wide, narrow = fitted(sky, field_of_view=float(CONE)), fitted(sky)
    truth = np.array([0.2, 1.1, 0.85])
    assert np.all(off(wide, truth) < 3.0)
    assert off(narrow, truth).max() > 5.0
    assert narrow.reduced_chi_square[0] > 1.2 * wide.reduced_chi_square[0] and wide.reduced_chi_square[0] < 1.1


def test_the_direct_beam_narrows_the_optical_depth_and_biases_nothing(x64, sky, plain):
    # Bouguer's law over a flat Earth, depths by the atmosphere's own constituents
    haze = skyfit.Aerosol(0.2, 1.1, 0.95, 0.0, skyfit.HenyeyGreenstein(0.65))
    parts = optics((skyfit.Rayleigh(101325.0), haze, skyfit.Ozone(300.0)), jax.numpy.asarray(PLAIN))
    sun = np.asarray(extraterrestrial_irradiance(PLAIN, 6.0), float)
    direct = sun * np.exp(-np.asarray(parts.extinction, float).sum(axis=0) / np.cos(0.9))
    noise = 1.0 + 0.001 * np.random.default_rng(41).standard_normal(direct.shape)
    fit = fitted(
        replace(sky, direct_irradiance=(direct * noise)[None], direct_sigma=(0.001 * direct)[None])
    )  # fmt: skip
    assert fit.result == ("successful",)
    assert np.all(off(fit) < 3.0)
    assert fit.sigma[0, 0] < 0.8 * plain.sigma[0, 0]
    assert fit.gain.shape == plain.gain.shape and fit.weight.shape == plain.weight.shape
    assert np.isnan(plain.beam_residual).all() and np.abs(fit.beam_residual).max() < 4.0
    wrong = fitted(replace(sky, direct_irradiance=(1.1 * direct)[None], direct_sigma=(0.001 * direct)[None]))
    assert not np.all(off(wrong) < 3.0)
    assert np.abs(wrong.beam_residual).max() > 3.0
    assert any("the direct beam measured at" in n and "contradict each other" in n for n in wrong.notes)
    assert not any("contradict" in n for n in fit.notes)


def test_a_depth_that_is_the_total_one_is_told(x64, sky):
    haze = 0.2 * (PLAIN / 550.0) ** -1.1
    air = np.asarray(skyfit.Rayleigh(101325.0).optical_depth_at(jax.numpy.asarray(PLAIN)), float)
    sigma = np.full((1, PLAIN.size), 0.005)
    right, total = (
        fitted(replace(sky, aerosol_optical_depth=depth[None], aerosol_optical_depth_sigma=sigma))
        for depth in (haze, haze + air)
    )
    assert not any("contradict" in n for n in right.notes) and np.abs(right.beam_residual).max() < 3.0
    assert any("is it the total one" in n for n in total.notes), total.notes


def test_the_jackknife_agrees_with_sigma_where_the_noise_is_as_stated(x64, sky, plain):
    fit = skyfit.invert(sky, FREE, SOLVER, measurement=EXACT, jackknife=20)
    assert np.isnan(plain.jackknife_sigma).all()
    np.testing.assert_array_equal(fit.values, plain.values)
    # of twenty groups a spread is known to a sixth
    np.testing.assert_allclose(fit.jackknife_sigma[0], plain.sigma[0], rtol=0.5)
    # errors that neighbours share it sees as well
    wave = replace(sky, radiance=sky.radiance * (1.0 + 0.05 * np.sin(np.arange(40) / 3.0))[None, :, None])
    shaken = skyfit.invert(wave, FREE, SOLVER, measurement=EXACT, jackknife=20)
    assert np.all(shaken.jackknife_sigma[0, [0, 2]] > 2.0 * fit.jackknife_sigma[0, [0, 2]])
    for groups in (1, -3, 101):
        with pytest.raises(ValueError, match="`jackknife` must be 0 or 2 to 100 groups"):
            skyfit.invert(sky, FREE, SOLVER, jackknife=groups)


@pytest.mark.parametrize("name", ["xyz", "linear_srgb"])
def test_the_channels_of_a_camera_tell_the_turbidity(x64, name):
    response = getattr(skyfit.Response, name)()
    spectrum = by_hand(wavelength_nm=response.wavelength_nm, fwhm_nm=None)
    colours = spectrum @ response.weight.T
    sky = made(colours, 0.01, wavelength_nm=response.centre_nm, fwhm_nm=np.nan, response=response)
    fit = skyfit.invert(sky, ("turbidity", "asymmetry"), SOLVER, exponent(), measurement=EXACT)
    truth = [float(skyfit.optical_depth_to_turbidity(0.2)), 0.65]
    assert fit.result == ("successful",) and fit.determined.all()
    assert np.all(off(fit, np.array(truth)) < 3.0) and fit.sigma[0, 0] < 0.05 * truth[0]
    np.testing.assert_allclose(fit.model[0], colours, rtol=0.01)
    assert fit.response is response and fit.reduced_chi_square[0] < 1.3


def exponent():
    return with_values(start_model((), 101325.0), ("angstrom_exponent",), np.array([1.1]))
