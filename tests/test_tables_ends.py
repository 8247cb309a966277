"""No table goes on beyond its ends in silence, and no solver beyond its suns."""

import warnings

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import skyfit
from skyfit import LowSunWarning
from skyfit.atmosphere import droplet_phase
from skyfit.light import extraterrestrial_irradiance, observer_weights
from skyfit.transport import check_scene, low_sun, SOLVERS


VIEW = skyfit.Directions.from_degrees([0.0, 45.0], [0.0, 90.0])
GAS = skyfit.Gas(1.0, [400.0, 500.0, 600.0], [0.2, 0.1, 0.0], skyfit.Exponential(8e3))
HALF, LOBE = jnp.array([0.5]), skyfit.HenyeyGreenstein(0.8)
# a call with wavelengths, and the first and the last that it knows
TABLES = {
    "gas": (GAS.optical_depth_at, 400.0, np.inf),
    "ozone": (skyfit.Ozone().optical_depth_at, 300.0, np.inf),
    "ozone of the paper": (skyfit.Ozone(table="preetham").optical_depth_at, 300.0, np.inf),
    "fog": (skyfit.Droplets.fog(phase=LOBE).optical_depth_at, 300.0, 1100.0),
    "wet haze": (skyfit.Droplets.wet_haze(phase=LOBE).optical_depth_at, 400.0, 700.0),
    "fog's phase": (lambda nm: droplet_phase("fog").at_haversine(HALF, nm), 300.0, 1100.0),
    "wet haze's phase": (lambda nm: droplet_phase("wet_haze").at_haversine(HALF, nm), 400.0, 700.0),
    "Bullrich": (lambda nm: skyfit.Tabulated.bullrich().at_haversine(HALF, nm), 300.0, 1100.0),
    "spheres": (skyfit.TwoModeAerosol(0.1).optical_depth_at, 300.0, 1100.0),
    "spheres' phase": (lambda nm: skyfit.TwoModeAerosol(0.1).phase.at_haversine(HALF, nm), 300.0, 1100.0),
    "Hoffman": (lambda nm: skyfit.hoffman_haze("light fog", nm), 300.0, 1100.0),
    "the sun": (extraterrestrial_irradiance, 300.0, 1100.0),
    "the paper's sun": (lambda nm: extraterrestrial_irradiance(nm, source="preetham"), 380.0, 750.0),
    "daylight": (lambda nm: skyfit.daylight(0.31, 0.33, nm), 300.0, 830.0),
    "the sun's gases": (lambda nm: skyfit.Sunlight(2.0).factors(0.5, nm), 300.0, 1100.0),
    "response": (lambda nm: skyfit.Response(np.asarray(nm), np.ones((1, len(nm)))), 300.0, 1100.0),
}


@pytest.mark.parametrize("name", TABLES)
def test_tables_refuse_what_is_beyond_their_ends(x64, name):
    call, first, last = TABLES[name]
    call(jnp.array([first, min(last, 5000.0)]))
    for beyond in (first - 1.0, last + 1.0):
        if np.isfinite(beyond):
            with pytest.raises(ValueError, match=f"^`wavelength_nm` must be .* nm, got {beyond:g} "):
                call(jnp.array([beyond]))


def test_a_gas_that_ends_in_nothing_is_nothing_beyond():
    np.testing.assert_array_equal(GAS.optical_depth_at(jnp.array([600.0, 4000.0])), 0.0)
    # a traced wavelength has the end's value, as the class says
    assert float(jax.jit(lambda nm: GAS.optical_depth_at(nm))(jnp.array([300.0]))[0]) == pytest.approx(0.2)


@pytest.mark.parametrize("name", SOLVERS)
def test_solvers_refuse_wavelengths_that_a_constituent_does_not_know(name):
    """Ozone at 254 nm has 30 times the optical depth that its table ends with."""
    solver = SOLVERS[name].normal("flat") if name == "uniform" else SOLVERS[name].normal()
    scene = skyfit.Scene.from_degrees(30.0, VIEW, [254.0, 400.0], irradiance="unit")
    for call in (solver.radiance, solver.fluxes):
        with pytest.raises(ValueError, match="`wavelength_nm` must be at least 300 nm, got 254 .*Ozone"):
            call(skyfit.Atmosphere.from_optical_depth(0.1), scene)
    given = skyfit.Prescribed(jnp.array([32.0, 0.0]), skyfit.OzoneLayer())
    check_scene(solver, skyfit.Atmosphere.from_optical_depth(0.1).replace(ozone=given), scene)


# the last sun and the first that is flagged, degrees; None where nothing is
SUNS = {
    ("orders", "flat"): (85.0, 80.0), ("orders", "spherical"): (90.0, 85.0), ("double", "flat"): (85.0, 80.0),
    ("double", "spherical"): (90.0, 85.0), ("single", "flat"): (85.0, 80.0), ("single", "spherical"): (180.0, None),
    ("shells", "flat"): (85.0, 80.0), ("shells", "spherical"): (90.0, 85.0), ("uniform", "flat"): (90.0, 85.0),
}  # fmt: skip


@pytest.mark.parametrize("name, geometry", SUNS)
def test_solvers_say_which_suns_they_know(name, geometry):
    solver, (last, flagged) = SOLVERS[name].draft(geometry), SUNS[name, geometry]
    atmosphere = skyfit.Atmosphere.from_optical_depth(0.1)

    def scene(sun):
        return skyfit.Scene.from_degrees(sun, VIEW, [550.0])

    if last < 180.0:
        beyond = scene(last + 0.5)
        calls = [solver.radiance, solver.fluxes, lambda a, s: skyfit.upsample(solver, a, s)]
        calls += [lambda a, s: solver.path(a, s, jnp.ones(2))] if hasattr(solver, "path") else []
        for call in calls:
            with pytest.raises(ValueError, match=f"`sun_zenith` must be .*{geometry}: suns to {last:g} degrees"):
                call(atmosphere, beyond)
    if flagged is not None:
        for sun in (flagged + 0.1, last):
            with pytest.warns(LowSunWarning, match=f"may be .* % off from {flagged:g} degrees on"):
                check_scene(solver, atmosphere, scene(sun))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_scene(solver, atmosphere, scene(last - 5.5 if flagged else last))
    # traced suns pass unseen, as in a fit
    assert low_sun(solver, 0.3) is None
    jax.eval_shape(lambda s: solver.radiance(atmosphere, s), scene(min(last + 1.0, 100.0)))


def test_the_observers_weights_are_none_beyond_360_to_830_nm():
    weights = observer_weights(np.array([300.0, 340.0, 350.0, 400.0, 700.0, 830.0, 840.0, 900.0]))
    np.testing.assert_array_equal(weights[[0, 1, -1]], 0.0)
