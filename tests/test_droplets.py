"""The droplet table against Mie theory and published limits; fog as a constituent."""

import importlib

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import skyfit
from skyfit.atmosphere import droplet_phase, Droplets, HenyeyGreenstein
from skyfit.tables import read_table
from skyfit.transport import Shells


KINDS = ("fog", "wet_haze")
BANDS = np.array([400.0, 450.0, 500.0, 550.0, 600.0, 700.0])


@pytest.mark.parametrize("kind", KINDS)
def test_the_table_is_normalised_and_has_its_asymmetry(x64, kind):
    """Integrated between its own angles, as printed: 1, and the mean cosine of Mie's series."""
    table, means = read_table("droplets.csv"), read_table("droplet_efficiencies.csv")
    np.testing.assert_array_equal(means["wavelength_nm"], BANDS)
    fine = np.radians(np.linspace(0.0, 180.0, 200001))
    for band, asymmetry in zip(BANDS, means[f"{kind}_asymmetry"], strict=True):
        phase = np.exp(np.interp(fine, np.radians(table["angle_deg"]), table[f"{kind}_{band:.0f}nm"]))
        around = 2.0 * np.pi * np.sin(fine) * phase
        assert np.trapezoid(around, fine) == pytest.approx(1.0, abs=5e-3)
        assert np.trapezoid(around * np.cos(fine), fine) == pytest.approx(asymmetry, abs=5e-3)


@pytest.mark.parametrize("kind", KINDS)
def test_the_phase_function_is_normalised_with_the_tables_moments(x64, kind):
    phase, means = droplet_phase(kind), read_table("droplet_efficiencies.csv")
    moments = np.asarray(phase.moments(2, jnp.asarray(BANDS)))
    np.testing.assert_allclose(moments[0], 1.0, rtol=1e-12)
    np.testing.assert_allclose(moments[1], means[f"{kind}_asymmetry"], atol=6e-3)
    angle = np.pi * (np.arange(4000) + 0.5) / 4000
    values = np.asarray(phase.at_haversine(jnp.asarray(np.sin(0.5 * angle) ** 2), jnp.asarray(BANDS)))
    np.testing.assert_allclose(2.0 * np.pi * np.pi / 4000 * np.sin(angle) @ values, 1.0, atol=5e-3)


def test_fog_is_forward_scattering_and_nearly_colourless():
    """Asymmetry 0.83-0.88 of clouds and fog (Hansen & Travis 1974); Q toward 2 (van de Hulst 1957), within 8 %."""
    means = read_table("droplet_efficiencies.csv")
    assert np.all((means["fog_asymmetry"] > 0.83) & (means["fog_asymmetry"] < 0.88))
    assert np.all((means["fog_efficiency"] > 2.0) & (means["fog_efficiency"] < 2.16))
    # Klassen 1987, sec. 12: the selectivity of fog is less than 5 %
    assert means["fog_efficiency"].max() / means["fog_efficiency"].min() < 1.05
    # the same section of haze: it still has some
    assert means["wet_haze_efficiency"].max() / means["wet_haze_efficiency"].min() > 1.1


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_the_table_is_what_the_script_computes(kind):
    pytest.importorskip("miepython")
    script = importlib.import_module("experiments.tables.make_droplet_table")
    angle = np.array([0.0, 20.0, 130.0, 180.0])
    phase, efficiency, asymmetry = script.mixture(kind, 600.0, 1.332, angle)
    means, table = read_table("droplet_efficiencies.csv"), read_table("droplets.csv")
    assert efficiency == pytest.approx(means[f"{kind}_efficiency"][4], rel=1e-5)
    assert asymmetry == pytest.approx(means[f"{kind}_asymmetry"][4], rel=1e-5)
    rows = np.searchsorted(table["angle_deg"], angle)
    np.testing.assert_allclose(np.log(phase), table[f"{kind}_600nm"][rows], atol=1e-5)


