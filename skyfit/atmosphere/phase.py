r"""Phase functions: the angular distribution of scattered light, and its Legendre moments.

All are normalised: $\int p\, d\omega = 1$, in sr^-1, and
$p(\gamma) = \frac{1}{4\pi} \sum_l (2l+1) \chi_l P_l(\cos\gamma)$ with $\chi_0 = 1$.
The scattering angle is given as its haversine $\sin^2(\gamma/2)$, which stays accurate at small angles.
"""

from abc import abstractmethod
from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from ..numerics import (
    ALL_WAVELENGTHS,
    as_float,
    as_float_or_none,
    associated_legendre,
    check_increasing,
    check_radians,
    check_range,
    check_wavelength,
    gauss_legendre,
    hat_weights,
    IN_MICROMETRES,
    radians_within,
    Ranged,
    spin_legendre,
    table_range,
    within,
)
from ..tables import read_table


# Reference wavelength of aerosol optical depth, turbidity (Preetham 1999, sec. 2.1) and all spectral slopes, nm
REFERENCE_WAVELENGTH = 550.0
# Degree of polarisation of haze at 90 degrees from the sun, for phase functions without a scattering matrix
HAZE_POLARISATION = 0.25
# Number of Gauss-Legendre nodes for integrals over the scattering angle
_ANGLES = 256
# Allowed wavelengths of a table
TABLE_WAVELENGTHS = within(100.0, 1e5, "nm", IN_MICROMETRES)
# At |g| = 1 the lobe is a delta function without a value; at this limit it is a milliradian wide
_ASYMMETRY = within(-0.999, 0.999)


class AbstractPhase(Ranged):
    """A phase function. The last axis of its values has length 1 if they do not depend on wavelength."""

    # Degree of the last nonzero moment, None if there are infinitely many
    last_degree: eqx.AbstractClassVar[int | None]

    @property
    @abstractmethod
    def known_nm(self) -> tuple[float, float]:
        """The valid wavelengths, nm. Concrete wavelengths beyond are a `ValueError`."""

    @abstractmethod
    def at_haversine(
        self, haversine: Float[Array, " direction"], wavelength_nm: Float[Array, " wavelength"]
    ) -> Float[Array, " direction #wavelength"]:
        """The phase function in sr^-1; `haversine` is sin^2 of half the scattering angle."""

    def at_angle(
        self, angle: Float[ArrayLike, " direction"], wavelength_nm: Float[ArrayLike, " wavelength"]
    ) -> Float[Array, " direction #wavelength"]:
        """The phase function at scattering angles.

        **Arguments** `angle`: from the forward direction, radians in [0, pi].

        **Returns** sr^-1.

        **Valid** concrete angles outside [0, pi] are a `ValueError`; traced ones are not checked.
        """
        check_radians("angle", angle, 0.0, np.pi)
        return self.at_haversine(jnp.sin(0.5 * as_float(angle)) ** 2, as_float(wavelength_nm))

    @abstractmethod
    def moments(self, count: int, wavelength_nm: Float[Array, " wavelength"]) -> Float[Array, " moment #wavelength"]:
        """The Legendre moments 0 .. count-1, dimensionless."""

    @abstractmethod
    def matrix(
        self, haversine: Float[Array, " direction"], wavelength_nm: Float[Array, " wavelength"]
    ) -> Float[Array, "element direction #wavelength"]:
        """The ratios F12, F22 and F33 of the scattering matrix to the phase function F11.

        Q is positive for polarisation in the plane of scattering, so F12 is negative for air. F34, which converts
        between linear and circular polarisation, is neglected.
        """

    def matrix_moments(
        self, count: int, wavelength_nm: Float[Array, " wavelength"]
    ) -> Float[Array, "element moment #wavelength"]:
        r"""The moments $\alpha$, $\gamma$, $\zeta$ of the scattering matrix, 0 .. count-1, without the factor 2 l + 1.

        $\gamma_l = \int F_{12} R_l^0 d\omega$, $\alpha_l = \int (F_{22} R_l^2 - F_{33} T_l^2) d\omega$,
        $\zeta_l = \int (F_{33} R_l^2 - F_{22} T_l^2) d\omega$. $\alpha$ couples E to E, $\gamma$ the radiance to E and
        back, and $\zeta$ B to B.

        **Source:** Siewert 1982, Astron. Astrophys. 109, 195, whose expansion coefficients are 2 l + 1 times these.
        """
        nodes, weights = gauss_legendre(_ANGLES)
        angle = np.pi * nodes
        half = as_float(np.sin(0.5 * angle) ** 2)
        r, t = (as_float(v) for v in spin_legendre(angle, 3, max(count, 1)))
        weighted = self.at_haversine(half, wavelength_nm) * as_float(2.0 * np.pi**2 * weights * np.sin(angle))[:, None]
        f12, f22, f33 = self.matrix(half, wavelength_nm) * weighted[None]
        alpha, zeta = (r[:, 2] @ a - t[:, 2] @ b for a, b in ((f22, f33), (f33, f22)))
        return jnp.stack([alpha, r[:, 0] @ f12, zeta])


