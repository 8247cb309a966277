"""What leaving polarisation out costs: the radiance by angle from the sun, and the haze that a fit finds.

    python -m experiments.validation.polarisation [--skies 40] [--only PART] [--out FILE.json]

`price`: a clear sky (haze 0.1) by the scalar solver over the same sky with polarisation, minus one, by skyfit and by
sasktran2, and how far apart the two are in I, Q and U. `in the air between`: what the air near the ground scatters into
level views of the light around it (`scattered_light`), where the sky of either solver counts as unpolarised.
`recovery`: sasktran2's polarised skies with 1 % noise inverted by the scalar and the polarised solver; the haze has the
polarisation that the fit assumes, and in one part another; in a third, the control, nothing is polarised.
V is left out by both: air makes none of it, and of haze it takes four scatterings (air, F34, F34, F12) to be seen in I.
"""

import argparse
import json
import pathlib
from dataclasses import replace

import jax
import numpy as np

import skyfit
from experiments.benchmarks.tiers import HERE, made_with
from experiments.studies.measured_sky import COLOURS
from experiments.validation.recovery import foreign, FREE, HAZY, NOISE, tests_module
from skyfit.atmosphere import Rayleigh
from skyfit.scene import angle_between
from skyfit.transport.dome import dome


SEED, HAZE, SUNS_DEG = 7, 0.1, (30.0, 60.0, 75.0)
SCALAR = skyfit.OrdersOfScattering.normal("flat")
POLARISED = replace(SCALAR, polarised=True)
# degrees from the sun
BINS = np.arange(0.0, 166.0, 15.0)
# stated for the model: the default stands for what a scalar one leaves out, the other for two solvers of one physics
ALLOWED, SAME_PHYSICS = skyfit.NoiseModel(), skyfit.NoiseModel(model_error=0.0005)
FITS = {
    "scalar": (SCALAR, ALLOWED),
    "scalar, no model error allowed for": (SCALAR, SAME_PHYSICS),
    "polarised": (POLARISED, SAME_PHYSICS),
    "polarised, model error allowed for": (POLARISED, ALLOWED),
}
# the same noise, and no polarisation anywhere: what is left is noise and what two scalar solvers differ by
CONTROL = "scalar, no model error allowed for"
# degree at 90 degrees from the sun of the haze that is not as assumed
OTHER_HAZE = 0.6


def by_angle(ratio: np.ndarray, angle_deg: np.ndarray) -> dict:
    """Median and extremes, per cent, of each colour and bin of the angle from the sun."""
    table = {}
    for low, high in zip(BINS[:-1], BINS[1:], strict=True):
        inside = 100.0 * ratio[(angle_deg >= low) & (angle_deg < high)]
        if not inside.size:
            continue
        table[f"{low:.0f}-{high:.0f}"] = {
            str(colour): {"median": float(np.median(c)), "min": float(np.min(c)), "max": float(np.max(c))}
            for colour, c in zip(COLOURS, inside.T, strict=True)
        }
    return table


def price(sun_deg: float, geometry: skyfit.transport.Geometry = "flat") -> dict:
    """One clear sky by both solvers of skyfit and of sasktran2."""
    plain_solver, vector_solver = (replace(solver, geometry=geometry) for solver in (SCALAR, POLARISED))
    dome = skyfit.hemisphere(300, np.radians(80.0))
    zenith, azimuth = (np.asarray(v, float) for v in (dome.zenith, dome.azimuth))
    angle = np.degrees(np.asarray(angle_between(zenith, np.radians(sun_deg), azimuth), float))
    # sasktran2 is coarse where views are neither in the zenith nor 15 degrees from it (make_sample_sky.py)
    kept = (zenith >= np.radians(15.0)) & (angle >= foreign.CLEAR_OF_SUN_DEG)
    zenith, azimuth, angle = zenith[kept], azimuth[kept], angle[kept]
    colours = np.array(COLOURS, float)
    atmosphere = skyfit.Atmosphere.from_optical_depth(HAZE)
    view = skyfit.Directions(zenith, azimuth)
    scene = skyfit.Scene.from_degrees(sun_deg, view, colours, irradiance="unit")
    scalar = np.asarray(plain_solver.radiance(atmosphere, scene))
    vector = vector_solver.stokes(atmosphere, scene)
    ours = np.stack([np.asarray(part) for part in (vector.radiance, vector.q, vector.u)])
    sky = atmosphere, sun_deg, np.degrees(zenith), np.degrees(azimuth), colours
    theirs, plain = (foreign.sasktran2_stokes(*sky, polarised=p, geometry=geometry) for p in (True, False))
    off = np.abs(ours - theirs) / theirs[:1]
    # what polarisation does to the radiance, where the scalar solvers differ too
    ratio = (scalar / ours[0]) / (plain[0] / theirs[0]) - 1.0
    return {
        "directions": int(zenith.size),
        "scalar over polarised, per cent": {
            "skyfit": by_angle(scalar / ours[0] - 1.0, angle),
            "sasktran2": by_angle(plain[0] / theirs[0] - 1.0, angle),
        },
        "largest difference from sasktran2, over its I": {
            "I, scalar from scalar": float(np.max(np.abs(scalar / plain[0] - 1.0))),
            "I, scalar from polarised": float(np.max(np.abs(scalar / theirs[0] - 1.0))),
            "I, scalar over polarised": float(np.max(np.abs(ratio))),
            **{name: float(np.max(component)) for name, component in zip(("I", "Q", "U"), off, strict=True)},
        },
        "largest degree of polarisation": float(np.max(np.asarray(vector.degree))),
    }


