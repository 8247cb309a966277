"""A solved spherical atmosphere: its light for every observer, view and sun that it was solved for."""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...atmosphere import Atmosphere
from ...numerics import as_float, check_range, concrete, cubic_weights, gauss_legendre, linear, safe_sqrt
from ...scene import above_horizon, Scene
from ..columns import EARTH_RADIUS, length_scale
from ..contract import check_eye, Irradiances, Path
from ..optics import optics, scatterer_indices, transmitted_sun
from ..single import single_scattering_of
from ..views import end_points, eye_columns, in_pieces, Points, points_at, Views, views_of
from . import harmonics as sun_harmonics
from .first import sun_on_ground
from .grid import CLIMB, dusk, height_coordinate, Resolution, sun_coordinate, sun_weights
from .medium import completed, Medium, medium_of, per_metre
from .transfer import FINER_LEVELS, FINER_SUNS, orders_of, Solution, tabled


# Sunlit parts of views: distances (m) where they begin and end.
Lit = Sequence[tuple[Float[Array, " direction"], Float[Array, " direction"]]]


class SphericalField(eqx.Module):
    """The light of one atmosphere, solved by `Spherical.prepare`.

    The field is valid for suns between the two zenith angles `suns_deg` and for observers up to the height `highest`,
    m.
    """

    atmosphere: Atmosphere
    wavelength_nm: Float[Array, " wavelength"]
    solution: Solution
    sun_place: Float[Array, " sun"]
    suns_deg: Float[Array, "2"]
    highest: Float[Array, ""]
    resolution: Resolution = eqx.field(static=True)

    @property
    def left_over(self) -> Float[Array, " wavelength"]:
        """Approximate ratio of the light in orders that were not solved to the diffuse light that was found.

        Where it is small it is several times too large. Where it is not small do not use the light.
        """
        return self.solution.left_over

    @property
    def nbytes(self) -> int:
        """Memory of the solution, bytes."""
        return sum(table.nbytes for table in jax.tree.leaves(self.solution))

    def radiance(self, scene: Scene) -> Float[Array, "direction wavelength"]:
        """Radiance of sky and ground, W m^-2 sr^-1 nm^-1; zero below the horizon of an observer on the ground.

        **Arguments:** `scene`, with the wavelengths of the field. **Errors:** `ValueError` for a sun, a height or
        wavelengths that the field was not solved for, where they are not traced.
        """
        self._check(scene)
        return self._radiance(scene)

    def by_order(self, scene: Scene) -> Float[Array, "order direction wavelength"]:
        """`radiance` order by order; its sum over the orders is `radiance`.

        **Arguments:** `scene` as for `radiance`. **Returns:** W m^-2 sr^-1 nm^-1: light that was scattered, or
        reflected by the ground, once, twice and so on to one more than the orders that were solved. The last row is all
        light that follows. **Valid:** scattering into the forward peak of a phase function, beyond its `moments`, does
        not count (delta-M), except for light scattered once, whose phase functions are whole. The orders are solved
        again: a call takes about as long as `prepare`.
        """
        self._check(scene)
        return self._by_order(scene)

    def path(self, scene: Scene, distance: Float[Array, " direction"], lit: Lit | None = None) -> Path:
        """Effect of the air between the observer and objects, with all orders of scattering.

        **Arguments:** `distance` (m) to the objects; `lit`, parts of each view that the sun shines on, pairs of
        distances (m) where they begin and end, `[direction]` each, in any order and not overlapping. Mountains and
        clouds shade the rest. None: all but the Earth's shadow. **Returns:** `Path`. **Valid:** sunlight that is
        scattered once is integrated over the lit parts alone. Light of higher orders remains in the shade, where it is
        that of an open sky. A view that meets the ground ends there; the light of the ground itself is left out.
        **Source:** Bruneton & Neyret 2008, sec. 3 (eq. 17, 18), who take the higher orders out of the shade too.
        """
        self._check(scene)
        check_eye(scene)
        check_range("distance", distance, 0.0, np.inf, "m")
        for k, pair in enumerate(lit or ()):
            for name, end in zip(("begin", "end"), pair, strict=True):
                check_range(f"lit[{k}] {name}", end, 0.0, np.inf, "m")
        pairs = None if lit is None else [tuple(as_float(end) for end in pair) for pair in lit]
        return self._path(scene, as_float(distance), pairs)

    def fluxes(self, scene: Scene) -> Irradiances:
        """Irradiance on the ground and, as `up_at_top`, the flux that leaves the air above it, W m^-2 nm^-1."""
        self._check(scene)
        return self._fluxes(scene)

    def mean_radiance(
        self, height: Float[Array, " place"], sun_zenith: Float[Array, " place"]
    ) -> Float[Array, "place wavelength"]:
        r"""Mean diffuse radiance, $\frac{1}{4\pi} \int L\, d\omega$, per unit solar irradiance, sr^-1.

        **Arguments:** `height`, m, and `sun_zenith`, rad, of places in the air. **Valid:** within the range that the
        field was solved for. The sun's beam is left out, and light that haze scatters into its forward peak counts as
        beam (delta-M).
        """
        check_range("height", height, 0.0, np.inf, "m")
        suns = concrete(self.suns_deg)
        low, high = (0.0, np.pi) if suns is None else np.radians(suns)
        check_range("sun_zenith", sun_zenith, low, high, "rad", "suns that were solved")
        levels = cubic_weights(height_coordinate(as_float(height), self.resolution), self.resolution.levels)
        rows = jnp.einsum("pl,ps,lsw->pw", levels, self._suns(as_float(sun_zenith)), self.solution.moments[:, :, 0])
        return rows / (4.0 * np.pi)

    def _check(self, scene: Scene) -> None:
        suns, highest = concrete(self.suns_deg), concrete(self.highest)
        if suns is not None and highest is not None:
            known = f"the field was solved for suns from {suns[0]:g} to {suns[1]:g} degrees"
            low, high = np.radians(suns)
            check_range("sun_zenith", scene.sun_zenith, low, high, "rad", known)
            known = f"the field was solved for observers to {highest:g} m"
            check_range("height", scene.height, 0.0, float(highest), "m", known)
        here, there = concrete(scene.wavelength_nm), concrete(self.wavelength_nm)
        if scene.wavelength_nm.shape != self.wavelength_nm.shape or (
            here is not None and there is not None and not np.allclose(here, there, rtol=1e-6)
        ):
            raise ValueError("`wavelength_nm` of the scene must be those that the field was solved for")

    @eqx.filter_jit
    def _radiance(self, scene: Scene):
        return in_pieces(self.light, scene) * scene.solar_irradiance[None]

    def light(self, scene: Scene) -> Float[Array, "direction wavelength"]:
        """`radiance` per unit solar irradiance, sr^-1."""
        medium = medium_of(self.atmosphere, self.wavelength_nm, self.resolution.moments)
        views = views_of(scene, "spherical")
        light = self._scattered(medium, scene, views) + _ground(self, medium, scene, views)
        seen = views.aloft | above_horizon(scene.view.zenith)
        # No radiance is negative. The error of the orders may exceed the light where almost none is left.
        return jnp.where(seen[:, None] & ~(light < 0.0), light, 0.0)

    @eqx.filter_jit
    def _by_order(self, scene: Scene):
        medium = medium_of(self.atmosphere, self.wavelength_nm, self.resolution.moments)
        views = views_of(scene, "spherical")
        once = self._once(scene, medium, views) + _ground(self, medium, scene, views, diffuse=0.0)
        orders = orders_of(self.atmosphere, self.wavelength_nm, self.sun_place, self.resolution)

        def following(order):
            field = eqx.tree_at(lambda f: f.solution, self, tabled(order, self.solution.left_over))
            return _multiple(field, medium, scene, views) + _ground(field, medium, scene, views, beam=0.0)

        rows = jnp.concatenate([once[None], jax.lax.map(following, orders)])
        seen = views.aloft | above_horizon(scene.view.zenith)
        rows = jnp.where(seen[None, :, None], rows, 0.0)
        rows = jnp.concatenate([rows, self.light(scene)[None] - jnp.sum(rows, axis=0, keepdims=True)])
        return rows * scene.solar_irradiance[None, None]

    @eqx.filter_jit
    def _path(self, scene: Scene, distance, lit) -> Path:
        constituents = self.atmosphere.constituents
        medium = medium_of(self.atmosphere, self.wavelength_nm, self.resolution.moments)
        views = views_of(scene, "spherical", distance)
        columns = eye_columns([c.profile for c in constituents], views, end_points(views, "spherical"), "spherical")
        depth = columns[..., 0].T @ optics(constituents, self.wavelength_nm).extinction
        return Path(jnp.exp(-depth), self._scattered(medium, scene, views, lit) * scene.solar_irradiance[None])

    def _scattered(
        self, medium: Medium, scene: Scene, views: Views, lit: Lit | None = None
    ) -> Float[Array, "direction wavelength"]:
        """All orders of scattering along views, per unit solar irradiance, sr^-1."""
        return _multiple(self, medium, scene, views) + self._once(scene, medium, views, lit)

    def _once(
        self, scene: Scene, medium: Medium, views: Views, lit: Lit | None = None
    ) -> Float[Array, "direction wavelength"]:
        """Sunlight scattered once along views, per unit solar irradiance, sr^-1."""
        constituents = self.atmosphere.constituents
        light = jnp.zeros((views.cosine.shape[0], *self.wavelength_nm.shape), views.cosine.dtype)
        if not scatterer_indices(constituents):
            return light
        depth = optics(constituents, self.wavelength_nm)._replace(extinction=medium.extinction)
        parts = [(views.entry, views.length)] if lit is None else lit
        for begin, end in parts:
            begin = jnp.clip(begin, views.entry, views.length)
            part = views._replace(entry=begin, length=jnp.clip(end, begin, views.length))
            light += single_scattering_of(constituents, scene, depth, self.resolution.once_nodes, "spherical", part)[0]
        return light

    @eqx.filter_jit
    def _fluxes(self, scene: Scene) -> Irradiances:
        medium = medium_of(self.atmosphere, self.wavelength_nm, self.resolution.moments)
        cosine = jnp.cos(scene.sun_zenith)
        constituents = self.atmosphere.constituents
        extinction = optics(constituents, self.wavelength_nm).extinction
        direct = jnp.maximum(cosine, 0.0) * transmitted_sun(constituents, scene, extinction, "spherical")
        row = self._suns(scene.sun_zenith)
        # The part of the delta-M beam given by the true transmittance counts as direct light.
        scaled = sun_on_ground(self.atmosphere, medium.extinction, cosine)
        # It may undershoot where little light comes through thick air.
        diffuse = jnp.maximum(row @ self.solution.ground + scaled - direct, 0.0)
        names = sun_harmonics.kept(self.resolution.moments, bool(medium.peaks))
        along, out = (self.solution.moments[-1, :, names.index((1, mode))] for mode in (0, 1))
        up = -(cosine * (row @ along) + np.sqrt(2.0) * jnp.sin(scene.sun_zenith) * (row @ out))
        up = jnp.maximum(up, 0.0)
        light = scene.solar_irradiance
        return Irradiances(direct * light, diffuse * light, medium.albedo * (direct + diffuse) * light, up * light)

    def _suns(self, zenith):
        return sun_weights(zenith, self.sun_place, self.resolution.sun_step)


