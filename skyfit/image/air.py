"""The air between the eye and the objects of a depth image: `air_to`."""

from collections.abc import Callable, Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Real

from ..atmosphere import Atmosphere
from ..light import extraterrestrial_irradiance, linear_from_xyz, xyz
from ..numerics import as_float, check_range
from ..scene import Directions, Scene
from ..transport import AbstractSolver, check_scene, Path, SingleScattering, Spherical
from .camera import Camera
from .render import EYE, SPECTRUM, sunlight


# Distance of each pixel, m
Depth = Real[Array | np.ndarray, "row column"]
# Number of pixels computed at once; they need less than about 100 MB of memory
_PIECE = 1024


def air_to(
    distance: Depth,
    camera: Camera,
    atmosphere: Atmosphere,
    solver: AbstractSolver | None = None,
    *,
    sun_zenith: Float[Array, ""] | float,
    sun_azimuth: Float[Array, ""] | float = np.pi,
    height: float = EYE,
    lit: Sequence[tuple[Depth, Depth]] | None = None,
    wavelength_nm: Real[Array | np.ndarray, " wavelength"] | None = None,
) -> Path:
    r"""Transmittance and in-scattered light of the air between an eye and the objects of a depth image.

    $L = T L_0 + L_{in}$ by `Path.over`, with $L_0$ the objects' own radiance, 0 where there is only sky. There
    $L_{in}$ is the solver's sky itself, so there is no seam between a distant mountain and the sky behind it.

    **Arguments:** `distance`, m, along the view of each pixel, infinite for the sky (a view that meets the ground ends
    there); `solver`, by default `Spherical.normal()`, all orders on a sphere, or `SingleScattering`; `sun_zenith`,
    `sun_azimuth` clockwise from north, rad; `height` of the eye, m; `lit`, the sunlit parts of each view, pairs of
    distances `[row, column]` as in `SphericalField.path`, for `Spherical` only; `wavelength_nm`, None: colours.
    **Returns:** `Path`, `[row, column, channel]`. With colours the channels are linear sRGB: the in-scatter is in
    cd m^-2 as in `Image.rgb`, and the transmittance, between 0 and 1, is that of grey objects in unfiltered sunlight.
    With wavelengths the in-scatter is in W m^-2 sr^-1 nm^-1.
    **Errors:** `ValueError` for another solver, and for scenes outside the solver's range.
    **Valid:** each pixel is solved separately, without a table. Differentiable by the atmosphere, distances and sun.
    Rays are straight. In fog `Spherical` has enough levels only if the atmosphere is not traced.
    **Source:** Hoffman & Preetham 2002, eq. 1; the integrals: `SphericalField.path`.

    **Example:**

        >>> camera = skyfit.Camera("perspective", 8, 6)
        >>> air = skyfit.Atmosphere.from_turbidity(2.0)
        >>> path = skyfit.air_to(np.full((6, 8), 5e3), camera, air, skyfit.SingleScattering(), sun_zenith=1.0)
        >>> path.over(jnp.zeros((6, 8, 3))).shape
        (6, 8, 3)
    """
    solver = Spherical.normal() if solver is None else solver
    if not isinstance(solver, Spherical | SingleScattering) or solver.geometry != "spherical":
        name = f"{type(solver).__name__}, {solver.geometry}"
        raise ValueError(f"`solver` must be Spherical or SingleScattering on a sphere, whose sky fits, got {name}")
    if lit is not None and not isinstance(solver, Spherical):
        raise ValueError("`lit` must come with Spherical, which alone knows shade")
    size = camera.height, camera.width
    shade = [(f"lit[{k}]", end) for k, pair in enumerate(lit or ()) for end in pair]
    for name, image in [("distance", distance), *shade]:
        if image.shape != size:
            raise ValueError(f"`{name}` must have the camera's {size[0]} rows and {size[1]} columns, got {image.shape}")
        check_range(name, image, 0.0, np.inf, "m")
    check_range("height", height, 0.0, 1e9, "m")
    light = sunlight() if wavelength_nm is None else extraterrestrial_irradiance(np.asarray(wavelength_nm))
    nm = as_float(SPECTRUM if wavelength_nm is None else wavelength_nm)
    east, north, up = camera.views().reshape(3, -1).astype(float)
    zenith, azimuth = np.arctan2(np.hypot(east, north), up), np.arctan2(east, north)

    def scene(view: Directions) -> Scene:
        return Scene(sun_zenith, sun_azimuth, view, nm, light, height)

    # Checked here with concrete numbers, because the pieces below are traced
    check_scene(solver, atmosphere, scene(Directions(as_float(zenith[:1]), as_float(azimuth[:1]))))

    if isinstance(solver, Spherical):
        field = solver.prepare(atmosphere, nm, sun_zenith=sun_zenith, height=height)

        def path(view, far, ends):
            return field.path(scene(view), far, ends)
    else:

        def path(view, far, ends):
            return solver.path(atmosphere, scene(view), far)

    ends = None if lit is None else [tuple(jnp.reshape(end, -1) for end in pair) for pair in lit]
    found = along(path, zenith, azimuth, jnp.reshape(distance, -1), ends)
    return Path(*(v.reshape(*size, -1) for v in (found if wavelength_nm is not None else coloured(found))))


def along(
    path: Callable[..., Path],
    zenith: Float[np.ndarray, " view"],
    azimuth: Float[np.ndarray, " view"],
    distance: Real[Array | np.ndarray, " view"],
    lit: list | None = None,
) -> Path:
    """The results of `path(views, distance, lit)` for many views, computed piece by piece; angles in radians."""
    count = distance.size
    # All pieces have the same size; the last is filled up
    whole = -(-count // _PIECE) * _PIECE
    place = np.arange(whole) % count
    images = jax.tree.map(lambda v: as_float(v)[place].reshape(-1, _PIECE), (zenith, azimuth, distance, lit))

    def piece(part):
        zenith, azimuth, far, lit = part
        return path(Directions(zenith, azimuth), far, lit)

    found = jax.lax.map(jax.checkpoint(piece), images)
    return Path(*(v.reshape(whole, -1)[:count] for v in found))


def coloured(path: Path) -> Path:
    """Linear sRGB of a path at the wavelengths of `SPECTRUM`, as `air_to` returns it."""
    light = as_float(sunlight())
    left, whole, added = (
        linear_from_xyz(xyz(spectra, SPECTRUM)) for spectra in (path.transmittance * light[None], light, path.inscatter)
    )
    return Path(jnp.clip(left / whole[None], 0.0, 1.0), added)
