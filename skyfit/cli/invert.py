"""`skyfit invert` and `skyfit predict`."""

from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from .asked_of_files import Altitude, Latitude, Longitude, MaskSun, read_asked, ResponseOption, Times, UtcOffset
from .asked_of_pictures import (
    AcrossOption,
    AzimuthOption,
    check_kind,
    EncodingOption,
    LensOption,
    LevelOption,
    MaskOption,
    MirrorOption,
    MomentOption,
    panorama_asked,
    ProjectionOption,
    told_of_haze,
    told_of_place,
    write_pictures,
)
from .known import PARAMETER_NAMES, THRESHOLD
from .options import (
    AtmosphereOption,
    check_folder,
    command,
    Context,
    end,
    GeometryName,
    GeometryOption,
    in_range,
    LineShape,
    LossName,
    OutFolder,
    Place,
    PolarisedOption,
    PresetName,
    PresetOption,
    SolverOption,
    SunAngle,
    ToleranceOption,
)


FreeOption = Annotated[
    str | None,
    typer.Option(
        help="with commas: particles (sizes and index of spheres; default for spectra), bins (22 of radius for the "
        "sizes), lobes (default else) or of "
        + ", ".join(name for name in PARAMETER_NAMES if not name.startswith("size_bin_"))
        + ", size_bin_1 to size_bin_22"
    ),
]
PriorOption = Annotated[list[str] | None, typer.Option(help="name=value,sigma known before, or name=none")]
# Number of groups of a jackknife, each left out once
_GROUPS = 10
# With a tolerance, the solver is chosen for the first guess, and again for the fitted atmosphere
_CHOICES = 2
# Largest field of view, degrees (`NoiseModel` allows half a radian), and largest number of starts
_WIDEST_VIEW, _MOST_STARTS = 28.0, 1000.0


