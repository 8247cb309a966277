"""Suns, views, depths and phase functions at the ends of their ranges, in both precisions."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from skies import (
    COLOURS,
    compiled_sky,
    hazy,
    names_of,
    ONE,
    sky_of,
    slow,
    SOLVERS,
    unit_scene,
    views,
)

import skyfit
from skyfit.atmosphere import Aerosol, Ozone, Rayleigh
from skyfit.transport import Spherical


# --- hard cases

# six in the sky, one of them into the sun of "plain"; at the horizon, under it, at the nadir
VIEW = skyfit.Directions(
    np.array([0.0, 0.52359878, 0.52359878, 1.0, 1.5, 1.56, 0.5 * np.pi, 1.6, 2.5, np.pi]),
    np.array([0.0, 0.3, 2.0, 1.0, 3.0, 0.3, 0.3, 2.0, 0.0, 0.0]),
)
STEP = float(np.spacing(np.float32(90.0)))
NOTHING = {"pressure": 0.0, "haze": 0.0, "ozone": 0.0}
HARD = {
    "plain": (30.0, {}),
    "sun at the zenith": (0.0, {}),
    "sun a step off the zenith": (1e-6, {}),
    "sun a step above the horizon": (90.0 - STEP, {}),
    "sun at the horizon": (90.0, {}),
    "sun a step below the horizon": (90.0 + STEP, {}),
    "sun at 85": (85.0, {}),
    "sun at 92": (92.0, {}),
    "sun at 96": (96.0, {}),
    "sun at the nadir": (180.0, {}),
    "optical depth 0": (30.0, NOTHING),
    "optical depth 0, sun at the horizon": (90.0, NOTHING),
    "optical depth 1e-12": (30.0, {"pressure": 1e-6, "haze": 1e-12, "ozone": 1e-9}),
    "optical depth 50": (30.0, {"haze": 50.0}),
    "optical depth 50, low sun": (89.0, {"haze": 50.0}),
    "optical depth 50, conservative": (30.0, {"haze": 50.0, "albedo": 1.0, "ground": 1.0}),
    "air of depth 50": (60.0, {"pressure": 5e7}),
    "no air": (30.0, {"pressure": 0.0}),
    "no haze": (30.0, {"haze": 0.0}),
    "no ozone": (30.0, {"ozone": 0.0}),
    "g 0": (30.0, {"asymmetry": 0.0}),
    "g 1e-4": (30.0, {"asymmetry": 1e-4}),
    "g 0.999": (30.0, {"asymmetry": 0.999}),
    "g 0.999 in thick haze": (30.0, {"asymmetry": 0.999, "haze": 2.0}),
    "g -0.9": (30.0, {"asymmetry": -0.9}),
    "ground black": (30.0, {"ground": 0.0}),
    "ground white": (30.0, {"ground": 1.0}),
    "haze black": (30.0, {"albedo": 0.0}),
    "haze white": (30.0, {"albedo": 1.0}),
    "haze black and no air": (30.0, {"albedo": 0.0, "pressure": 0.0}),
    "all white": (30.0, {"albedo": 1.0, "ground": 1.0, "ozone": 0.0}),
}


def hard_program(solver, reverse):
    """Radiances, fluxes and derivatives by the atmosphere and the sun's zenith angle: one program for all cases."""

    def fields(parameters):
        atmosphere, sun = parameters
        scene = skyfit.Scene(sun, 0.3, VIEW, COLOURS, jnp.ones(len(COLOURS)))
        if isinstance(solver, Spherical):
            # solved once, as radiance and fluxes each do
            field = solver.prepare(atmosphere, COLOURS, sun_zenith=sun, height=0.0)
            light, found = field.radiance(scene), field.fluxes(scene)
        else:
            light, found = solver.radiance(atmosphere, scene), solver.fluxes(atmosphere, scene)
        return {"radiance": light, "flux": jnp.stack([v for v in found if v is not None])}

    def forward(parameters):
        slopes, found = jax.jacfwd(lambda p: (fields(p),) * 2, has_aux=True)(parameters)
        return found, slopes

    def backward(parameters):
        def total(parameters):
            found = fields(parameters)
            return sum(map(jnp.sum, found.values())), found

        slopes, found = jax.grad(total, has_aux=True)(parameters)
        return found, {"all": slopes}

    return jax.jit(backward if reverse else forward)