def in_between(sun_deg: float) -> dict:
    """Light that air scatters into level views, of a clear sky over a ground, over what polarised light gives."""
    around, weight = dome(24, 48)
    colours, atmosphere = np.array(COLOURS, float), skyfit.Atmosphere.from_optical_depth(HAZE)
    scene = skyfit.Scene.from_degrees(sun_deg, around, colours, irradiance="unit")
    vector = [np.asarray(part) for part in POLARISED.stokes(atmosphere, scene)]
    skies = {"scalar": np.asarray(SCALAR.radiance(atmosphere, scene)), "polarised": vector[0]}
    sunlight = np.asarray(SCALAR.fluxes(atmosphere, scene).direct) / np.cos(np.radians(sun_deg))
    solid_angle = np.asarray(weight / np.cos(around.zenith))
    depolarization = float(Rayleigh().phase.depolarization)
    share = (1.0 - depolarization) / (1.0 + 0.5 * depolarization)
    frame = tests_module("vector_skies").frame
    zenith, azimuth = np.degrees(around.zenith), np.degrees(around.azimuth)
    to_eye = frame(90.0, np.arange(0.0, 181.0, 15.0))[0]

    def scattered(light, zenith_deg, azimuth_deg):
        """Dipoles show the eye what vibrates across the view; `light` I, Q, U `[direction, wavelength]`."""
        radiance, q, u = light
        _, theta, phi = (to_eye @ np.reshape(e, (-1, 3)).T for e in frame(zenith_deg, azimuth_deg))
        hidden = 0.5 * (theta**2 @ (radiance + q) + phi**2 @ (radiance - q)) + (theta * phi) @ u
        every = np.sum(radiance, axis=0)[None]
        return share * 3.0 / (8.0 * np.pi) * (every - hidden) + (1.0 - share) / (4.0 * np.pi) * every

    def source(sky, q, u):
        irradiance = weight @ sky + sunlight * np.cos(np.radians(sun_deg))
        ground = np.asarray(atmosphere.ground.reflectance(colours)) * irradiance / np.pi
        below = np.broadcast_to(ground, sky.shape) * solid_angle[:, None]
        diffuse = scattered([part * solid_angle[:, None] for part in (sky, q, u)], zenith, azimuth)
        diffuse = diffuse + scattered((below, 0.0 * below, 0.0 * below), 180.0 - zenith, azimuth)
        beam = sunlight[None]
        return diffuse + scattered((beam, 0.0 * beam, 0.0 * beam), sun_deg, 0.0)

    right = source(*vector)
    off = {name: 100.0 * (source(sky, 0.0 * sky, 0.0 * sky) / right - 1.0) for name, sky in skies.items()}
    return {
        name: {
            str(colour): {"min": float(np.min(c)), "max": float(np.max(c))}
            for colour, c in zip(COLOURS, error.T, strict=True)
        }
        for name, error in off.items()
    }