def _multiple(
    field: SphericalField, medium: Medium, scene: Scene, views: Views
) -> Float[Array, "direction wavelength"]:
    """Light of the second and higher orders, including reflection by the ground, per unit solar irradiance, sr^-1."""
    resolution = field.resolution
    if not medium.scattering.shape[0]:
        return jnp.zeros((views.cosine.shape[0], *field.wavelength_nm.shape), views.cosine.dtype)
    names = sun_harmonics.kept(resolution.moments, bool(medium.peaks))
    travelling = sun_harmonics.travelling(names)
    degree = np.array([pair[0] for pair in names])
    share = as_float(sun_harmonics.weights(names))
    distance, points, emitted = _emitters(field, medium, views, resolution.view_nodes)
    frame = _Frame.of(scene, views)
    where = frame.at(distance)
    zenith = jnp.arctan2(safe_sqrt(where[1] ** 2 + where[2] ** 2), where[0])
    along, out, aside = (v[:, None] for v in (frame.along, frame.out, frame.aside))
    basis = sun_harmonics.carried(names, along, out, aside, where[1], where[2])
    mixed = jnp.einsum("kdnw,lkw->ldnw", jnp.stack(emitted), medium.moments[: sun_harmonics.TRAVELLING])
    place = sun_coordinate(zenith, resolution.sun_step) - field.sun_place[0]
    table = field.solution.fine
    first, suns = linear(FINER_SUNS * place, table.shape[1])
    height = height_coordinate(points.height, resolution)
    level, rows = linear(FINER_LEVELS * height, table.shape[0])
    weight = jnp.stack([across * up for across in suns for up in rows]) * dusk(zenith)[None]
    factor = jnp.stack(basis, axis=-1) * share[None, None, :travelling]
    # Mixed moments for each harmonic that travels.
    mixed = mixed[degree[:travelling]]

    def corner(light, at):
        here = table[level + at[0], first + at[1]]
        return light + jnp.einsum("dn,dnh,hdnw,dnhw->dw", at[2], factor, mixed, here), None

    places = jnp.asarray([(j, i) for i in range(2) for j in range(2)]).T
    light = jnp.zeros((zenith.shape[0], *field.wavelength_nm.shape), zenith.dtype)
    light, _ = jax.lax.scan(jax.checkpoint(corner), light, (*places, weight))
    if not medium.peaks:
        return light
    # Harmonics that do not travel are taken under the sun over the lowest point of each view.
    lowest = jnp.clip(-(EARTH_RADIUS + views.height) * views.cosine, views.entry, views.length)[:, None]
    where = [v[:, 0] for v in frame.at(lowest)]
    away = safe_sqrt(where[1] ** 2 + where[2] ** 2)
    # On the sun's axis the azimuth is arbitrary; take that of the observer.
    off, size = away > 1.0, jnp.maximum(away, 1.0)
    lean = jnp.where(off, (where[1] * frame.out + where[2] * frame.aside) / size, frame.out)
    across = jnp.where(off, (where[1] * frame.aside - where[2] * frame.out) / size, frame.aside)
    row = field._suns(jnp.arctan2(away, where[0]))
    basis = sun_harmonics.of_views(names[travelling:], frame.along, lean, across) * share[travelling:, None]
    between = cubic_weights(height, resolution.levels)
    moments = field.solution.moments[:, :, travelling:]
    for k in medium.peaks:
        weighted = moments * medium.moments[degree[travelling:], k][None, None]
        if views.aloft:
            local = jnp.einsum("lshw,ds,hd->dlw", weighted, row, basis)
        else:
            # all views begin under one sun
            local = jnp.einsum("lhw,hd->dlw", jnp.einsum("lshw,s->lhw", weighted, row[0]), basis)
        light = light + jnp.einsum("dnw,dnl,dlw->dw", emitted[k], between, local)
    return light