def problems_of_hard_cases(solver, dtype, reverse=False):
    """One line for each case that fails: which rows (directions, or direct, diffuse, up) and which leaves."""
    with jax.enable_x64(dtype == "float64"):
        program, problems = hard_program(solver, reverse), []
        for case, (sun, changes) in HARD.items():
            parameters = jax.tree.map(lambda leaf: jnp.asarray(leaf, float), (hazy(**changes), np.radians(sun)))
            found, derivatives = program(parameters)
            for quantity, values in found.items():
                values = np.asarray(values)
                if not np.all(np.isfinite(values)):
                    problems.append(f"{case}: {quantity} not finite, first at {np.argwhere(~np.isfinite(values))[0]}")
                elif values.min() < -1e-6 * values.max():
                    problems.append(f"{case}: least {quantity} {values.min():.3g}, largest {values.max():.3g}")
            for quantity, slopes in derivatives.items():
                leaves = list(zip(names_of(slopes), map(np.asarray, jax.tree.leaves(slopes)), strict=True))
                bad = [leaf for leaf, slope in leaves if not np.all(np.isfinite(slope))]
                if bad:
                    rows = set() if reverse else {int(i[0]) for _, v in leaves for i in np.argwhere(~np.isfinite(v))}
                    where = f"in {len(bad)} leaves ({bad[0]}), rows {sorted(rows)}"
                    problems.append(f"{case}: gradient of {quantity} not finite {where}")
        return problems


@pytest.mark.parametrize(
    "name",
    [
        n if n in ("single spherical", "orders spherical", "uniform flat", "shells flat") else slow(n)
        for n in SOLVERS
        if n != "sphere spherical"
    ],
)
def test_hard_cases_have_finite_values_and_gradients(name):
    """In forward mode, by direction; what float64 may do differently the reverse mode below shows."""
    problems = problems_of_hard_cases(SOLVERS[name], "float32")
    assert not problems, "\n".join(problems)


@pytest.mark.parametrize(
    "name, dtype",
    [
        ("orders spherical", "float32"),
        ("orders spherical", "float64"),
        *(slow(name, "float32") for name in SOLVERS if name != "orders spherical"),
        # float32 has the narrower range, which is where these cases end
        *(
            slow(name, "float64")
            for name in ("single spherical", "uniform flat", "shells spherical", "sphere spherical")
        ),
    ],
)
def test_hard_cases_have_finite_reverse_gradients(name, dtype):
    problems = problems_of_hard_cases(SOLVERS[name], dtype, reverse=True)
    assert not problems, "\n".join(problems)


@pytest.mark.parametrize("name", SOLVERS)
def test_views_below_the_horizon_are_black_and_the_horizon_is_not(x64, name):
    sky = compiled_sky(name, hazy(), 0.8, np.radians([89.9, 90.001, 120.0]), 0.0)
    assert np.all(sky[0] > 0.0)
    np.testing.assert_array_equal(sky[1:], 0.0)


@pytest.mark.parametrize("name", SOLVERS)
def test_twilight_falls_smoothly_through_the_horizon(x64, name):
    """The sky of a sphere does not jump where the sun sets; a flat one is black behind it, and so is Klassen's.

    His shells know a sun above the horizon only.
    """
    above, below, later = (
        compiled_sky(name, hazy(), np.radians(sun), np.array([[0.0], [1.05]]), np.array([0.3, 1.9]))
        for sun in (90.0 - 1e-5, 90.0 + 1e-5, 93.0)
    )
    if name.endswith("flat") or name.startswith("shells"):
        np.testing.assert_array_equal(below, 0.0)
    else:
        np.testing.assert_allclose(below, above, rtol=1e-3)
        assert np.all(later > 0.0) and np.all(later < below)


