"""What is said of skies that are in order: nothing, or at most a doubt; and what of residuals that are not."""

from dataclasses import replace

import numpy as np
import pytest
from skies import SMALL

import skyfit
from skyfit.light import extraterrestrial_irradiance
from skyfit.measured.quality.oddities import _air, examine
from skyfit.measured.quality.plausibility import doubts, poor_fit
from skyfit.measured.quality.sun_agreement import sun_agreement
from skyfit.retrieve import Fitted, start_model, with_values


NM = np.array([400.0, 500.0, 650.0, 870.0])
DOME = skyfit.hemisphere(40)
NAMES = ("aerosol_optical_depth", "asymmetry", "ground_albedo")


def simulated(sun_deg, depth=0.2, asymmetry=0.65, ground=0.1, zenith=DOME.zenith, azimuth=DOME.azimuth) -> skyfit.Sky:
    """By all orders of scattering, with 2 % of noise; 40 directions, the sun in the east."""
    zenith, azimuth = (np.broadcast_to(np.asarray(angle, float), 40) for angle in (zenith, azimuth))
    shape = (1, 40, NM.size)
    sky = skyfit.Sky(
        radiance=np.ones(shape), sigma=None, usable=np.ones(shape, bool), view_zenith=zenith,
        view_azimuth=azimuth, wavelength_nm=NM, sun_zenith=np.radians([sun_deg]), sun_azimuth=np.radians([90.0]),
        time=np.array(["NaT"], "datetime64[ns]"),
    )  # fmt: skip
    model = with_values(start_model(NAMES, 101325.0), NAMES, (depth, asymmetry, ground))
    clean = skyfit.predict(Fitted(sky.time, (model,), SMALL["flat"], np.nan, NM, np.ones((1, NM.size))), sky)
    return replace(sky, radiance=clean * (1.0 + 0.02 * np.random.default_rng(2).standard_normal(shape)))


@pytest.mark.parametrize("sun", [2.0, 30.0, 60.0, 80.0, 88.0])
@pytest.mark.parametrize("depth", [0.01, 0.3, 2.0])
@pytest.mark.parametrize("ground", [0.0, 0.9])
def test_clear_and_hazy_skies_raise_no_doubt(sun, depth, ground):
    sky = simulated(sun, depth, ground=ground)
    assert examine(sky, sky.usable) == ()
    # an eclipse may be doubted, and is fitted all the same
    dim = replace(sky, radiance=0.1 * sky.radiance)
    assert all("darker" in sentence for sentence in examine(dim, dim.usable))


def test_the_last_light_over_black_ground_is_no_night():
    for depth in (0.0, 0.05, 0.5):
        sky = simulated(89.8, depth, ground=0.0)
        assert all("darker" in sentence for sentence in examine(sky, sky.usable))


SWEEP = np.radians(np.linspace(4.0, 180.0, 40))
SERIES = {
    "almucantar": {"zenith": np.radians(60.0), "azimuth": 0.5 * np.pi + SWEEP},
    "half an almucantar's aureole": {"zenith": np.radians(60.0), "azimuth": 0.5 * np.pi + 0.2 * SWEEP},
    "principal plane": {
        "zenith": np.radians(np.abs(np.linspace(-80.0, 80.0, 40))),
        "azimuth": 0.5 * np.pi * np.where(np.arange(40) < 20, 3.0, 1.0),
    },
    "half of it": {"zenith": np.radians(np.linspace(0.0, 80.0, 40)), "azimuth": 0.5 * np.pi},
    "across it": {"zenith": np.radians(np.linspace(0.0, 80.0, 40)), "azimuth": 0.0},
    "a small part of the sky": {"zenith": np.radians(np.linspace(40.0, 50.0, 40)), "azimuth": 0.3 + SWEEP / 9.0},
}


@pytest.mark.parametrize("kind", SERIES)
@pytest.mark.parametrize("depth", [0.05, 0.5, 2.0])
def test_scans_of_a_line_raise_no_doubt(kind, depth):
    sky = simulated(60.0, depth, **SERIES[kind])
    assert examine(sky, sky.usable) == ()


def test_one_direction_and_one_wavelength_are_told_and_not_refused():
    sky = simulated(60.0, zenith=0.0, azimuth=0.0)
    one = replace(sky, usable=np.arange(40)[None, :, None] + 0 * NM.astype(int)[None, None] == 3)
    (sentence,) = examine(one, one.usable)
    assert "too few directions" in sentence
    one = simulated(60.0)
    (sentence,) = examine(one, one.usable & (NM == 500.0))
    assert "500-500 nm" in sentence
    assert examine(sky, np.zeros(sky.usable.shape, bool)) == ()