def test_one_size_of_droplets_is_miepythons_own():
    """Written down from the amplitudes: the normalisation that the script asks for is the right one."""
    mie = pytest.importorskip("miepython")
    x, weight = np.polynomial.legendre.leggauss(600)
    phase = mie.i_unpolarized(1.333 + 0j, 51.4, x, norm="one")
    assert 2.0 * np.pi * weight @ phase == pytest.approx(1.0, rel=1e-9)
    extinction, scattering, _, asymmetry = mie.efficiencies_mx(1.333 + 0j, 51.4)
    assert 2.0 * np.pi * (weight * x) @ phase == pytest.approx(asymmetry, rel=1e-9)
    assert extinction == pytest.approx(scattering, rel=1e-9)
    assert mie.efficiencies_mx(1.333 + 0j, 5000.0)[1] == pytest.approx(2.0, abs=0.02)


def test_a_fogs_depth_is_its_coefficient_times_its_thickness(x64):
    fog = Droplets.fog(0.03, 80.0)
    depth = np.asarray(fog.optical_depth_at(jnp.array([550.0, 400.0, 700.0, 900.0])))
    means = read_table("droplet_efficiencies.csv")["fog_efficiency"]
    np.testing.assert_allclose(depth, 2.4 * means[[3, 0, 5, 5]] / means[3], rtol=1e-12)
    np.testing.assert_array_equal(fog.single_scattering_albedo_at(jnp.array([550.0, 700.0])), 1.0)
    assert float(fog.profile.density(jnp.asarray(0.0))) == pytest.approx(1.0 / 80.0)
    assert float(fog.profile.column_above(jnp.asarray(80.0))) == 0.0
    given = HenyeyGreenstein(0.85)
    assert Droplets.fog(phase=given).phase is given and Droplets.wet_haze(phase=given).phase is given
    with pytest.raises(ValueError, match="`kind`"):
        droplet_phase("snow")


def test_fog_is_brighter_toward_the_sun_and_has_finite_gradients(x64):
    """Klassen's Figures 15 to 18: little comes back toward a lamp behind the eye, much from a sun ahead."""
    view = skyfit.Directions.from_degrees([90.0, 90.0], [0.0, 180.0])
    wavelength = np.array([450.0, 550.0, 650.0])
    scene = skyfit.Scene.from_degrees(60.0, view, wavelength, irradiance="unit", height=2.0)

    def inscatter(parameters):
        atmosphere = skyfit.Atmosphere(aerosol=Droplets.fog(*parameters))
        return Shells(geometry="flat").path(atmosphere, scene, jnp.array([50.0, 50.0])).inscatter

    values = np.asarray(inscatter((0.02, 60.0)))
    assert np.all(values[0] > 5.0 * values[1]) and np.all(values > 0.0)
    assert values[0].max() / values[0].min() < 1.5
    slope = jax.jacfwd(inscatter)((jnp.asarray(0.02), jnp.asarray(60.0)))
    around = (0.02 + 1e-7, 60.0), (0.02 - 1e-7, 60.0), (0.02, 60.001), (0.02, 59.999)
    step = [np.asarray(inscatter(v)) for v in around]
    for found, central in zip(slope, ((step[0] - step[1]) / 2e-7, (step[2] - step[3]) / 2e-3), strict=True):
        np.testing.assert_allclose(found, central, atol=1e-5 * np.abs(central).max())


def test_other_solvers_take_fog_too():
    """Their quadrature runs over the jump at its top: many nodes, few per cent."""
    scene = skyfit.Scene.from_degrees(40.0, skyfit.Directions.from_degrees([30.0], [0.0]), np.array([450.0, 650.0]))
    foggy = skyfit.Atmosphere(aerosol=Droplets.fog(0.001, 500.0))
    sky = skyfit.SingleScattering(96, "flat").radiance(foggy, scene)
    np.testing.assert_allclose(sky, Shells(geometry="flat").radiance(foggy, scene), rtol=0.05)
