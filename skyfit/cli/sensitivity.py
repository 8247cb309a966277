"""`skyfit sensitivity`."""

from pathlib import Path
from typing import Annotated

import typer

from .asked_of_files import Altitude, Latitude, Longitude, read_asked, Times, UtcOffset
from .invert import FreeOption, PriorOption
from .options import (
    AtmosphereOption,
    check_file,
    command,
    Context,
    GeometryName,
    GeometryOption,
    in_range,
    LineShape,
    NamedSolverOption,
    PresetName,
    PresetOption,
    refuse,
)


# Number of candidate directions beside those of the scan, and their largest zenith angle, degrees
_CANDIDATES, _LOWEST = 343, 80.0
_MOST_NEXT = 100.0


@command("sensitivity", "skyfit sensitivity scan.alm --turbidity 3 --out told.json")
def sensitivity_command(
    context: Context,
    scan: Annotated[Path, typer.Argument(help="a sky whose sun, views and wavelengths are meant, not its radiance")],
    out: Annotated[Path, typer.Option(help="JSON file to write")],
    turbidity: Annotated[float, typer.Option(help="of the atmosphere, Preetham's")] = 3.0,
    atmosphere: AtmosphereOption = None,
    free: FreeOption = None,
    prior: PriorOption = None,
    relative: Annotated[float, typer.Option(help="noise, share of each sample")] = 0.02,
    count: Annotated[int, typer.Option("--next", help="how many further directions to choose")] = 10,
    interest: Annotated[str | None, typer.Option(help="names that these are to tell best (default: all)")] = None,
    times: Times = None,
    latitude: Latitude = None,
    longitude: Longitude = None,
    utc_offset: UtcOffset = None,
    altitude: Altitude = None,
    fwhm: LineShape = None,
    solver: NamedSolverOption = "orders",
    preset: PresetOption = PresetName.normal,
    geometry: GeometryOption = GeometryName.spherical,
):
    """Tell which parameters a scan determines, how well, and which directions to measure next.

    As skyfit.fisher_information and skyfit.next_directions do in Python, of scalar light, for the first time of the
    file or of --times. Every sample has noise of its own; without --free all is free that such an atmosphere has of
    particles or lobes.
    """
    import json

    import jax
    import numpy as np

    from ..atmosphere import Atmosphere
    from ..measured import atomic
    from ..programs import keep_in
    from ..retrieve import fisher_information, next_directions, posterior_covariance, SkyModel, values_of
    from ..scene import Directions, hemisphere, Scene
    from .asked import free_of, names_in, priors_of, times_of
    from .models import atmosphere_of, make_solver, settings_of, sizes
    from .printing import give, progress, written
    from .sensitivity_report import print_sensitivity, prior_sigmas, record_of

    check_file(out)
    in_range("--relative", relative, 1e-6, 1.0)
    in_range("--next", float(count), 1.0, _MOST_NEXT)
    named, wanted = priors_of(prior or []), None if interest is None else names_in(interest)
    if atmosphere is None:
        air = Atmosphere.from_turbidity(in_range("--turbidity", turbidity, 1.001, 50.0))
    else:
        refuse(context, ("turbidity",), "`--atmosphere`, whose file holds it")
        air = atmosphere_of(atmosphere)
    sky = read_asked(scan, latitude, longitude, utc_offset, altitude, fwhm)
    sky = sky.at(0 if times is None else int(times_of(times, sky)[0]))
    seen, spectrum = _seen(sky)
    names = tuple(values_of(SkyModel(air), free_of("particles,lobes" if free is None else free, sky)))
    names = names if free is None else free_of(free, sky)
    prior_sigma = prior_sigmas(names, named)
    dome = hemisphere(_CANDIDATES, np.radians(_LOWEST))
    views = [np.concatenate([view[0, seen], np.asarray(other)]) for view, other in
             ((sky.view_zenith, dome.zenith), (sky.view_azimuth, dome.azimuth))]  # fmt: skip
    sun = [float(np.degrees(angle)) for angle in sky.sun_at(0)]
    width = None if np.isnan(sky.fwhm_nm) else sky.fwhm_nm
    scene = Scene.from_degrees(sun[0], Directions(*views), spectrum, sun[1], fwhm_nm=width)
    keep_in(jax.config.jax_compilation_cache_dir)  # pyright: ignore[reportAttributeAccessIssue]
    chosen = make_solver(solver, preset, geometry)
    with progress("differentiating", f"sensitivity, {settings_of(chosen)}", sizes(names, scene, air)):
        information = np.asarray(fisher_information(scene, air, names, relative, solver=chosen))
    measured = np.arange(int(seen.sum()))
    covariance = np.asarray(posterior_covariance(information[measured].sum(axis=0), prior_sigma))
    choice = next_directions(information, names, count, wanted, measured, prior_sigma)
    after = Directions(*(view[choice.order] for view in views))
    values = np.array([values_of(SkyModel(air), names)[name] for name in names])
    record = record_of(sky, sun, spectrum, relative, names, values, covariance, prior_sigma, after, choice.sigma)
    with atomic(out) as part:
        part.write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")
    print_sensitivity(record)
    written([out])
    give(record)


def _seen(sky):
    """The directions with usable samples, and the wavelengths within the model's range and outside gas bands."""
    import numpy as np

    from ..light.solar import SPECTRUM_NM
    from ..retrieve.sampling import GAS_BANDS_NM

    if sky.response is not None:
        raise ValueError(f"{sky.source}: expected spectral radiance, found channels: their noise is not of wavelengths")
    own = sky.wavelength_nm
    bands = np.any([(own >= low) & (own <= high) for low, high in GAS_BANDS_NM], axis=0)
    good = (own >= SPECTRUM_NM[0]) & (own <= SPECTRUM_NM[1]) & ~bands & sky.usable[0].any(axis=0)
    seen = sky.usable[0][:, good].any(axis=1)
    if not seen.any():
        raise ValueError(f"{sky.source}: expected samples at {SPECTRUM_NM[0]:g}-{SPECTRUM_NM[1]:g} nm, found none")
    return seen, own[good]