def polarised_like_air(haversine, share) -> Float[Array, "element direction #wavelength"]:
    r"""A scattering matrix like that of air, $F_{12} = -s\, F_{11} \sin^2\gamma / (1 + \cos^2\gamma)$; F22, F33 of air.

    **Arguments:** `share` s in [0, 1]: the degree of polarisation at 90 degrees; air without depolarisation has 1.
    **Source:** a model, for phase functions that say nothing of polarisation.
    """
    cosine = 1.0 - 2.0 * haversine[:, None]
    round_about = 1.0 + cosine**2
    return jnp.stack([-share * (1.0 - cosine**2) / round_about, jnp.ones_like(cosine), 2.0 * cosine / round_about])


class RayleighPhase(AbstractPhase):
    r"""$p = \frac{3}{16\pi(1+2\gamma_d)}[(1+3\gamma_d) + (1-\gamma_d)\cos^2\gamma]$, $\gamma_d = \rho/(2-\rho)$.

    `depolarization` $\rho$ in [0, 1]; 0 gives $3(1+\cos^2\gamma)/16\pi$, the papers' form.
    Source: Chandrasekhar 1950; Bucholtz 1995, Appl. Opt. 34, 2765, eq. 12.

    **Example:**

        >>> aside, ahead = skyfit.RayleighPhase(0.0).at_angle(np.radians([90.0, 0.0]), jnp.array([550.0]))[:, 0]
        >>> round(float(ahead / aside), 3)
        2.0
    """

    # King factor 1.048 of air at 550 nm (Bodhaine et al. 1999, table 3), as 6 (F - 1) / (7 F + 3)
    depolarization: Float[Array, ""] = eqx.field(converter=as_float, default=0.0279, metadata=within(0.0, 1.0))
    last_degree: ClassVar[int | None] = 2
    known_nm: ClassVar[tuple[float, float]] = ALL_WAVELENGTHS

    def at_haversine(self, haversine, wavelength_nm):
        check_range("haversine", haversine, 0.0, 1.0)
        spread = self.depolarization / (2.0 - self.depolarization)
        cosine = 1.0 - 2.0 * haversine[:, None]
        scale = 3.0 / (16.0 * np.pi * (1.0 + 2.0 * spread))
        return scale * ((1.0 + 3.0 * spread) + (1.0 - spread) * cosine**2)

    def moments(self, count, wavelength_nm):
        second = 0.2 * (1.0 - self.depolarization) / (2.0 + self.depolarization)
        values = [1.0, 0.0, second] + [0.0] * count
        return jnp.stack([as_float(v) for v in values[:count]])[:, None]

    def matrix(self, haversine, wavelength_nm):
        share = (1.0 - self.depolarization) / (1.0 + 0.5 * self.depolarization)
        square = (1.0 - 2.0 * haversine[:, None]) ** 2
        pure = 0.75 * share * jnp.stack([square - 1.0, 1.0 + square, 2.0 * (1.0 - 2.0 * haversine[:, None])])
        return pure / (0.75 * share * (1.0 + square) + 1.0 - share)[None]


def _henyey_greenstein(haversine, asymmetry):
    check_range("haversine", haversine, 0.0, 1.0)
    denominator = (1.0 - asymmetry) ** 2 + 4.0 * asymmetry * haversine
    return (1.0 - asymmetry**2) / (4.0 * np.pi * denominator * jnp.sqrt(denominator))


def _powers(asymmetry, count: int):
    return asymmetry ** np.arange(count)


