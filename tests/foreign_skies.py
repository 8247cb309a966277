"""Skies of other solvers as measured ones: sasktran2's own and the shared oracles' radiances as `skyfit.Sky`.

skyfit gives the optical depths, the depolarisation and the sun's spectrum, so that what differs is the transfer alone.
"""

import itertools
from collections.abc import Iterator
from dataclasses import dataclass, replace

import jax.numpy as jnp
import numpy as np

import skyfit
from skyfit.atmosphere import bodhaine_optical_depth, HenyeyGreenstein, RayleighPhase, TwoTermHenyeyGreenstein
from skyfit.atmosphere.phase import HAZE_POLARISATION
from skyfit.light import extraterrestrial_irradiance
from skyfit.retrieve import SkyModel


EARTH_RADIUS = 6.371e6
# m; sasktran2 refuses views from the ground up in its plane-parallel modes: an Earth this large is as flat
FLAT_RADIUS = 6.371e8
TOP = 1.0e5
# m; the thickness of sasktran2's layers grows as this + height
FINEST = 500.0
# nm; none within the bands of oxygen and water that an inversion leaves out
WAVELENGTH_NM = np.array([400.0, 440.0, 480.0, 530.0, 580.0, 630.0, 675.0, 708.0])
FWHM_NM = 6.0
# no instrument looks closer at the sun's disk
CLEAR_OF_SUN_DEG = 2.0
# degrees from the sun's azimuth at the sun's height, on both sides
ALMUCANTAR_DEG = (6.0, 10.0, 16.0, 25.0, 40.0, 60.0, 90.0, 130.0)
# degrees: view zenith, and azimuths from the sun's; sasktran2 is coarse between 0 and 15 (make_sample_sky.py)
RINGS_DEG = {
    0.0: (0.0,),
    20.0: (90.0, 180.0),
    40.0: (45.0, 135.0, 180.0),
    60.0: (-30.0, 100.0, 180.0),
    75.0: (20.0, -75.0, 130.0, 180.0),
}
# of the random skies: name -> least and largest
RANGES = {
    "sun_zenith_deg": (20.0, 70.0),
    "aerosol_optical_depth": (0.03, 0.6),
    "angstrom_exponent": (0.3, 2.0),
    "single_scattering_albedo": (0.8, 0.98),
    "asymmetry": (0.55, 0.8),
    "ground_albedo": (0.05, 0.6),
    "pressure": (8.0e4, 1.013e5),
}
SECOND_LOBE = {"asymmetry_second": (-0.2, 0.3), "forward_fraction": (0.75, 0.95)}


@dataclass(frozen=True)
class Truth:
    """What goes into a sky: names and units of `skyfit.retrieve.PARAMETERS`, and the sun's zenith angle in degrees.

    Haze of one lobe, of two where `forward_fraction` is below 1.
    """

    sun_zenith_deg: float = 50.0
    aerosol_optical_depth: float = 0.2
    angstrom_exponent: float = 1.3
    single_scattering_albedo: float = 0.92
    asymmetry: float = 0.68
    ground_albedo: float = 0.15
    pressure: float = 101325.0
    ozone: float = 300.0
    asymmetry_second: float = 0.0
    forward_fraction: float = 1.0
    polarisation: float = HAZE_POLARISATION

    def atmosphere(self) -> skyfit.Atmosphere:
        """The same in skyfit."""
        phase = HenyeyGreenstein(self.asymmetry, self.polarisation)
        if self.forward_fraction < 1.0:
            lobes = self.asymmetry, self.asymmetry_second, self.forward_fraction
            phase = TwoTermHenyeyGreenstein(*lobes, polarisation=self.polarisation)
        haze = self.aerosol_optical_depth, self.angstrom_exponent, self.single_scattering_albedo
        return skyfit.Atmosphere(
            skyfit.Rayleigh(self.pressure),
            skyfit.Aerosol(*haze, phase=phase),
            skyfit.Ozone(self.ozone),
            skyfit.Ground(self.ground_albedo),
        )

    def values(self, names: tuple[str, ...]) -> np.ndarray:
        """Those of the named parameters; a pointing offset is 0."""
        return np.array([getattr(self, name, 0.0) for name in names])


def random_truths(count: int, seed: int, two_lobes: bool = False) -> list[Truth]:
    """Skies drawn evenly from `RANGES`, and `SECOND_LOBE` if asked."""
    ranges = RANGES | SECOND_LOBE if two_lobes else RANGES
    low, high = np.array(list(ranges.values())).T
    draws = low + (high - low) * np.random.default_rng(seed).random((count, len(ranges)))
    return [Truth(**dict(zip(ranges, map(float, row), strict=True))) for row in draws]


