"""Aerosol of two modes of spheres: its table held against miepython, its limits, gradients and transforms."""

import equinox as eqx
import jax
import jax.numpy as jnp
import miepython
import numpy as np
import pytest
from scipy.integrate import quad

import skyfit
from skyfit.atmosphere import RayleighPhase, TwoModeAerosol
from skyfit.tables import read_arrays


WAVELENGTH = np.array([355.0, 412.0, 550.0, 870.0])
# beyond the diffraction peak, to near the glory
ANGLE = np.array([6.0, 15.0, 40.0, 75.0, 95.0, 120.0, 143.0, 160.0, 175.0])
HALF = np.sin(np.radians(0.5 * ANGLE)) ** 2
FIELDS = (
    "optical_depth",
    "fine_fraction",
    "fine_radius",
    "coarse_radius",
    "fine_width",
    "coarse_width",
    "refractive_index",
    "absorption_index",
)
START = np.array([0.3, 0.6, 0.17, 2.3, 0.45, 0.66, 1.447, 0.0071])


def aerosol(values) -> TwoModeAerosol:
    return TwoModeAerosol(*values)  # pyright: ignore[reportCallIssue]


def quantities(made, half=HALF, wavelength=WAVELENGTH):
    """Everything a solver asks for."""
    half, wavelength = jnp.asarray(half), jnp.asarray(wavelength)
    phase = made.phase
    depth, albedo = made.optical_depth_at(wavelength), made.single_scattering_albedo_at(wavelength)
    return (
        depth,
        albedo,
        phase.at_haversine(half, wavelength),
        phase.matrix(half, wavelength),
        phase.moments(12, wavelength),
    )


def optics(made, half=HALF, wavelength=WAVELENGTH):
    """All of it in one vector, the phase function by its logarithm."""
    depth, albedo, value, *rest = quantities(made, half, wavelength)
    return jnp.concatenate([jnp.ravel(part) for part in (depth, albedo, jnp.log(value), *rest)])


def compiled(function):
    """As one program: op by op, compilation would be most of the time of these tests."""
    return jax.jit(function)


optics_of = compiled(quantities)


# --- against miepython


def spheres(index, largest):
    """Size parameters, their steps in ln x, Q_ext, Q_sca, g, and F11, F12, F33 `[size, 3, angle]` of single spheres."""
    small = np.arange(np.log(0.01), np.log(4.0), 0.02)
    middle = np.log(np.arange(4.0, min(60.0, largest), 0.08))
    large = np.arange(np.log(60.0), np.log(largest), 0.002)
    log_size = np.concatenate([small, middle, large])
    size, index = np.exp(log_size), complex(index).conjugate()
    extinction, scattering, _, asymmetry = miepython.efficiencies_mx(np.full(len(size), index), size)
    cosine, elements = np.cos(np.radians(ANGLE)), np.zeros((len(size), 3, len(ANGLE)))
    for i, x in enumerate(size):
        first, second = miepython.S1_S2(index, x, cosine, norm="qsca")
        squares = np.abs(second) ** 2, np.abs(first) ** 2
        matrix = 0.5 * (squares[0] + squares[1]), 0.5 * (squares[0] - squares[1]), np.real(first * second.conj())
        # this norm is of the efficiency: the amplitudes of a sphere are larger by the root of pi x^2
        elements[i] = np.pi * x**2 * np.stack(matrix)
    return size, np.gradient(log_size), extinction, scattering, asymmetry, elements


def mode(single, radius, width, wavelength_nm):
    """Extinction, scattering, g and elements per volume of a lognormal mode: the integral, point by point."""
    size, step, extinction, scattering, asymmetry, elements = single
    micrometres = wavelength_nm * 1e-3
    r = size * micrometres / (2.0 * np.pi)
    volume = np.exp(-0.5 * (np.log(r / radius) / width) ** 2) * step
    number = volume / volume.sum() / (4.0 / 3.0 * np.pi * r**3)
    area, wavenumber = np.pi * r**2, 2.0 * np.pi / micrometres
    scattered = number @ (area * scattering)
    return (
        number @ (area * extinction),
        scattered,
        number @ (area * scattering * asymmetry) / scattered,
        np.einsum("s,sea->ea", number, elements) / wavenumber**2,
    )