class HenyeyGreenstein(AbstractPhase):
    r"""$p = \frac{1-g^2}{4\pi (1+g^2-2g\cos\gamma)^{3/2}}$, moments $g^l$; forward scattering is g > 0.

    `asymmetry` g in [-0.999, 0.999]. Source: Henyey & Greenstein 1941. Klassen 1987, eq. 1 and Hoffman & Preetham 2002
    print the numerator $(1-g)^2$ and signs of their own: neither integrates to one.

    **Example:**

        >>> phase = skyfit.HenyeyGreenstein(0.7)
        >>> forward, back = phase.at_angle(np.radians([0.0, 180.0]), np.array([550.0]))[:, 0]
        >>> round(float(forward / back))
        182
    """

    asymmetry: Float[Array, ""] = eqx.field(converter=as_float, metadata=_ASYMMETRY)
    polarisation: Float[Array, ""] = eqx.field(converter=as_float, default=HAZE_POLARISATION, metadata=within(0.0, 1.0))
    last_degree: ClassVar[int | None] = None
    known_nm: ClassVar[tuple[float, float]] = ALL_WAVELENGTHS

    def at_haversine(self, haversine, wavelength_nm):
        return _henyey_greenstein(haversine, self.asymmetry)[:, None]

    def moments(self, count, wavelength_nm):
        return _powers(self.asymmetry, count)[:, None]

    def matrix(self, haversine, wavelength_nm):
        return polarised_like_air(haversine, self.polarisation)


class TwoTermHenyeyGreenstein(AbstractPhase):
    r"""The weighted sum of two Henyey-Greenstein lobes, $f p_{HG}(g_1) + (1 - f) p_{HG}(g_2)$.

    `asymmetry` and `asymmetry_second` in [-0.999, 0.999]; `forward_fraction` f at 550 nm in [0, 1] and its slope per
    unit of ln(wavelength / 550 nm): coarse particles scatter forward, and their share is larger in the red.
    Source: Irvine 1965, Astrophys. J. 142, 1563; Kattawar 1975. The slope is our own.

    **Example:**

        >>> haze = skyfit.TwoTermHenyeyGreenstein(0.7, -0.3, 0.9)
        >>> back, aside = haze.at_angle(np.radians([180.0, 110.0]), jnp.array([550.0]))[:, 0]
        >>> bool(back > aside)
        True
    """

    asymmetry: Float[Array, ""] = eqx.field(converter=as_float, metadata=_ASYMMETRY)
    asymmetry_second: Float[Array, ""] = eqx.field(converter=as_float, metadata=_ASYMMETRY)
    forward_fraction: Float[Array, ""] = eqx.field(converter=as_float, metadata=within(0.0, 1.0))
    forward_fraction_slope: Float[Array, ""] = eqx.field(converter=as_float, default=0.0, metadata=within(-10.0, 10.0))
    polarisation: Float[Array, ""] = eqx.field(converter=as_float, default=HAZE_POLARISATION, metadata=within(0.0, 1.0))
    last_degree: ClassVar[int | None] = None
    known_nm: ClassVar[tuple[float, float]] = ALL_WAVELENGTHS

    def _fraction(self, wavelength_nm):
        ratio = jnp.log(wavelength_nm / REFERENCE_WAVELENGTH)
        return jnp.clip(self.forward_fraction + self.forward_fraction_slope * ratio, 0.0, 1.0)[None]

    def at_haversine(self, haversine, wavelength_nm):
        first = _henyey_greenstein(haversine, self.asymmetry)[:, None]
        second = _henyey_greenstein(haversine, self.asymmetry_second)[:, None]
        return second + self._fraction(wavelength_nm) * (first - second)

    def moments(self, count, wavelength_nm):
        first, second = (_powers(g, count)[:, None] for g in (self.asymmetry, self.asymmetry_second))
        return second + self._fraction(wavelength_nm) * (first - second)

    def matrix(self, haversine, wavelength_nm):
        return polarised_like_air(haversine, self.polarisation)