def directions(sun_zenith_deg: float) -> tuple[np.ndarray, np.ndarray]:
    """View zenith and azimuth from the sun's, degrees: 17 on the almucantar, 13 on rings."""
    sides = [side * step for step in ALMUCANTAR_DEG for side in (-1.0, 1.0)]
    pairs = [(sun_zenith_deg, azimuth) for azimuth in (*sides, 180.0)]
    pairs += [(zenith, azimuth) for zenith, ring in RINGS_DEG.items() for azimuth in ring]
    zenith, azimuth = np.array(pairs).T
    return zenith, azimuth


def sasktran2_radiance(truth: Truth, **settings) -> np.ndarray:
    """Sky radiance by `sasktran2_stokes` on `directions` and `WAVELENGTH_NM`, scalar unless it is `polarised`."""
    zenith, azimuth = directions(truth.sun_zenith_deg)
    return sasktran2_stokes(truth.atmosphere(), truth.sun_zenith_deg, zenith, azimuth, WAVELENGTH_NM, **settings)[0]


def sasktran2_stokes(
    atmosphere: skyfit.Atmosphere,
    sun_zenith_deg: float,
    zenith_deg,
    azimuth_deg,
    wavelength_nm,
    polarised: bool = False,
    geometry: str = "flat",
    streams: int = 24,
    layers: int = 120,
    sun_positions: int = 3,
    moments: int = 128,
    height_m: float = 0.0,
) -> np.ndarray:
    """I, Q and U by sasktran2 per unit irradiance, `[component, direction, wavelength]`; I alone if not `polarised`.

    Azimuths from the sun's; the observer at `height_m`. Optical depths, profiles and the moments of phase functions and
    scattering matrices are skyfit's. Single scattering is exact, multiple scattering by discrete ordinates (flat layers
    under a spherical beam too). Scalar and flat, it is within 0.03 % (median 0.005 %) of 48 streams and 400 layers, and
    of nanodisort with 32 streams; polarised see `vector_skies.py`. Its Q and U are skyfit's.
    """
    import sasktran2 as sk

    wavelength = jnp.asarray(wavelength_nm, float)
    config = sk.Config()
    # one: the tests run in two processes
    config.num_threads, config.num_streams, config.num_singlescatter_moments = 1, streams, moments
    config.num_stokes = 3 if polarised else 1
    config.single_scatter_source = sk.SingleScatterSource.Exact
    config.multiple_scatter_source = sk.MultipleScatterSource.DiscreteOrdinates
    config.delta_m_scaling = True
    config.num_sza = 1 if geometry == "flat" else sun_positions

    height = FINEST * np.expm1(np.linspace(0.0, np.log1p(TOP / FINEST), layers + 1))
    cos_sun = float(np.cos(np.radians(sun_zenith_deg)))
    model = sk.Geometry1D(cos_sun, 0.0, FLAT_RADIUS if geometry == "flat" else EARTH_RADIUS, height)
    air = sk.Atmosphere(model, config, numwavel=wavelength.size, calculate_derivatives=False)
    for place, constituent in enumerate(atmosphere.constituents):
        shape = np.asarray(constituent.profile.density(jnp.asarray(height, float)), float)
        extinction = np.outer(shape / np.trapezoid(shape, height), constituent.optical_depth_at(wavelength))
        albedo = np.broadcast_to(
            np.asarray(constituent.single_scattering_albedo_at(wavelength), float), extinction.shape
        ).copy()
        legendre = None
        if constituent.phase is not None:
            greek = greek_coefficients(constituent.phase, moments, wavelength, polarised)
            legendre = np.broadcast_to(greek[:, None], (len(greek), *extinction.shape)).copy()
        air[f"constituent {place}"] = sk.constituent.Manual(extinction, albedo, legendre)
    ground = np.asarray(atmosphere.ground.reflectance(wavelength), float)
    air["ground"] = sk.constituent.LambertianSurface(ground)
    views = sk.ViewingGeometry()
    # in the zenith its frame is the sun's meridian for light scattered once, the azimuth's for the rest
    overhead = np.asarray(zenith_deg) == 0.0
    for zenith, azimuth in zip(np.radians(zenith_deg), np.where(overhead, 0.0, np.radians(azimuth_deg)), strict=True):
        views.add_ray(sk.SolarAnglesObserverLocation(cos_sun, float(azimuth), float(np.cos(zenith)), height_m))
    result = sk.Engine(config, model, views).calculate_radiance(air)
    stokes = result["radiance"].transpose("stokes", "los", "wavelength").to_numpy()
    if polarised:
        turn = 2.0 * np.where(overhead, np.radians(azimuth_deg), 0.0)[:, None]
        q, u = stokes[1], stokes[2]
        stokes = np.stack([stokes[0], np.cos(turn) * q + np.sin(turn) * u, np.cos(turn) * u - np.sin(turn) * q])
    return stokes