def test_the_measured_and_the_shipped_skies_raise_no_doubt(shared, checkout):
    measured = shared / "measured" / "kider2014"
    place = {"latitude": 42.443449, "longitude": -76.481962, "utc_offset": -4, "altitude": 325.0}
    day, sample = skyfit.read(measured / "2013-05-27.nc"), skyfit.read(checkout / "data" / "skies" / "sample.nc")
    scan = skyfit.read(measured / "2013-05-27___10.00.00", **place)
    assert len(day.notes) == 2 and "not used: global_horizontal" in day.notes[1] and sample.notes == ()
    for sky in (day, sample, scan):
        assert examine(sky, sky.usable) == ()
    # the instrument's own north is off by 8 degrees, which is less than what is doubted
    assert len(scan.notes) == 2


# flat air against flat air
@pytest.mark.filterwarnings("ignore::skyfit.LowSunWarning")
@pytest.mark.parametrize("sun", [10.0, 50.0, 85.0])
def test_air_alone_is_single_scattering(sun):
    sky = simulated(sun)
    solver, air = (
        skyfit.SingleScattering(32, "flat"),
        skyfit.Atmosphere(skyfit.Rayleigh(), None, None, skyfit.Ground(0.0)),
    )
    scene = skyfit.Scene.from_degrees(sun, DOME, NM, 90.0, irradiance="unit")
    # the horizon is cut at 0.02, the phase function has no depolarisation
    high = np.asarray(DOME.zenith) < 1.5
    np.testing.assert_allclose(_air(sky, 0)[high], np.asarray(solver.radiance(air, scene))[high], rtol=0.04)


def test_the_sun_itself_is_counted():
    sky = simulated(60.0, zenith=np.radians(60.0), azimuth=0.5 * np.pi + SWEEP - SWEEP[0])
    light = sky.radiance.copy()
    # the disc over a field of view of 5 degrees: 14700 of the irradiance times (0.53 / 5)^2 and the air's 0.5
    light[:, 0] = 80.0 * np.asarray(extraterrestrial_irradiance(NM))
    said = " ".join(examine(replace(sky, radiance=light), sky.usable))
    assert "4 samples are brighter than any sky" in said


def test_residuals_are_judged_by_the_light_and_by_sigma():
    sky = simulated(40.0)
    even = replace(sky, radiance=np.full(sky.radiance.shape, 0.1))
    for share, poor in ((0.0, False), (0.2, False), (0.24, False), (0.26, True), (3.0, True), (np.nan, True)):
        model = even.radiance * (1.0 + share)
        assert poor_fit(even, model, even.usable).tolist() == [poor]
        said = doubts(even, model, even.usable, np.array([1.0]))
        assert len(said) == poor and all("poor fit" in sentence for sentence in said)
    # what is not used has no part in it
    some = even.usable & (NM != 500.0)
    model = np.where(NM == 500.0, np.nan, even.radiance)
    light = np.where(NM == 500.0, np.nan, even.radiance)
    assert poor_fit(replace(even, radiance=light, usable=some), model, some).tolist() == [False]
    dark = replace(even, radiance=0.0 * even.radiance)
    assert poor_fit(dark, dark.radiance, dark.usable).tolist() == [True]
    for chi_square, words in ((0.3, []), (8.9, []), (9.1, ["3.02 times"]), (1e6, ["1e+03 times"])):
        said = doubts(even, even.radiance, even.usable, np.array([chi_square]))
        stated = doubts(replace(even, sigma=0.01 * even.radiance), even.radiance, even.usable, np.array([chi_square]))
        assert len(stated) == (chi_square > 4.0)
        assert len(said) == len(words) and all(word in sentence for word, sentence in zip(words, said, strict=True))


NOON = np.array(["2024-06-01T08:00", "2024-06-01T11:00"], "datetime64[ns]")
# over 48 N, 11 E, to a degree; the ephemeris itself is tested in test_asd.py
SUN = {"zenith": np.array([46.3, 26.0]), "azimuth": np.array([106.4, 172.6])}


@pytest.mark.parametrize(
    ("zenith", "azimuth", "hours", "cause"),
    [
        (lambda z: z, lambda a: a, 0, ""),
        (lambda z: z + 2.5, lambda a: a + 5.0, 0, ""),
        (lambda z: z, lambda a: a, 2, "UTC+2 h"),
        (lambda z: z, lambda a: a, -6, "UTC-6 h"),
        (lambda z: 90.0 - z, lambda a: a, 0, "elevations"),
        (lambda z: z, lambda a: a + 180.0, 0, "from south"),
        (lambda z: z, lambda a: -a, 0, "counter-clockwise"),
        (lambda z: np.radians(z), lambda a: np.radians(a), 0, "radians"),
        (lambda z: z + 7.0, lambda a: a, 0, "another place"),
    ],
)
def test_the_stated_sun_is_compared_with_time_and_place(zenith, azimuth, hours, cause):
    time = NOON + np.timedelta64(hours, "h")
    said = sun_agreement(zenith(SUN["zenith"]), azimuth(SUN["azimuth"]), time, 48.0, 11.0)
    assert cause in said and bool(said) == bool(cause)
    turned = sun_agreement(zenith(SUN["zenith"]), azimuth(SUN["azimuth"]) + 70.0, time, 48.0, 11.0, turned=True)
    assert bool(turned) == (bool(cause) and cause not in ("from south", "counter-clockwise"))