class CornetteShanks(AbstractPhase):
    r"""$p = \frac{3}{8\pi} \frac{(1-g^2)(1+\cos^2\gamma)}{(2+g^2)(1+g^2-2g\cos\gamma)^{3/2}}$.

    `asymmetry` here is the parameter g in [-0.999, 0.999], not the mean cosine.
    Source: Cornette & Shanks 1992, Appl. Opt. 31, 3152; Bruneton & Neyret 2008, eq. 4.

    **Example:**

        >>> ahead, back = skyfit.CornetteShanks(0.7).at_angle(np.radians([0.0, 180.0]), jnp.array([550.0]))[:, 0]
        >>> bool(ahead > 100.0 * back)
        True
    """

    asymmetry: Float[Array, ""] = eqx.field(converter=as_float, metadata=_ASYMMETRY)
    polarisation: Float[Array, ""] = eqx.field(converter=as_float, default=HAZE_POLARISATION, metadata=within(0.0, 1.0))
    last_degree: ClassVar[int | None] = None
    known_nm: ClassVar[tuple[float, float]] = ALL_WAVELENGTHS

    def at_haversine(self, haversine, wavelength_nm):
        cosine = 1.0 - 2.0 * haversine
        scale = 1.5 / (2.0 + self.asymmetry**2)
        return (scale * (1.0 + cosine**2) * _henyey_greenstein(haversine, self.asymmetry))[:, None]

    def moments(self, count, wavelength_nm):
        degree = np.arange(count + 2)

        def times_cosine(moments):
            above = jnp.concatenate([moments[1:], jnp.zeros(1)])
            below = jnp.concatenate([jnp.zeros(1), moments[:-1]])
            return ((degree + 1) * above + degree * below) / (2 * degree + 1)

        lobe = _powers(self.asymmetry, count + 2)
        both = lobe + times_cosine(times_cosine(lobe))
        return (1.5 / (2.0 + self.asymmetry**2) * both[:count])[:, None]

    def matrix(self, haversine, wavelength_nm):
        return polarised_like_air(haversine, self.polarisation)