def _ground(
    field: SphericalField, medium: Medium, scene: Scene, views: Views, beam: float = 1.0, diffuse: float = 1.0
) -> Float[Array, "direction wavelength"]:
    """Light of the ground at the end of the views that meet it; `beam` and `diffuse` scale the light on it."""
    if not views.aloft:
        return jnp.zeros((views.cosine.shape[0], *field.wavelength_nm.shape), views.cosine.dtype)
    ends = end_points(views, "spherical")
    profiles = [c.profile for c in field.atmosphere.constituents]
    depth = eye_columns(profiles, views, ends, "spherical")[..., 0].T @ medium.extinction
    cosine = ends.sun_cosine[:, 0]
    lit = beam * sun_on_ground(field.atmosphere, medium.extinction, cosine)
    lit = lit + diffuse * (field._suns(jnp.arctan2(safe_sqrt(1.0 - cosine**2), cosine)) @ field.solution.ground)
    # A view that meets the ground still descends at its end.
    meets = (ends.view_cosine[:, 0] < 0.0) & (ends.height[:, 0] < 1.0)
    return jnp.where(meets[:, None], (medium.albedo / np.pi)[None] * lit * jnp.exp(-depth), 0.0)


class _Frame(eqx.Module):
    """Observer and views by components along the sun's axis, out from it toward the observer, and aside."""

    start: tuple[Float[Array, " direction"], Float[Array, " direction"]]
    along: Float[Array, " direction"]
    out: Float[Array, " direction"]
    aside: Float[Array, " direction"]

    @classmethod
    def of(cls, scene: Scene, views: Views) -> "_Frame":
        radius = EARTH_RADIUS + views.height
        turn = scene.view.azimuth - scene.sun_azimuth
        along, out, aside = sun_harmonics.along_sun(views.cosine, turn, scene.sun_zenith)
        return cls((radius * jnp.cos(scene.sun_zenith), radius * jnp.sin(scene.sun_zenith)), along, out, aside)

    def at(self, distance: Float[Array, "direction node"]):
        """Points on the views at distances, m."""
        return (
            self.start[0][:, None] + distance * self.along[:, None],
            self.start[1][:, None] + distance * self.out[:, None],
            distance * self.aside[:, None],
        )