@pytest.mark.parametrize("index, coarse", [(1.387 + 0j, False), (1.52 + 0.0123j, True), (1.438 + 0.0041j, True)])
def test_optics_are_the_lognormal_integrals_of_miepython(x64, index, coarse):
    """Extinction to 0.2 %, albedo to 0.001, g to 0.002, F11 to 2 % and a median of 0.2 %, F12 / F11 to 0.01.

    Radii, widths and index are off the table's nodes. Coarse spheres without absorption have resonances that the
    integral here would step over.
    """
    random = np.random.default_rng(int(index.real * 1000))
    single = spheres(index, 600.0 if coarse else 60.0)
    errors = []
    for _ in range(4):
        radii = random.uniform(0.08, 0.3), random.uniform(0.9, 2.5) if coarse else 2.0
        widths = random.uniform(0.32, 0.6), random.uniform(0.5, 0.7)
        fraction = random.uniform(0.1, 0.9) if coarse else 1.0
        at = [*WAVELENGTH, 550.0]
        fine, rough = ([mode(single, r, w, v) for v in at] for r, w in zip(radii, widths, strict=True))
        volumes = fraction / fine[-1][0], (1.0 - fraction) / rough[-1][0]
        for share, amounts in ((fraction, volumes), (0.0, (0.0, 1.0 / rough[-1][0])), (1.0, (1.0 / fine[-1][0], 0.0))):
            if share < 1.0 and not coarse:
                continue
            made = aerosol([0.4, share, *radii, *widths, index.real, index.imag])
            depth, albedo, value, matrix, moments = optics_of(made, jnp.asarray(HALF), jnp.asarray(WAVELENGTH))
            for i in range(len(WAVELENGTH)):
                pair = list(zip(amounts, (fine[i], rough[i]), strict=True))
                extinction, scattering = (sum(a * m[j] for a, m in pair) for j in (0, 1))
                f11, f12, f33 = sum(a * m[3] for a, m in pair)
                g = sum(a * m[1] * m[2] for a, m in pair) / scattering
                assert float(depth[i]) == pytest.approx(0.4 * extinction, rel=2e-3)
                assert float(albedo[i]) == pytest.approx(scattering / extinction, abs=1e-3)
                assert float(moments[1, i]) == pytest.approx(g, abs=2e-3)
                np.testing.assert_allclose(matrix[0, :, i], f12 / f11, atol=0.01)
                np.testing.assert_allclose(matrix[2, :, i], f33 / f11, atol=0.02)
                errors.append(np.abs(value[:, i] * scattering / f11 - 1.0))
    assert np.max(errors) < 0.02
    assert np.median(errors) < 2e-3


def test_the_published_volumes_give_the_published_optical_depth(x64):
    """Dubovik et al. 2002, Table 1, Goddard: volumes 0.15 tau and 0.01 + 0.04 tau um^3/um^2, tau = 0.3 at 440 nm.

    The fits over tau are rounded to the second digit: 5 %. Albedo 0.98, 0.97, 0.96, 0.95 at 440 to 1020 nm.
    """
    wavelength = jnp.array([440.0, 670.0, 870.0, 1020.0])
    fine, coarse = (TwoModeAerosol(1.0, share) for share in (1.0, 0.0))
    depth = 0.15 * 0.3 / fine.volumes[0] * fine.optical_depth_at(wavelength)[0]
    depth += (0.01 + 0.04 * 0.3) / coarse.volumes[1] * coarse.optical_depth_at(wavelength)[0]
    assert float(depth) == pytest.approx(0.3, rel=0.05)
    np.testing.assert_allclose(
        TwoModeAerosol(0.3).single_scattering_albedo_at(wavelength), [0.98, 0.97, 0.96, 0.95], atol=0.015
    )


# --- limits and conservation


def test_small_spheres_scatter_as_air_does(x64):
    """Size parameters of 0.1: corrections of the order of their square; air without depolarisation."""
    small, dark = (
        # smaller than a concrete radius may be
        eqx.tree_at(lambda a: a.fine_radius, aerosol([0.1, 1.0, 0.1, 2.0, 0.3, 0.6, 1.45, k]), jnp.asarray(0.012))
        for k in (0.0, 0.05)
    )
    wavelength, half = jnp.array([800.0, 1000.0]), jnp.linspace(0.0, 1.0, 25)
    depth, _, value, matrix, _ = optics_of(small, half, wavelength)
    lost, albedo, *_ = optics_of(dark, half, wavelength)
    air = RayleighPhase(0.0)
    np.testing.assert_allclose(value, air.at_haversine(half, wavelength) + jnp.zeros((1, 2)), rtol=0.03)
    np.testing.assert_allclose(matrix, air.matrix(half, wavelength) + jnp.zeros((1, 1, 2)), atol=0.02)
    moments = [compiled(lambda w, p=p: p.matrix_moments(6, w))(wavelength)[:, :, -1] for p in (small.phase, air)]
    np.testing.assert_allclose(*moments, atol=0.01)
    assert float(depth[0] / depth[1]) == pytest.approx(0.8**-4, rel=0.02)
    # absorption of small spheres goes as 1 / wavelength
    lost = lost * (1.0 - albedo)
    assert float(lost[0] / lost[1]) == pytest.approx(1.25, rel=0.02)


