"""Small skies made by a solver alone, and measured skies of them."""

import numpy as np

import skyfit
from skyfit.light import extraterrestrial_irradiance


SOLVER = skyfit.SingleScattering(8, "flat")
HAZE = {"aerosol_optical_depth": 0.2, "angstrom_exponent": 1.1, "asymmetry": 0.65}
FREE = tuple(HAZE)
PLAIN = np.arange(400.0, 681.0, 20.0)
# noise alone in sigma
EXACT = skyfit.NoiseModel(model_error=0.0)
# and of each sample alone
OWN_NOISE = skyfit.NoiseModel(model_error=0.0, level=0.0, colour=0.0, pointing=0.0, broad_level=0.0, broad_colour=0.0)


def by_hand(
    solver=SOLVER, wavelength_nm=PLAIN, directions=40, sun_zenith=0.9, sun_azimuth=1.0, factor=1.0,
    aerosol_optical_depth=0.2, angstrom_exponent=1.1, asymmetry=0.65, single_scattering_albedo=0.95,
    ozone=300.0, ground_albedo=0.1, pressure=101325.0, fwhm_nm=6.0, phase=None, view=None,
):  # fmt: skip
    """Radiance [direction, wavelength] by the solver alone, on `hemisphere(directions)` or of a `view`."""
    view = skyfit.hemisphere(directions) if view is None else view
    phase = skyfit.HenyeyGreenstein(asymmetry) if phase is None else phase
    atmosphere = skyfit.Atmosphere(
        rayleigh=skyfit.Rayleigh(pressure=pressure),
        aerosol=skyfit.Aerosol(aerosol_optical_depth, angstrom_exponent, single_scattering_albedo, 0.0, phase),
        ozone=skyfit.Ozone(ozone),
        ground=skyfit.Ground(ground_albedo),
    )
    sun = np.asarray(extraterrestrial_irradiance(wavelength_nm, fwhm_nm), float) * factor
    scene = skyfit.Scene(sun_zenith, sun_azimuth, view, wavelength_nm, sun)
    return np.asarray(solver.radiance(atmosphere, scene), float)


def as_sky(radiance, noise=0.02, seed=None, wavelength_nm=PLAIN, sun_zenith=0.9, sun_azimuth=1.0, **about):
    """A measured sky of one or more times; noise is added where a seed is given."""
    radiance = np.atleast_3d(radiance) if np.ndim(radiance) == 3 else np.asarray(radiance)[None]
    sigma = None if noise is None else noise * radiance
    if seed is not None:
        radiance = radiance + sigma * np.random.default_rng(seed).standard_normal(radiance.shape)
    times = len(radiance)
    view = skyfit.hemisphere(radiance.shape[1])
    settings = {
        "time": np.datetime64("2025-10-05T12:00:00") + np.arange(times) * np.timedelta64(30, "m"),
        "pressure_pa": 101325.0,
        "fwhm_nm": 6.0,
        "source": "made",
    } | about
    return skyfit.Sky(
        radiance=radiance, sigma=sigma, usable=np.ones(radiance.shape, bool),
        view_zenith=np.asarray(view.zenith, float), view_azimuth=np.asarray(view.azimuth, float),
        wavelength_nm=wavelength_nm, sun_zenith=np.broadcast_to(sun_zenith, times),
        sun_azimuth=np.broadcast_to(sun_azimuth, times), **settings,
    )  # fmt: skip