def greek_coefficients(phase, count: int, wavelength, polarised: bool) -> np.ndarray:
    """Expansion coefficients as sasktran2 stacks them: a1, a2, a3, b1 of degree 0, those of degree 1, ...; scalar, a1.

    They are 2 l + 1 times beta, alpha, zeta and minus gamma: its functions of I and Q have opposite signs.
    """
    beta = np.asarray(phase.moments(count, wavelength), float)
    each = beta[None]
    if polarised:
        alpha, gamma, zeta = np.asarray(phase.matrix_moments(count, wavelength), float)
        shape = count, max(beta.shape[1], alpha.shape[1])
        each = np.stack([np.broadcast_to(row, shape) for row in (beta, alpha, zeta, -gamma)])
    scaled = (2.0 * np.arange(count) + 1.0)[None, :, None] * each
    return scaled.transpose(1, 0, 2).reshape(-1, scaled.shape[-1])


def sasktran2_sky(truth: Truth, noise: float = 0.01, **settings) -> skyfit.Sky:
    """The sky without noise, but with the sigma of so much relative noise; `settings` of the solver."""
    zenith, azimuth = directions(truth.sun_zenith_deg)
    radiance = sasktran2_radiance(truth, **settings)
    return _sky(radiance, noise, truth, zenith, azimuth, WAVELENGTH_NM, "sasktran2")


def with_noise(sky: skyfit.Sky, seed: int) -> skyfit.Sky:
    """The sky with the Gaussian noise that its sigma states."""
    noise = sky.sigma * np.random.default_rng(seed).standard_normal(sky.radiance.shape)
    return replace(sky, radiance=sky.radiance + noise)


def oracle_skies(path, noise: float = 0.01) -> Iterator[tuple[Truth, skyfit.Sky, SkyModel]]:
    """The flat hazy skies of a shared oracle (nanodisort), with the model to start from: no ozone, no depolarisation.

    Its Rayleigh depths stand for the wavelengths at which air has them; the haze, the same at both, has Angstrom
    exponent 0. View zenith to 80 degrees, clear of the sun, both sides of the sun's meridian. Left out: cases at a
    bound (black ground, no absorption), low suns, and the sun in the zenith, which shows few angles.
    """
    data = np.load(path)
    fine = np.linspace(300.0, 1000.0, 70_001)
    # falls with wavelength
    wavelength = np.interp(-data["tau_rayleigh"], -bodhaine_optical_depth(fine), fine)
    order = np.argsort(wavelength)
    view = np.flatnonzero(data["vza"] <= 80.0)
    # 0, 90, 180 degrees from the sun, and by symmetry -90
    sides = np.array([0, 1, 2, 1])
    turns = data["raz"][sides] * np.array([1.0, 1.0, 1.0, -1.0])
    zenith, azimuth = (a.ravel() for a in np.meshgrid(data["vza"][view], turns, indexing="ij"))
    start = SkyModel(
        skyfit.Atmosphere(
            skyfit.Rayleigh(phase=RayleighPhase(0.0)), skyfit.Aerosol(0.15, phase=HenyeyGreenstein(0.6)), None
        )
    )
    for (h, haze), (a, albedo), (g, ground), (s, sun) in itertools.product(
        *(list(enumerate(map(float, data[name]))) for name in ("aod", "ssa_aerosol", "albedo", "sza"))
    ):
        if albedo == 1.0 or ground == 0.0 or not 0.0 < sun <= 75.0:
            continue
        truth = Truth(sun, haze, 0.0, albedo, float(data["g"]), ground)
        radiance = data["radiance"][order, h, a, g, s][:, view][:, :, sides].reshape(order.size, -1).T
        yield truth, _sky(radiance, noise, truth, zenith, azimuth, wavelength[order], path.name), start


def _sky(radiance, noise, truth, zenith_deg, azimuth_deg, wavelength_nm, source) -> skyfit.Sky:
    clean = radiance * np.asarray(extraterrestrial_irradiance(wavelength_nm, FWHM_NM), float)
    sun, zenith, azimuth = (np.radians(v) for v in (truth.sun_zenith_deg, zenith_deg, azimuth_deg))
    cosine = np.cos(sun) * np.cos(zenith) + np.sin(sun) * np.sin(zenith) * np.cos(azimuth)
    # the oracle's grid runs through the sun, and through the zenith four times
    usable = (cosine < np.cos(np.radians(CLEAR_OF_SUN_DEG))) & ~((zenith == 0.0) & (azimuth != 0.0))
    return skyfit.Sky(
        radiance=clean[None],
        sigma=noise * clean[None],
        usable=np.broadcast_to(usable[None, :, None], (1, *clean.shape)),
        view_zenith=zenith,
        view_azimuth=azimuth + 1.0,
        wavelength_nm=wavelength_nm,
        sun_zenith=np.array([sun]),
        sun_azimuth=np.array([1.0]),
        time=np.array(["NaT"], "datetime64[ns]"),
        pressure_pa=truth.pressure,
        fwhm_nm=FWHM_NM,
        source=source,
    )
