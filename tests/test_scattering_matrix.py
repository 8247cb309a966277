"""Scattering matrices that are given as tables."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from skies import ONE, SMALL, unit_scene, views

from skyfit.atmosphere import Atmosphere, Exponential, Ground, HenyeyGreenstein, Prescribed, RayleighPhase, Tabulated
from skyfit.numerics import hat_weights


# uneven, as tables are
ANGLE = np.radians(
    [0.0, 3.0, 8.0, 15.0, 25.0, 38.0, 50.0, 63.0, 77.0, 90.0, 101.0, 114.0, 130.0, 145.0, 160.0, 172.0, 180.0]
)
BANDS = np.array([450.0, 650.0])


def elements(phase, angle=ANGLE):
    """P11, P12, P22 and P33 `[angle, band]` of another phase function, in a unit of its own."""
    half = jnp.asarray(np.sin(0.5 * angle) ** 2)
    p11 = 7.0 * np.asarray(phase.at_haversine(half, jnp.asarray(BANDS))) * np.ones((1, 2))
    f12, f22, f33 = np.asarray(phase.matrix(half, jnp.asarray(BANDS))) * np.ones((1, 1, 2))
    return p11, f12 * p11, f22 * p11, f33 * p11


@pytest.mark.parametrize("phase", [RayleighPhase(0.0), RayleighPhase(0.1), HenyeyGreenstein(0.5, 0.6)])
def test_a_table_of_few_angles_has_the_matrix_that_it_was_made_of(x64, phase):
    """Values and moments within what splines leave of seventeen angles."""
    p11, p12, p22, p33 = elements(phase)
    table = Tabulated.from_matrix(ANGLE, BANDS, p11, p12, p33, p22)
    between = jnp.asarray(np.sin(0.5 * np.radians(np.linspace(0.5, 179.5, 70))) ** 2)
    nm = jnp.asarray([450.0, 500.0])
    np.testing.assert_allclose(
        table.at_haversine(between, nm), phase.at_haversine(between, nm) + np.zeros((1, 2)), rtol=2e-3
    )
    np.testing.assert_allclose(table.matrix(between, nm), phase.matrix(between, nm) + np.zeros((1, 1, 2)), atol=2e-3)
    np.testing.assert_allclose(table.moments(6, nm), phase.moments(6, nm) + np.zeros((1, 2)), atol=2e-4)
    np.testing.assert_allclose(
        table.matrix_moments(6, nm), phase.matrix_moments(6, nm) + np.zeros((1, 1, 2)), atol=5e-4
    )


def test_spheres_need_no_p22_and_one_wavelength_is_a_table():
    p11, p12, _, p33 = (p[:, :1] for p in elements(HenyeyGreenstein(0.5, 0.6)))
    table = Tabulated.from_matrix(ANGLE, [550.0], p11, p12, p33)
    half = jnp.asarray(np.sin(0.5 * ANGLE) ** 2)
    np.testing.assert_array_equal(table.matrix(half, jnp.asarray(ONE))[1], 1.0)
    np.testing.assert_allclose(table.moments(1, jnp.asarray(ONE)), 1.0, rtol=1e-6)
    np.testing.assert_array_equal(hat_weights(jnp.array([1.0, 2.0]), jnp.array([1.5])), 1.0)
    with pytest.raises(ValueError, match="all that Tabulated knows"):
        Prescribed(np.ones(1), Exponential(1e3), table).check_wavelengths(np.array([600.0]))


def test_a_table_without_a_matrix_is_polarised_like_air(x64):
    given = Tabulated(ANGLE, BANDS, np.log(elements(HenyeyGreenstein(0.5))[0]), 0.4)
    half = jnp.asarray(np.sin(0.5 * ANGLE) ** 2)
    expected = HenyeyGreenstein(0.5, 0.4).matrix(half, jnp.asarray(BANDS))
    np.testing.assert_allclose(given.matrix(half, jnp.asarray(BANDS)), expected, rtol=1e-9)


def test_the_table_of_the_intercomparison_has_its_own_moments(x64, shared):
    """Of water-soluble aerosol: splines through 68 angles are what the expansion in 32 degrees is."""
    path = shared / "oracles" / "iprt" / "waso.npz"
    if not path.is_file():
        pytest.skip("../shared/oracles/iprt is absent: it holds the results of MYSTIC, which are not shipped")
    data = np.load(path)
    order = np.argsort(data["theta_0"])
    angle = np.radians(data["theta_0"][order])
    angle[-1] = np.pi
    p11, p12, p33 = (data[f"phase_{i}"][order][:, None] for i in range(3))
    table = Tabulated.from_matrix(angle, [350.0], p11, p12, p33)
    expected = data["pmom_0"] / (2.0 * np.arange(32) + 1.0)
    np.testing.assert_allclose(table.moments(32, jnp.array([350.0]))[:, 0], expected, atol=2e-5)


def test_slopes_by_a_table_are_finite():
    p11, p12, _, p33 = elements(HenyeyGreenstein(0.5, 0.6))
    table = Tabulated.from_matrix(ANGLE, BANDS, p11, p12, p33)
    half = jnp.asarray(np.sin(0.5 * ANGLE) ** 2, float)
    slope = jax.grad(
        lambda t: jnp.sum(t.matrix_moments(5, jnp.array([500.0]))) + jnp.sum(t.matrix(half, jnp.array([500.0])))
    )
    found = jax.tree.leaves(slope(table))
    assert all(np.all(np.isfinite(leaf)) for leaf in found) and any(np.any(leaf != 0.0) for leaf in found)


@pytest.mark.parametrize(
    "changed, message",
    [
        ({"angle": ANGLE[1:]}, "`angle` must reach from 0 to pi, got 0.05"),
        ({"angle": ANGLE[::-1]}, "`angle` must increase"),
        ({"p11": 0.0}, "`p11` must be positive, got 0"),
    ],
)
def test_a_matrix_that_cannot_be_is_refused(changed, message):
    p11, p12, _, p33 = elements(RayleighPhase(0.0))
    angle = changed.get("angle", ANGLE)
    with pytest.raises(ValueError, match=f"^{message}"):
        Tabulated.from_matrix(
            angle, BANDS, changed.get("p11", 1.0) * p11[: len(angle)], p12[: len(angle)], p33[: len(angle)]
        )


def test_a_matrix_of_another_shape_is_refused():
    with pytest.raises(
        ValueError, match=r"^`matrix_ratio` must have three elements of the shape of `log_value`, \(17, 2\)"
    ):
        Tabulated(ANGLE, BANDS, np.zeros((17, 2)), matrix_ratio=np.zeros((3, 16, 2)))


def test_an_atmosphere_of_one_band_is_solved_there(x64):
    """The moments of a table reach the solver: haze that polarises as air is told to is the same haze."""
    phase = HenyeyGreenstein(0.5, 0.6)
    p11, p12, p22, p33 = (p[:, :1] for p in elements(phase, np.linspace(0.0, np.pi, 181)))
    table = Tabulated.from_matrix(np.linspace(0.0, np.pi, 181), ONE, p11, p12, p33, p22)
    scene = unit_scene(50.0, views([10.0, 60.0], [0.0, 90.0, 150.0]))
    skies = [
        SMALL["flat"].radiance(
            Atmosphere(None, Prescribed(np.array([0.3]), Exponential(2000.0), p, 0.9), None, Ground(0.2)), scene
        )
        for p in (phase, table)
    ]
    np.testing.assert_allclose(skies[1], skies[0], rtol=1e-4)
