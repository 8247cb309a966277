"""`skyfit render`."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from .known import SEA_LEVEL_PRESSURE
from .options import (
    check_file,
    command,
    Context,
    GeometryName,
    GroundAlbedo,
    in_range,
    Place,
    PresetName,
    PresetOption,
    SunAzimuth,
    SunZenith,
    ToleranceOption,
)


class ProjectionName(StrEnum):
    """How a picture lies on the sphere."""

    equirect = "equirect"
    fisheye = "fisheye"
    cube = "cube"
    perspective = "perspective"


class SunName(StrEnum):
    """What becomes of the sun."""

    disc = "disc"
    none = "none"
    lamp = "lamp"


class ToneName(StrEnum):
    """What becomes of what is brighter than white."""

    filmic = "filmic"
    aces = "aces"
    agx = "agx"
    clip = "clip"


class SpaceName(StrEnum):
    """Spaces of colour."""

    srgb = "srgb"
    rec2020 = "rec2020"
    acescg = "acescg"
    xyz = "xyz"


@command("render", "skyfit render --sun-zenith 85 --turbidity 3 --out dusk.png")
def render(
    context: Context,
    out: Annotated[Path, typer.Option(help="picture to write: .exr or .hdr, linear, or .png, developed")],
    sun_zenith: SunZenith = None,
    sun_azimuth: SunAzimuth = None,
    time: Annotated[str | None, typer.Option(help="ISO, UTC unless it says, with --at")] = None,
    at: Place = None,
    until: Annotated[
        str | None, typer.Option(help="last time of a time-lapse: numbered frames, and of .png a contact sheet")
    ] = None,
    frames: Annotated[int | None, typer.Option(help="of a time-lapse; those that are there stay")] = None,
    turbidity: Annotated[
        float | None, typer.Option(help="Preetham's, at 550 nm (>= 1)  [default: 3]", show_default=False)
    ] = None,
    atmosphere: Annotated[
        Path | None, typer.Option(help="TOML or JSON with constituents and ground, instead of --turbidity")
    ] = None,
    solver: Annotated[
        str,
        typer.Option(
            metavar="[spherical|orders|single|double|extended|published|FILE|auto]",
            help="FILE: coefficients; auto: by --tolerance",
        ),
    ] = "spherical",
    preset: PresetOption = PresetName.normal,
    height: Annotated[float, typer.Option(help="of the observer, m; other than spherical: on the ground")] = 2.0,
    ground_albedo: GroundAlbedo = 0.1,
    projection: Annotated[
        ProjectionName,
        typer.Option(
            help="equirect: zenith on top, azimuth growing to the right; fisheye: looks up, north up, east right; "
            "cube: six faces side by side, as cube maps have them"
        ),
    ] = ProjectionName.equirect,
    size: Annotated[
        str | None,
        typer.Option(metavar="WxH", help="pixels  [default: by the projection]", show_default=False),
    ] = None,
    azimuth: Annotated[
        float | None,
        typer.Option(
            help="degrees, of the middle column, of a cube the face ahead  [default: the sun's]", show_default=False
        ),
    ] = None,
    elevation: Annotated[float, typer.Option(help="degrees, of the middle, perspective")] = 20.0,
    field_of_view: Annotated[
        float | None, typer.Option(help="degrees  [default: fisheye 180, perspective 70]", show_default=False)
    ] = None,
    mirror: Annotated[
        bool, typer.Option("--mirror", help="fisheye with east left, as all-sky cameras have it")
    ] = False,
    sun: Annotated[SunName, typer.Option(help="disc, or left out; lamp: left out, and written beside as JSON")] = (
        SunName.disc
    ),
    exposure: Annotated[
        float | None, typer.Option(help="value at ISO 100, of a .png  [default: by the mean]", show_default=False)
    ] = None,
    white_balance: Annotated[
        float | None, typer.Option(help="K of the daylight that is white  [default: D65]", show_default=False)
    ] = None,
    tone: Annotated[
        ToneName, typer.Option(help="of a .png: a shoulder, that of ACES 2.0 or of AgX, or cut off at white")
    ] = ToneName.filmic,
    space: Annotated[SpaceName, typer.Option(help="of an .exr")] = SpaceName.srgb,
    half: Annotated[bool, typer.Option("--half", help=".exr in half precision, scaled by its whiteLuminance")] = False,
    spectral: Annotated[
        bool, typer.Option("--spectral", help=".exr with a layer for each of 19 wavelengths too, of a solver's sky")
    ] = False,
    tolerance: ToleranceOption = None,
):
    """Render a picture of the sky, the ground and the sun.

    An .exr holds cd/m2, and which way it is up in its comments.
    """
    import math
    from dataclasses import replace

    import jax
    import numpy as np

    from ..atmosphere import Atmosphere, Ground
    from ..image import Camera
    from ..image.picture import check_saving
    from ..image.render import check_height, EYE, render as rendered, SPECTRUM
    from ..scene import hemisphere, Scene
    from ..transport import SOLVERS, Spherical
    from ..transport.choose import choose_for_all
    from .chosen import allowed_of, expected_of, print_choice, record_of
    from .models import analytic_of, atmosphere_of, make_solver
    from .printing import give, progress, say
    from .sequence import begin, Frame, frames_of
    from .sun import seen_at, sun_of

    # float32 is enough for a picture
    context.with_resource(jax.enable_x64(False))
    check_file(out)
    check_saving(out, exposure, white_balance, space.value, half, spectral)
    in_range("--ground-albedo", ground_albedo, 0.0, 1.0)
    if atmosphere is not None and turbidity is not None:
        raise ValueError("`--turbidity` must be left out with `--atmosphere`, whose file holds the haze")
    haze = in_range("--turbidity", 3.0 if turbidity is None else turbidity, 1.0, 50.0)
    asked: dict = {}
    allowed = allowed_of(context, solver, tolerance, ("preset",))
    if allowed is not None or solver in SOLVERS:
        # The solver is chosen below, once the suns are known; `Spherical` has the widest range of suns
        chosen = Spherical.normal()
        if allowed is None:
            chosen = make_solver(solver, preset, GeometryName.flat if solver == "uniform" else GeometryName.spherical)
        check_height(height, chosen)
        lowest, asked = chosen.suns.largest_deg, {"solver": chosen, "height": height}
        sky = (
            atmosphere_of(atmosphere)
            if atmosphere
            else Atmosphere.from_turbidity(haze).replace(ground=Ground(ground_albedo))
        )
    else:
        if atmosphere is not None:
            raise ValueError(
                f"`--atmosphere` must be left out with `--solver {solver}`: it is that of the formula's fit"
            )
        sky = analytic_of(solver, f"`--solver` must be one of {', '.join(SOLVERS)}")
        check_height(height, sky)
        sky.check_range(haze, sky.fitted_sun[0])
        lowest, asked = math.degrees(sky.fitted_sun[1]), {"turbidity": haze, "ground_albedo": ground_albedo}
    if until is None:
        if frames is not None:
            raise ValueError("`--frames` must come with `--until`")
        zenith, around, _ = sun_of(sun_zenith, sun_azimuth, time, at, SEA_LEVEL_PRESSURE, lowest)
        todo = [Frame(out, time, zenith, around, seen_at(zenith, time, at, SEA_LEVEL_PRESSURE))]
    else:
        if sun_zenith is not None or sun_azimuth is not None:
            raise ValueError("`--until` must come with `--time`, `--at` and `--frames`, without an angle of the sun")
        todo = frames_of(out, time, until, frames, at, SEA_LEVEL_PRESSURE, lowest)
        around = todo[len(todo) // 2].azimuth
    choice = None
    if allowed is not None:
        # The eye's default height counts as the ground
        observer = None if height == EYE else height
        scenes = [Scene.from_degrees(f.zenith, hemisphere(343), SPECTRUM, f.azimuth, height=observer) for f in todo]
        assert isinstance(sky, Atmosphere)
        choice = choose_for_all([(sky, scene) for scene in scenes], allowed)
        asked["solver"] = choice.solver
    view = None if field_of_view is None else float(np.radians(field_of_view))
    camera = Camera(
        projection.value, azimuth=float(np.radians(around if azimuth is None else azimuth)),
        elevation=float(np.radians(elevation)), field_of_view=view, mirrored=mirror,
    )  # fmt: skip
    if size is not None:
        width, rows = _size(size)
        camera = replace(camera, width=width, height=rows)
    if until is not None:
        begin(out, todo, {name: value for name, value in context.params.items() if name != "out"})
    with progress("rendering") as report:
        for number, frame in enumerate(todo):
            report(number, len(todo))
            if until is not None and frame.path.exists():
                continue
            picture = rendered(
                sky, camera, sun_zenith=float(np.radians(frame.zenith)), sun_azimuth=float(np.radians(frame.azimuth)),
                sun_seen_zenith=float(np.radians(frame.seen)), sun=sun.value, spectral=spectral, **asked,
            )  # fmt: skip
            if choice is not None:
                picture = replace(picture, made_by=f"{picture.made_by}, {expected_of(choice)}")
            if sun is SunName.lamp:
                picture.save_lamp(frame.path.with_suffix(".lamp.json"))
            picture.save(
                frame.path, exposure=exposure, white_balance=white_balance, tone=tone.value, space=space.value,
                half=half, spectral=spectral,
            )  # fmt: skip
    if choice is not None:
        print_choice(choice)
    if until is not None:
        _told_of(todo, out)
    else:
        say(f"{out}: {picture.told()}")
        if out.suffix == ".png":
            say(f"white: {picture.white(exposure):.4g} cd m-2")
    pictures = [
        {"file": str(f.path), "time": f.time, "sun_zenith_deg": f.zenith, "sun_azimuth_deg": f.azimuth} for f in todo
    ]
    made_by = {} if choice is None else {"choice": record_of(choice)}
    give(
        made_by | {"pictures": pictures, "projection": projection.value, "width": camera.width, "height": camera.height}
    )


def _told_of(frames, out: Path) -> None:
    """Print a summary of a time-lapse and write its contact sheet."""
    from ..draw import plot_contact_sheet
    from .printing import say, written

    first, last = frames[0], frames[-1]
    say(f"{first.path} to {last.path.name}: {first.title} to {last.title}")
    if out.suffix == ".png":
        sheet = out.with_suffix(".sheet.png")
        plot_contact_sheet([frame.path for frame in frames], [frame.title for frame in frames], sheet)
        written([sheet])


def _size(text: str) -> tuple[int, int]:
    width, cross, height = text.partition("x")
    if not (cross and width.isdigit() and height.isdigit()):
        raise ValueError(f"`--size` must be WxH in pixels, such as 1024x512, got {text!r}")
    return int(width), int(height)