def test_large_spheres_extinguish_twice_their_cross_section(x64):
    """Two times, and some per cent more: 2 + 2 x^(-2/3)."""
    volume = float(aerosol([1.0, 0.0, 0.1, 6.0, 0.4, 0.5, 1.45, 0.02]).volumes[1])
    effective = 6.0 * np.exp(-0.125)
    size = 2.0 * np.pi * effective / 0.55
    assert 4.0 / 3.0 * effective / volume == pytest.approx(2.0 + 2.0 * size ** (-2.0 / 3.0), rel=0.02)


@pytest.mark.parametrize("fraction", [0.0, 0.5, 1.0])
def test_the_phase_function_is_normalised_and_gives_its_moments(x64, fraction):
    """By quadrature over its own values, interval by interval of the angle."""
    phase = TwoModeAerosol(0.2, fraction).phase
    edges = np.concatenate([[0.0], np.geomspace(1e-3, np.pi, 300)])
    nodes, weights = np.polynomial.legendre.leggauss(10)
    step = 0.5 * np.diff(edges)[:, None]
    angle = (edges[:-1, None] + step * (1.0 + nodes)).ravel()
    solid_angle = 2.0 * np.pi * np.sin(angle) * (step * weights).ravel()
    values = np.asarray(phase.at_haversine(jnp.asarray(np.sin(0.5 * angle) ** 2), jnp.asarray(WAVELENGTH)))
    assert values.min() > 0.0
    legendre = np.polynomial.legendre.legvander(np.cos(angle), 64)
    integrals = (legendre * solid_angle[:, None]).T @ values
    np.testing.assert_allclose(integrals[0], 1.0, atol=1e-6)
    np.testing.assert_allclose(phase.moments(65, jnp.asarray(WAVELENGTH)), integrals, atol=1e-6)
    ratio = np.asarray(phase.matrix(jnp.asarray(np.sin(0.5 * angle) ** 2), jnp.asarray(WAVELENGTH)))
    assert np.abs(ratio).max() < 1.0 + 1e-4
    np.testing.assert_array_equal(ratio[1], 1.0)


def test_forward_and_backward_spheres_keep_polarisation(x64):
    """F12 is 0 along the line of the light, F33 is F11 ahead and -F11 behind."""
    matrix = TwoModeAerosol(0.2).phase.matrix(jnp.array([0.0, 1.0]), jnp.asarray(WAVELENGTH))
    np.testing.assert_allclose(matrix[0], 0.0, atol=1e-3)
    np.testing.assert_allclose(matrix[2], [[1.0] * 4, [-1.0] * 4], atol=1e-3)


def test_what_is_not_absorbed_is_scattered(x64):
    wavelength = jnp.asarray(WAVELENGTH)
    np.testing.assert_array_equal(
        TwoModeAerosol(0.2, absorption_index=0.0).single_scattering_albedo_at(wavelength), 1.0
    )
    albedo = np.stack(
        [
            TwoModeAerosol(0.2, absorption_index=k).single_scattering_albedo_at(wavelength)
            for k in np.linspace(0.0, 0.1, 21)
        ]
    )
    assert np.all(np.diff(albedo, axis=0) < 0.0) and albedo.min() > 0.3
    made = TwoModeAerosol(0.2)
    assert float(made.optical_depth_at(jnp.array([550.0]))[0]) == pytest.approx(0.2, rel=1e-12)
    np.testing.assert_array_equal(TwoModeAerosol(0.0).optical_depth_at(wavelength), 0.0)
    # the modes add up as they should
    parts = [TwoModeAerosol(0.2 * s, f) for s, f in ((0.7, 1.0), (0.3, 0.0))]
    both = TwoModeAerosol(0.2, 0.7)
    np.testing.assert_allclose(
        sum(p.optical_depth_at(wavelength) for p in parts), both.optical_depth_at(wavelength), rtol=1e-12
    )