@command("invert", "skyfit invert scan.nc --out fit --prior ozone=310,15")
def invert_command(
    context: Context,
    sky: Annotated[
        Path, typer.Argument(help="of an instrument, NetCDF, CSV, a folder of ASD text exports, or a picture")
    ],
    out: OutFolder,
    free: FreeOption = None,
    fix: Annotated[list[str] | None, typer.Option(help="name=value of a parameter that is known")] = None,
    prior: PriorOption = None,
    shared: Annotated[str | None, typer.Option(help="names that all times share (default: the slow ones)")] = None,
    independent: Annotated[bool, typer.Option("--independent", help="each time by itself, nothing shared")] = False,
    smooth: Annotated[list[str] | None, typer.Option(help="name=sigma of its change per hour, repeatable")] = None,
    relative: Annotated[float | None, typer.Option(help="noise, share of each sample")] = None,
    floor: Annotated[float | None, typer.Option(help="noise, share of the time's median radiance")] = None,
    calibration: Annotated[float | None, typer.Option(help="sigma of each wavelength's scale, 0: exact")] = None,
    model_error: Annotated[float | None, typer.Option(help="relative, of the model (0.003; scalar 0.007)")] = None,
    field_of_view: Annotated[float, typer.Option(help="full cone of the instrument, degrees")] = 0.0,
    loss: Annotated[LossName, typer.Option(help="of residuals beyond the threshold")] = LossName.huber,
    threshold: Annotated[float, typer.Option(help="of the loss, in sigma")] = THRESHOLD,
    starts: Annotated[int, typer.Option(help="of the search, random ones but for the first")] = 1,
    jackknife: Annotated[
        bool, typer.Option("--jackknife", help="sigma also from ten fits that leave out directions by turns")
    ] = False,
    products: Annotated[
        bool, typer.Option("--products", help="the haze at the fitted wavelengths too: aerosol.csv, aerosol.nc")
    ] = False,
    mask_sun: MaskSun = None,
    atmosphere: AtmosphereOption = None,
    times: Times = None,
    response: ResponseOption = None,
    latitude: Latitude = None,
    longitude: Longitude = None,
    utc_offset: UtcOffset = None,
    altitude: Altitude = None,
    fwhm: LineShape = None,
    solver: SolverOption = "orders",
    preset: PresetOption = PresetName.normal,
    geometry: GeometryOption = GeometryName.spherical,
    polarised: PolarisedOption = None,
    tolerance: ToleranceOption = None,
    projection: ProjectionOption = None,
    lens: LensOption = None,
    across: AcrossOption = None,
    azimuth: AzimuthOption = None,
    mirror: MirrorOption = False,
    mask: MaskOption = None,
    encoding: EncodingOption = None,
    level: LevelOption = None,
    sun_zenith: SunAngle = None,
    sun_azimuth: SunAngle = None,
    time: MomentOption = None,
    at: Place = None,
):
    """Recover turbidity or aerosol optical depth, and more, from a measured sky, or from a picture of one.

    As skyfit.invert does in Python: by OrdersOfScattering.normal, spherical, polarised for spectra and scalar for
    channels, where no option says otherwise. The command computes in float64; Python in the precision of its process,
    float32 where nobody asks for more. The search begins at the atmosphere of a file, where one is given, and what is
    not fitted stays what it is there, ozone and pressure too. With a tolerance the solver is chosen for the first guess
    and, where the fitted air asks for another, once more; the error to expect of it is the model error of sigma, unless
    one is given.

    Exit code 3 if a search did not come to its end: the files are written, and the table says which.
    """
    import json
    from dataclasses import replace
    from math import radians

    import jax

    from ..draw import plot
    from ..extras import require
    from ..measured import NoiseModel, time_names
    from ..programs import keep_in
    from ..records import save, write_products
    from ..retrieve import aerosol_products, invert
    from ..transport.choose import choose_for_all
    from .asked import free_of, priors_of, response_of, samples_of, shared_of, smooth_of, start_of, values_of_fix
    from .chosen import allowed_of, print_choice, record_of, scenes_of
    from .fit_report import print_fit
    from .models import atmosphere_of, make_solver, settings_of
    from .printing import give, progress, say, warn, written

    allowed = allowed_of(context, solver, tolerance, ("preset", "geometry", "polarised"))
    smoothed = smooth_of(smooth or [])
    view = radians(in_range("--field-of-view", field_of_view, 0.0, _WIDEST_VIEW))
    measurement = NoiseModel(relative, floor, calibration, model_error, view, loss.value, threshold)
    in_range("--starts", float(starts), 1.0, _MOST_STARTS)
    priors, channels = priors_of(prior or []), response_of(response)
    known = values_of_fix(fix or [])
    panorama, placed = None, None
    check_kind(
        sky, projection, lens=lens, across=across, azimuth=azimuth, mirror=mirror, mask=mask, encoding=encoding,
        level=level, sun_zenith=sun_zenith, sun_azimuth=sun_azimuth, time=time, at=at,
    )  # fmt: skip
    if projection is None:
        measured = read_asked(sky, latitude, longitude, utc_offset, altitude, fwhm, channels)
    else:
        panorama, placed = panorama_asked(
            sky, projection, lens, across, azimuth, mirror, mask, encoding, level, channels, sun_zenith, sun_azimuth,
            time, at, altitude,
        )  # fmt: skip
        measured, channels = panorama.sky, None
        free = ",".join(name for name in panorama.free if name not in known) if free is None else free
    measured = samples_of(measured, times, mask_sun)
    names = free_of(free, measured, known)
    # None lets `invert` use its default and say so
    asked = None if free is None and not known else names
    start = start_of(names, known, measured, None if atmosphere is None else atmosphere_of(atmosphere))
    common = shared_of(names, shared, independent, tuple(smoothed), len(measured.time))
    if products:
        require("xarray", "h5netcdf")
    check_folder(out)
    keep_in(jax.config.jax_compilation_cache_dir)  # pyright: ignore[reportAttributeAccessIssue]
    size = f"{measured.radiance.shape}, {', '.join(names)}; {', '.join(common)}; {starts} starts, jackknife {jackknife}"

    def fitted(last, start, measurement):
        with progress("fitting", f"invert, {settings_of(last)}", size) as report:
            return invert(
                measured, asked, last, start, progress=report, shared=common, measurement=measurement,
                response=channels, priors=priors, smooth=smoothed, starts=starts,
                jackknife=_GROUPS if jackknife else 0,
            )  # fmt: skip

    choice = None
    if allowed is None:
        spectral = channels is None and measured.response is None
        vector = spectral and solver == "orders" if polarised is None else polarised
        last = make_solver(solver, preset, geometry, vector)
        fit = fitted(last, start, measurement)
    else:
        scenes = scenes_of(measured, start.atmosphere, channels)
        models, fit = [start] * len(scenes), None
        for _ in range(_CHOICES):
            found = choose_for_all([(m.atmosphere, scene) for m, scene in zip(models, scenes, strict=True)], allowed)
            if choice is not None and found.solver == choice.solver and found.expected_error <= choice.expected_error:
                break
            choice = found
            allows = measurement if model_error is not None else replace(measurement, model_error=found.expected_error)
            fit = fitted(found.solver, models[0], allows)
            models = fit.fitted.models
        assert fit is not None
    out.mkdir(parents=True, exist_ok=True)
    files = []
    keep = partial(save, choice=None if choice is None else record_of(choice))
    for write, name in ((keep, "fit.json"), (keep, "fit.nc"), (plot, "fit.png")):
        # A file that needs a missing optional dependency is skipped
        try:
            write(fit, out / name)
            files.append(name)
        except ModuleNotFoundError as error:
            warn(f"no {name}: {error}")
    if products:
        stated = aerosol_products(fit)
        for name in ("aerosol.nc", "aerosol.csv"):
            write_products(stated, out / name)
            files.append(name)
    if panorama is not None:
        files += write_pictures(panorama, fit, out)
    print_fit(fit)
    if choice is not None:
        print_choice(choice)
    if panorama is not None:
        for sentence in (told_of_place(panorama, fit, placed), told_of_haze(fit)):
            say(sentence)
    written(out / name for name in files)
    give(json.loads((out / "fit.json").read_text(encoding="utf-8")))
    end(zip(time_names(fit.sky), fit.result, strict=True))


@command("predict", "skyfit predict fit/fit.json --at other.nc --out predicted.nc")
def predict_command(
    fit: Annotated[Path, typer.Argument(help="fit.json of skyfit invert")],
    at: Annotated[Path, typer.Option(help="a sky whose times, directions and wavelengths are wanted")],
    out: Annotated[Path, typer.Option(help="NetCDF file to write")],
    latitude: Latitude = None,
    longitude: Longitude = None,
    utc_offset: UtcOffset = None,
    altitude: Altitude = None,
):
    """Predict the radiance of fitted skies in other directions or at other wavelengths."""
    from ..records import load, write_prediction
    from ..retrieve import predict
    from .models import settings_of
    from .printing import give, progress, say

    fitted = load(fit)
    sky = read_asked(at, latitude, longitude, utc_offset, altitude, None)
    with progress("predicting", f"predict, {settings_of(fitted.solver)}", str(sky.radiance.shape)):
        radiance = predict(fitted, sky)
    write_prediction(sky, radiance, out)
    say(f"{out}: {' x '.join(map(str, radiance.shape))} (time, direction, wavelength)")
    give({"file": str(out), **dict(zip(("times", "directions", "wavelengths"), radiance.shape, strict=True))})