class Tabulated(AbstractPhase):
    """A table of log values over angle and wavelength, interpolated linearly in both and normalised.

    `angle` radians `[angle]`, increasing; `table_wavelength_nm` `[band]`; `log_value` `[angle, band]`; `matrix_ratio`
    `[element, angle, band]`, the ratios F12, F22 and F33 of the scattering matrix to F11 (`matrix`), in [-1, 1].
    If it is None, the matrix is like that of air with the degree `polarisation` at 90 degrees.

    **Valid:** angles beyond the table get the value at its end. Wavelengths beyond the table are a `ValueError`;
    traced ones get the value at its end.

    **Example:**

        >>> ahead, aside = skyfit.Tabulated.bullrich().at_angle(np.radians([5.0, 90.0]), jnp.array([550.0]))[:, 0]
        >>> bool(ahead > 10.0 * aside)
        True
    """

    angle: Float[Array, " angle"] = eqx.field(converter=as_float, metadata=radians_within(0.0, np.pi))
    table_wavelength_nm: Float[Array, " band"] = eqx.field(converter=as_float, metadata=TABLE_WAVELENGTHS)
    log_value: Float[Array, "angle band"] = eqx.field(converter=as_float, metadata=within(-80.0, 80.0))
    polarisation: Float[Array, ""] = eqx.field(converter=as_float, default=HAZE_POLARISATION, metadata=within(0.0, 1.0))
    matrix_ratio: Float[Array, "3 angle band"] | None = eqx.field(
        converter=as_float_or_none, default=None, metadata=within(-1.0, 1.0)
    )
    last_degree: ClassVar[int | None] = None

    @property
    def known_nm(self) -> tuple[float, float]:
        """The wavelength range of the table, nm."""
        return table_range(self.table_wavelength_nm)

    def __check_init__(self):
        check_increasing("angle", self.angle)
        check_increasing("table_wavelength_nm", self.table_wavelength_nm)
        if self.matrix_ratio is not None and self.matrix_ratio.shape != (3, *self.log_value.shape):
            raise ValueError(
                f"`matrix_ratio` must have three elements of the shape of `log_value`, {self.log_value.shape}, "
                f"got {self.matrix_ratio.shape}"
            )

    @classmethod
    def from_matrix(cls, angle, table_wavelength_nm, p11, p12, p33, p22=None) -> "Tabulated":
        r"""A `Tabulated` from a scattering matrix, by cubic splines between its angles.

        **Arguments:** `angle` `[angle]`, radians from 0 to pi, increasing, and `table_wavelength_nm` `[band]`; the
        elements `[angle, band]` in one arbitrary unit: P11 > 0, P12 (negative where light is polarised as by air),
        P33, and P22 if the particles are not spheres (None: P11). **Returns:** a `Tabulated` at the given angles and
        at every half degree. **Valid:** concrete numbers only. The splines have slope 0 at 0 and pi, as every smooth
        matrix has. P34 and P44 affect circular polarisation only, which is neglected (`Stokes`).
        """
        from scipy.interpolate import CubicSpline

        angle, p11 = np.asarray(angle, np.float64), np.asarray(p11, np.float64)
        check_range("angle", angle, 0.0, np.pi, "rad")
        check_increasing("angle", angle)
        if angle.ndim != 1 or angle[0] > 1e-6 or angle[-1] < np.pi - 1e-6:
            raise ValueError(f"`angle` must reach from 0 to pi, got {angle[0]:g} to {angle[-1]:g}")
        if not np.all(p11 > 0.0):
            raise ValueError(f"`p11` must be positive, got {p11[~(p11 > 0.0)][0]:g}")
        rows = [np.log(p11), *(np.asarray(p) / p11 for p in (p12, p11 if p22 is None else p22, p33))]
        dense = np.union1d(angle, np.linspace(angle[0], angle[-1], 361))
        # Drop angles that differ by rounding only
        dense = dense[np.append(np.diff(dense) > 1e-5, True)]
        spline = CubicSpline(angle, np.stack(rows), axis=1, bc_type="clamped")(dense)
        return cls(dense, table_wavelength_nm, spline[0], matrix_ratio=np.clip(spline[1:], -1.0, 1.0))

    @classmethod
    def bullrich(cls) -> "Tabulated":
        """Haze with Bullrich's eta for Junge's exponent 4, 400-850 nm: Preetham 1999, Table 1.

        **Valid:** 300 to 1100 nm. The phase function of Junge's distribution changes with wavelength only through the
        refractive index, so the bands at 400 and 850 nm hold beyond them.

        Log eta is interpolated (the paper gives no rule; linear interpolation misses its own K by 7 %).
        """
        table = read_table("preetham_table1_eta.csv")
        names = [name for name in table if name.startswith("eta_")]
        bands = np.array([float(name.removeprefix("eta_").removesuffix("nm")) for name in names])
        values = np.stack([table[name] for name in names], axis=1)
        return cls(np.radians(table["theta_deg"]), *held(bands, np.log(values)))

    def _unnormalised(self, haversine, wavelength_nm):
        check_range("haversine", haversine, 0.0, 1.0)
        check_wavelength(wavelength_nm, *self.known_nm, "all that Tabulated knows")
        return jnp.exp(self._at(self.log_value, haversine, wavelength_nm))

    def _at(self, table, haversine, wavelength_nm):
        """A table interpolated at scattering angles and wavelengths."""
        inside = jnp.clip(haversine, 1e-12, 1.0 - 1e-6)
        angle = 2.0 * jnp.arctan2(jnp.sqrt(inside), jnp.sqrt(1.0 - inside))
        over_wavelength = table @ hat_weights(wavelength_nm, self.table_wavelength_nm).T
        return hat_weights(angle, self.angle) @ over_wavelength

    def _quadrature(self, count, wavelength_nm):
        nodes, weights = gauss_legendre(_ANGLES)
        # Gauss-Legendre nodes in the angle, dense enough for the kinks of the table
        angle = np.pi * nodes
        values = self._unnormalised(as_float(np.sin(0.5 * angle) ** 2), wavelength_nm)
        solid_angle = as_float(2.0 * np.pi * np.pi * weights * np.sin(angle))
        legendre = associated_legendre(angle, 1, max(count, 1))[:, 0]
        return (as_float(legendre) * solid_angle[None]) @ values

    def at_haversine(self, haversine, wavelength_nm):
        return self._unnormalised(haversine, wavelength_nm) / self._quadrature(1, wavelength_nm)

    def moments(self, count, wavelength_nm):
        moments = self._quadrature(count, wavelength_nm)
        return moments / moments[:1]

    def matrix(self, haversine, wavelength_nm):
        if self.matrix_ratio is None:
            return polarised_like_air(haversine, self.polarisation)
        return jnp.stack([self._at(ratio, haversine, wavelength_nm) for ratio in self.matrix_ratio])


def held(table_nm: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A table (wavelengths along its last axis) extended to 300 and 1100 nm with its end values."""
    return np.concatenate([[300.0], table_nm, [1100.0]]), np.concatenate(
        [values[..., :1], values, values[..., -1:]], axis=-1
    )