def test_particles_beyond_the_table_are_refused_and_not_taken_for_its_last():
    """Soot, n 1.75, k 0.44: a single-scattering albedo of 0.354 by Mie theory; the corner of the table has 0.595."""
    soot = {"fine_fraction": 1.0, "fine_radius": 0.1, "fine_width": 0.45}
    for beyond, wanted in (
        ({"refractive_index": 1.75}, "`refractive_index` must be between 1.33 and 1.6, got 1.75 "),
        ({"absorption_index": 0.44}, "`absorption_index` must be between 0 and 0.1, got 0.44 "),
        ({"fine_radius": 0.01}, "`fine_radius` must be between 0.05 and 0.5 um, got 0.01"),
        ({"coarse_width": 1.2}, "`coarse_width` must be between 0.3 and 0.9, got 1.2"),
    ):
        with pytest.raises(ValueError, match=wanted):
            TwoModeAerosol(0.3, **(soot | beyond))
    # what is traced has the value of the table's end, as the class says

    def albedo(k):
        return TwoModeAerosol(0.3, absorption_index=k).single_scattering_albedo_at(jnp.array([550.0]))[0]

    assert float(jax.jit(albedo)(0.44)) == pytest.approx(float(jax.jit(albedo)(0.1)), rel=1e-6)


def test_effective_radii_are_volume_over_surface(x64):
    """Of the lognormal, by quadrature over ln r."""
    made = aerosol(START)

    def moment(radius, width, power):
        return quad(lambda t: np.exp(power * t - 0.5 * ((t - np.log(radius)) / width) ** 2), -12.0, 9.0, limit=200)[0]

    effective = [moment(START[i], START[i + 2], 0) / moment(START[i], START[i + 2], -1) for i in (2, 3)]
    assert float(made.fine_effective_radius) == pytest.approx(effective[0], rel=1e-8)
    assert float(made.coarse_effective_radius) == pytest.approx(effective[1], rel=1e-8)
    assert effective[0] < float(made.effective_radius) < effective[1]
    for share, expected in ((1.0, effective[0]), (0.0, effective[1])):
        alone = aerosol([0.3, share, *START[2:]])
        assert float(alone.effective_radius) == pytest.approx(expected, rel=1e-8)


# --- gradients, transforms, dtypes


def test_gradients_are_central_differences(x64):
    def field(values):
        return optics(aerosol(values))

    start = jnp.asarray(START)
    slopes = compiled(jax.jacfwd(field))(start)
    quick = compiled(field)
    for i, name in enumerate(FIELDS):
        step = 1e-5 * START[i]
        central = (quick(start.at[i].add(step)) - quick(start.at[i].add(-step))) / (2.0 * step)
        scale = float(jnp.max(jnp.abs(central)))
        assert scale > 0.0
        np.testing.assert_allclose(slopes[:, i], central, atol=1e-7 * scale, err_msg=name)
    weight = jnp.cos(jnp.arange(slopes.shape[0]))
    backward = compiled(jax.grad(lambda v: weight @ field(v)))(start)
    np.testing.assert_allclose(backward, weight @ slopes, rtol=1e-9)


def test_gradients_over_angle_and_wavelength_are_central_differences(x64):
    phase = TwoModeAerosol(0.2).phase
    half = jnp.array([1e-6, 1e-3, 0.1, 0.5, 0.9, 0.9995])
    for at, step in ((half, 1e-7 * half), (jnp.full(6, 500.0), jnp.full(6, 1e-2))):

        def value(x, over_angle=at is half):
            h, wavelength = (x, jnp.array([500.0])) if over_angle else (half, x[:1])
            return phase.at_haversine(h, wavelength)[:, 0]

        quick, slope = compiled(value), compiled(lambda x, t, f=value: jax.jvp(f, (x,), (t,))[1])(at, step)
        central = 0.5 * (quick(at + step) - quick(at - step))
        np.testing.assert_allclose(slope, central, rtol=2e-4, atol=1e-9 * float(jnp.max(jnp.abs(central))))


ENDS = (
    {},
    {"fine_radius": 0.0},
    {"fine_radius": 0.05, "coarse_radius": 6.0, "coarse_width": 0.9},
    {"fine_radius": 0.5, "coarse_radius": 0.8, "fine_width": 0.3},
    {"coarse_radius": 1e6},
    {"fine_width": 0.0, "coarse_width": -1.0},
    {"refractive_index": 1.33},
    {"refractive_index": 1.6, "absorption_index": 0.1},
    {"refractive_index": 1.0, "absorption_index": -1.0},
    {"refractive_index": 3.0, "absorption_index": 1.0},
    {"absorption_index": 0.0},
    {"fine_fraction": 0.0},
    {"fine_fraction": 1.0},
    {"fine_fraction": 1.5, "optical_depth": 0.0},
)