@pytest.mark.parametrize("name", SOLVERS)
def test_an_absent_scatterer_leaves_a_black_sky(name):
    """No constituents, or only one that absorbs: radiance 0, the beam alone on the ground."""
    scene = unit_scene(60.0, views([0.0, 60.0], [0.0]))
    for atmosphere in (skyfit.Atmosphere(None, None, Ozone()), skyfit.Atmosphere(None, None, None)):
        np.testing.assert_array_equal(SOLVERS[name].radiance(atmosphere, scene), 0.0)
        flux = SOLVERS[name].fluxes(atmosphere, scene)
        np.testing.assert_array_equal(flux.diffuse_down, 0.0)
        depth = 0.0 if "ozone" not in atmosphere else float(Ozone().optical_depth_at(jnp.asarray(ONE, float))[0])
        expected = np.exp(-depth / np.cos(np.radians(60.0))) * np.cos(np.radians(60.0))
        # ozone lies high: curvature shortens its path by about 1 %
        np.testing.assert_allclose(flux.direct, expected, rtol=2e-3)


@pytest.mark.parametrize(
    "name", ["single spherical", "orders spherical", slow("single flat"), slow("orders flat"), slow("shells spherical")]
)
@pytest.mark.parametrize(
    "atmosphere",
    [
        slow(skyfit.Atmosphere(None, Aerosol(0.2), None)),
        slow(skyfit.Atmosphere(Rayleigh(), None, None)),
        skyfit.Atmosphere(None, Aerosol(0.2), Ozone()),
    ],
    ids=["haze", "air", "haze and ozone"],
)
def test_an_absent_constituent_is_one_of_depth_zero(name, atmosphere):
    alone = SOLVERS[name]
    zenith, azimuth = np.radians([10.0, 70.0, 10.0, 70.0]), np.array([0.3, 0.3, 1.9, 1.9])
    found = sky_of(alone, skyfit.Directions(zenith, azimuth))(atmosphere, jnp.asarray(0.9))
    nothing = {
        "rayleigh": eqx.tree_at(lambda air: air.pressure, Rayleigh(), jnp.asarray(0.0)),
        "aerosol": Aerosol(0.0),
        "ozone": Ozone(0.0),
    }
    whole = atmosphere.replace(**{name: c for name, c in nothing.items() if name not in atmosphere})
    assert np.all(found > 0.0) and np.all(np.isfinite(found))
    # the nodes move with the scatterers present
    np.testing.assert_allclose(found, compiled_sky(name, whole, 0.9, zenith, azimuth), rtol=0.05)


@pytest.mark.parametrize("name", SOLVERS)
def test_angles_below_a_microradian_do_not_matter(name):
    """Views at the zenith and into the sun: no special direction in the radiance."""
    offset = np.array([0.0, 1e-6, 1e-4])
    sky = compiled_sky(name, hazy(), 0.6, 0.6 + offset, 0.3)
    np.testing.assert_allclose(sky, sky[:1] * np.ones((3, 1), np.float32), rtol=2e-3)
    sky = compiled_sky(name, hazy(), 0.6, offset[:2], np.array([0.0, 2.0]))
    np.testing.assert_allclose(sky[0], sky[1], rtol=1e-4)


def test_one_stream_in_pure_air_cuts_no_forward_peak_off():
    """Delta-M cuts a moment of air off, but air has no aureole to correct."""
    scene = unit_scene(40.0, views([0.0, 60.0], [0.0, 90.0]))
    one = skyfit.OrdersOfScattering(1, 2, 8, 4, 8, geometry="flat").radiance(skyfit.Atmosphere(), scene)
    whole = skyfit.OrdersOfScattering.draft("flat").radiance(skyfit.Atmosphere(), scene)
    np.testing.assert_allclose(one, whole, rtol=0.2)
