"""Long spectra: what a few wavelengths and coarse streams give is what streams give at each wavelength alone."""

from dataclasses import replace

import numpy as np
import pytest

import skyfit
from skyfit.transport import OrdersOfScattering
from skyfit.transport.orders.spectrum import spectral_nodes, SpectralNodes


VIEW = skyfit.Directions.from_degrees([0.0, 45.0, 60.0, 75.0, 30.0], [0.0, 90.0, 180.0, 20.0, 140.0])
# coarser than `normal` in what does not act on the spectrum
FEW = OrdersOfScattering(levels=12, nodes=8, orders=5, geometry="flat")
EACH = replace(FEW, spectral_nodes=0)
HAZE = skyfit.Atmosphere.from_optical_depth
SKIES = {
    "hazy": HAZE(0.2),
    "air": skyfit.Atmosphere(),
    "dust": HAZE(2.0, phase=skyfit.HenyeyGreenstein(0.85), angstrom_exponent=0.1),
    "vegetation": HAZE(0.3).replace(ground=skyfit.Ground(0.05, 0.0, 0.5)),
    "much ozone": HAZE(0.1).replace(ozone=skyfit.Ozone(500.0)),
    "two modes": skyfit.Atmosphere(aerosol=skyfit.TwoModeAerosol(0.4)),
    "two hazes": HAZE(0.2).replace(dust=skyfit.Aerosol(0.1, 0.1, profile=skyfit.Levels.elterman_1968())),
}
# seed: low, high, count
GRIDS = [(380.0, 780.0, 41), (300.0, 1100.0, 60), (500.0, 520.0, 30)]
MORE = [(310.0, 345.0, 50), (350.0, 1000.0, 70), (400.0, 700.0, 33), (320.0, 620.0, 55), (640.0, 1090.0, 40)]


def scene_of(wavelength, sun=60.0):
    return skyfit.Scene.from_degrees(sun, VIEW, wavelength, 140.0)


def random_grid(low, high, count):
    inside = np.random.default_rng(count).uniform(low, high, count - 2)
    return np.sort(np.r_[low, inside, high])


PAIRS = [("hazy", grid) for grid in (*GRIDS[1:], *MORE)] + [
    (name, grid) for name in list(SKIES)[1:] for grid in GRIDS[:2]
]


@pytest.mark.parametrize("name, grid", [("hazy", GRIDS[0]), *(pytest.param(*p, marks=pytest.mark.slow) for p in PAIRS)])
def test_a_wavelength_has_the_radiance_that_it_has_alone(x64, name, grid):
    wavelength = random_grid(*grid)
    assert spectral_nodes(SKIES[name], scene_of(wavelength), None) is not None
    # the last five nanometres before ozone's table ends, where it dims the beam a thousandfold, are the worst
    limit = np.where(wavelength < 305.0, 2e-3, 1e-3)[None]
    for sun in (25.0, 70.0):
        each = EACH.radiance(SKIES[name], scene_of(wavelength, sun))
        assert np.all(np.abs(FEW.radiance(SKIES[name], scene_of(wavelength, sun)) / each - 1.0) < limit)


@pytest.mark.filterwarnings("ignore::skyfit.LowSunWarning")
def test_no_direction_runs_away_in_haze_under_a_low_sun(x64):
    """Coarse streams swing about no light there: their ratio alone was ten times off in some views."""
    random, wavelength = np.random.default_rng(3), np.arange(380.0, 781.0, 10.0)
    view = skyfit.Directions(np.arccos(random.uniform(0.05, 1.0, 200)), random.uniform(0.0, np.pi, 200))
    haze = HAZE(0.42, phase=skyfit.HenyeyGreenstein(0.82)).replace(ground=skyfit.Ground(0.9))
    scene = skyfit.Scene.from_degrees(82.3, view, wavelength, irradiance="unit")
    each = EACH.radiance(haze, scene)
    np.testing.assert_allclose(replace(FEW, spectral_nodes=8).radiance(haze, scene), each, rtol=5e-3)


@pytest.mark.slow
def test_a_ground_given_at_each_wavelength_may_have_edges(x64):
    wavelength = random_grid(380.0, 780.0, 41)
    ground = skyfit.Ground(np.where(wavelength < 550.0, 0.02, 0.9))
    atmosphere, scene = HAZE(0.2).replace(ground=ground), scene_of(wavelength)
    np.testing.assert_allclose(FEW.radiance(atmosphere, scene), EACH.radiance(atmosphere, scene), rtol=1e-3)


def test_how_many_wavelengths_are_solved():
    """12 from 380 to 780 nm, 24 from 300 to 1100 nm; each where they are few, views many or a gas has bands."""
    visible, wide = np.linspace(380.0, 780.0, 81), np.linspace(300.0, 1100.0, 801)
    assert spectral_nodes(HAZE(0.2), scene_of(visible), None) == SpectralNodes(8, 4)
    assert spectral_nodes(HAZE(0.2), scene_of(wide), None) == SpectralNodes(16, 8)
    assert spectral_nodes(HAZE(0.2), scene_of(np.linspace(440.0, 870.0, 16)), None) is None
    assert spectral_nodes(HAZE(0.2), scene_of(wide), 0) is None
    # many views cost more than the sweeps that are saved
    dome = skyfit.Scene.from_degrees(60.0, skyfit.hemisphere(400), visible)
    assert spectral_nodes(HAZE(0.2), dome, None) is None
    bands = skyfit.Gas(1.0, [300.0, 700.0, 720.0, 1100.0], [0.0, 0.0, 0.3, 0.0], skyfit.Exponential(2000.0))
    assert spectral_nodes(HAZE(0.2).replace(water=bands), scene_of(wide), None) is None


def test_ultraviolet_beside_it_changes_no_other_wavelength(x64):
    """shared/faults/f01_uv_in_scene.py: 450 nm changed by 10 % with 300 to 340 nm in the scene."""
    solver, atmosphere = OrdersOfScattering.draft(), HAZE(0.2)
    wavelength = np.r_[np.arange(300.0, 341.0, 5.0), np.arange(350.0, 1101.0, 25.0)]
    with_it = solver.radiance(atmosphere, scene_of(wavelength, 80.0))[:, wavelength == 450.0]
    alone = solver.radiance(atmosphere, scene_of(np.array([425.0, 450.0, 475.0]), 80.0))[:, 1:2]
    np.testing.assert_allclose(with_it, alone, rtol=1e-3)