def recovery(truths, fits_of=FITS, polarised: bool = True) -> dict:
    """Errors of the parameters of each kind of fit to the same noisy skies."""
    skies = [
        foreign.with_noise(foreign.sasktran2_sky(truth, NOISE, polarised=polarised), seed)
        for seed, truth in enumerate(truths)
    ]
    hazy = np.array([truth.aerosol_optical_depth >= HAZY for truth in truths])
    true = np.array([truth.values(FREE) for truth in truths])
    record = {"skies": len(truths), "hazy skies": int(hazy.sum())}
    for name, (solver, measurement) in fits_of.items():
        fits = [skyfit.invert(sky, FREE, solver, measurement=measurement) for sky in skies]
        error = np.array([fit.values[0] for fit in fits]) - true
        sigma = np.array([fit.sigma[0] for fit in fits])
        record[name] = {
            "successful": sum(fit.result == ("successful",) for fit in fits),
            "median reduced chi square": float(np.median([fit.reduced_chi_square[0] for fit in fits])),
        }
        for p, parameter in enumerate(FREE):
            # thin haze says little of its albedo
            of = hazy if parameter == "single_scattering_albedo" else np.ones_like(hazy)
            record[name][parameter] = {
                "bias": float(np.mean(error[of, p])),
                "rms": float(np.sqrt(np.mean(error[of, p] ** 2))),
                "sigma median": float(np.median(sigma[of, p])),
                "share within 2 sigma": float(np.mean(np.abs(error[of, p]) <= 2.0 * sigma[of, p])),
            }
    return record


def show(part: str, record: dict) -> None:
    print(f"\n{part}")
    if "price" in part:
        for solver, table in record["scalar over polarised, per cent"].items():
            print(f"  {solver:12s}" + "".join(f"{colour:>22d}" for colour in COLOURS))
            for angles, row in table.items():
                cells = (f"{c['median']:7.2f} ({c['min']:5.1f},{c['max']:5.1f})" for c in row.values())
                print(f"  {angles:>12s}" + "".join(f"{cell:>22s}" for cell in cells))
        for what, value in record["largest difference from sasktran2, over its I"].items():
            print(f"  {what:28s}{value:10.5f}")
        return
    if part.startswith("in the air"):
        for sky, row in record.items():
            cells = (f"{colour}: {c['min']:5.2f},{c['max']:5.2f}" for colour, c in row.items())
            print(f"  {sky:12s}" + "   ".join(cells))
        return
    for name, row in ((n, record[n]) for n in FITS if n in record):
        print(f"  {name}: {row['successful']} of {record['skies']}, chi2 {row['median reduced chi square']:.2f}")
        for parameter in FREE:
            cells = row[parameter]
            print(f"    {parameter:28s}" + "".join(f"  {key} {value:9.5f}" for key, value in cells.items()))


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--skies", type=int, default=40)
    parser.add_argument("--only", default="", help="the parts to make anew, with semicolons")
    parser.add_argument("--out", type=pathlib.Path, default=HERE / "results" / "polarisation.json")
    arguments = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    record = json.loads(arguments.out.read_text()) if arguments.out.exists() else {}
    truths = foreign.random_truths(arguments.skies, SEED)
    others = [replace(truth, polarisation=OTHER_HAZE) for truth in truths]
    parts = {f"price, sun at {sun:.0f}": lambda sun=sun: price(sun) for sun in SUNS_DEG}
    low = SUNS_DEG[-1]
    parts[f"spherical price, sun at {low:.0f}"] = lambda: price(low, "spherical")
    parts |= {f"in the air between, sun at {sun:.0f}": lambda sun=sun: in_between(sun) for sun in SUNS_DEG}
    parts["recovery"] = lambda: recovery(truths)
    parts[f"recovery, haze polarised by {OTHER_HAZE}, unknown to the fit"] = lambda: recovery(others)
    control = {CONTROL: FITS[CONTROL]}
    parts["recovery, scalar skies"] = lambda: recovery(truths, control, polarised=False)
    for name, make in parts.items():
        if arguments.only and name not in arguments.only.split(";"):
            continue
        record[name] = make()
        show(name, record[name])
        record["made_with"] = made_with(SEED, ("optimistix", "sasktran2")) | {"noise": NOISE, "haze": HAZE}
        arguments.out.parent.mkdir(exist_ok=True)
        arguments.out.write_text(json.dumps(record, indent=1) + "\n")


if __name__ == "__main__":
    main()