def test_values_and_gradients_are_finite_at_the_ends_and_beyond():
    def field(v):
        return optics(aerosol(v), np.array([0.0, 1e-9, 0.3, 1.0]), np.array([300.0, 1100.0]))

    both = compiled(lambda v: (field(v), jax.jacfwd(field)(v)))
    for change in ENDS:
        values = jnp.asarray([change.get(name, v) for name, v in zip(FIELDS, START, strict=True)], jnp.float32)
        found, slopes = both(values)
        assert np.all(np.isfinite(found)) and np.all(np.isfinite(slopes)), change
        assert 0.0 <= found[2:4].min() and found[2:4].max() <= 1.0, change


def test_beyond_the_table_the_end_value_holds(x64):
    field = compiled(lambda v: optics(aerosol(v)))
    slopes = compiled(jax.jacfwd(lambda v: optics(aerosol(v))))
    ends = {"refractive_index": (1.60, 1.7), "absorption_index": (0.1, 0.2), "fine_width": (0.25, 0.1)}
    for name, (end, beyond) in ends.items():
        i = FIELDS.index(name)
        first, second = (np.where(np.arange(8) == i, v, START) for v in (end, beyond))
        np.testing.assert_array_equal(field(first), field(second), err_msg=name)
        np.testing.assert_array_equal(slopes(second)[:, i], 0.0, err_msg=name)


def test_jit_eager_vmap_and_a_loop_agree():
    some = jnp.asarray(np.stack([START, START * [1.0, 0.5, 1.3, 0.7, 1.1, 0.9, 1.02, 3.0]]), jnp.float32)
    loop = jnp.stack([optics(aerosol(v)) for v in some])
    np.testing.assert_allclose(jax.jit(jax.vmap(lambda v: optics(aerosol(v))))(some), loop, rtol=1e-4, atol=1e-5)
    np.testing.assert_allclose(jax.jit(lambda v: optics(aerosol(v)))(some[1]), loop[1], rtol=1e-4, atol=1e-5)


def test_float32_is_near_float64():
    single = optics(aerosol(START))
    assert single.dtype == jnp.float32
    with jax.enable_x64(True):
        np.testing.assert_allclose(single, optics(aerosol(START)), rtol=5e-5, atol=5e-6)


def test_a_sky_tells_the_size_of_its_particles(x64):
    """Gauss and Newton's steps from other sizes come back to those of a single-scattered sky, wavelength and angle."""
    scene = skyfit.Scene.from_degrees(
        60.0,
        skyfit.Directions.from_degrees(np.repeat([30.0, 60.0, 75.0], 7), np.tile([3, 8, 20, 45, 90, 135, 180], 3)),
        np.array([440.0, 550.0, 675.0, 870.0]),
        irradiance="unit",
    )

    def sky(log_values):
        atmosphere = skyfit.Atmosphere(aerosol=aerosol([*jnp.exp(log_values), 0.45, 0.65, 1.44, 0.005]))
        return jnp.log(skyfit.SingleScattering(12, "flat").radiance(atmosphere, scene)).ravel()

    truth = np.log([0.25, 0.7, 0.16, 2.2])
    observed = sky(jnp.asarray(truth))
    both = compiled(lambda v: (sky(v) - observed, jax.jacfwd(sky)(v)))
    values = jnp.log(jnp.array([0.2, 0.85, 0.12, 3.0]))
    for _ in range(8):
        residual, slopes = both(values)
        values = values - jnp.linalg.lstsq(slopes, residual)[0]
    np.testing.assert_allclose(values, truth, atol=1e-6)


# --- the table


def test_the_table_says_where_it_comes_from_and_is_read_only():
    table = read_arrays("mie_kernels.npz")
    about = str(table["about"])
    assert "source: Mie theory" in about and "licence: " in about and "Axes: " in about
    with pytest.raises(ValueError, match="read-only"):
        table["log_value"][0] = 0.0
    with pytest.raises(FileNotFoundError, match="`name` must be a file"):
        read_arrays("no_such_table.npz")
    half = table["haversine"]
    assert half[0] == 0.0 and half[-1] == 1.0 and np.all(np.diff(half) > 0.0)