def _emitters(field: SphericalField, medium: Medium, views: Views, count: int):
    r"""Nodes of the views, and for each scatterer the weight of the light that it sends from them to the eye.

    The weights $e^{-\tau} \beta ds$ of a view sum to $1 - e^{-\tau}$ exactly.
    """
    profiles = [c.profile for c in field.atmosphere.constituents]
    distance, step = _nodes(views, count, CLIMB * field.resolution.near)
    points, ends = points_at(views, distance), end_points(views, "spherical")
    every = Points(*(jnp.concatenate(pair, axis=1) for pair in zip(points, ends, strict=True)))
    column = jnp.einsum("cdn,cw->dnw", eye_columns(profiles, views, every, "spherical"), medium.extinction)
    density = jnp.stack([p.density(points.height) for p in profiles])
    weight = jnp.exp(-column[:, :-1]) * step[..., None]
    extinction = jnp.einsum("cdn,cw->dnw", density, medium.extinction)
    scale, missing = completed(-jnp.expm1(-column[:, -1]), jnp.sum(weight * extinction, axis=1))
    near = (jnp.arange(distance.shape[1])[None] == jnp.argmin(distance, axis=1)[:, None])[..., None]
    weight = weight * scale[:, None] + per_metre(jnp.where(near, missing[:, None], 0.0), extinction)
    scatterers = scatterer_indices(field.atmosphere.constituents)
    emitted = [weight * density[i][..., None] * medium.scattering[k][None, None] for k, i in enumerate(scatterers)]
    return distance, points, emitted


def _nodes(views: Views, count: int, near: float):
    """Distances and steps (m) of nodes on both sides of the lowest point of each view.

    `near` (m) is the climb from that point within which they crowd.
    """
    radius = EARTH_RADIUS + views.height
    lowest = jnp.clip(-radius * views.cosine, views.entry, views.length)
    pieces = [(lowest, views.length - lowest, 1.0)]
    if views.aloft:
        pieces.append((lowest, lowest - views.entry, -1.0))
    start = points_at(views, lowest[:, None])
    scale = length_scale(EARTH_RADIUS + start.height, jnp.abs(start.view_cosine), near)
    x, share = (jnp.asarray(v, scale.dtype)[None] for v in gauss_legendre(count))
    distances, steps = [], []
    for low, extent, sign in pieces:
        span = jnp.log1p(extent[:, None] / scale)
        distances.append(low[:, None] + sign * scale * jnp.expm1(span * x))
        steps.append(scale * span * jnp.exp(span * x) * share)
    return jnp.concatenate(distances, axis=1), jnp.concatenate(steps, axis=1)
