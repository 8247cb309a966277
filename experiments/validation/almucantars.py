"""Almucantars of a photometer, made by an independent vector solver and Mie code, inverted by the default question.

    python -m experiments.validation.almucantars [--cases 16]

Haze of spheres, by turns of two lognormal modes and of 22 bins of radius that no such modes make, by sasktran2's Mie
code; its sky by sasktran2's discrete ordinates with polarisation and a spherical beam. Noise of 1 %, each filter's
scale off by 0.5 %, its scan pointed 0.1 degrees off; the sky as a reader of photometer files has it (noise of 2 %,
calibration to 5 %, views of each filter). With optical depths of the beam (0.005 off, 0.01 stated) and without.
Writes experiments/results/almucantars.json.
"""

import argparse
import json
import time
from dataclasses import dataclass, replace
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np

import skyfit
from experiments.benchmarks.tiers import HERE, made_with
from experiments.validation.recovery import foreign
from skyfit.atmosphere import Exponential


RESULT = HERE / "results" / "almucantars.json"
SEED = 8
NM = np.array([440.0, 675.0, 870.0, 1020.0])
# degrees from the sun, on both sides
AZIMUTHS = (3.5, 4.0, 5.0, 6.0, 7.0, 8.0, 10.0, 12.0, 14.0, 16.0, 18.0, 20.0, 25.0, 30.0, 35.0, 40.0, 45.0, 50.0, 60.0)
AZIMUTHS += (70.0, 80.0, 90.0, 100.0, 110.0, 120.0, 130.0, 140.0, 160.0, 180.0)
MOMENTS, ANGLES, LAYERS = 360, 3601, 60
NOISE, CALIBRATION, POINTING, BEAM = 0.01, 0.005, np.radians(0.1), 0.005
# what the reader of such files takes
STATED, STATED_CALIBRATION, STATED_BEAM = 0.02, 0.05, 0.01
RANGES = {
    "sun_zenith_deg": (45.0, 70.0), "depth": (0.05, 0.8), "fine_share": (0.3, 0.95), "fine_radius": (0.11, 0.22),
    "fine_width": (0.35, 0.55), "coarse_radius": (1.6, 3.2), "coarse_width": (0.55, 0.75), "index": (1.38, 1.55),
    "absorption": (1e-3, 0.02), "ground": (0.05, 0.3),
}  # fmt: skip
RADII = np.geomspace(0.02, 20.0, 320)
BINS = np.geomspace(0.05, 15.0, 22)
# optical depth at 440 nm from which single-scattering albedo counts, as AERONET's
HAZY = 0.2


@dataclass(frozen=True)
class Spheres:
    """Haze as `sasktran2_stokes` asks for it: numbers at `NM`, that follow from one column of spheres."""

    depth: np.ndarray
    albedo: np.ndarray
    greek: dict[str, np.ndarray]

    profile = Exponential(1500.0)

    def at(self, place: int) -> "Spheres":
        """At one of the wavelengths."""
        one = slice(place, place + 1)
        return Spheres(self.depth[one], self.albedo[one], {n: table[:, one] for n, table in self.greek.items()})

    @property
    def phase(self):
        return self

    def optical_depth_at(self, wavelength_nm):
        return self.depth

    def single_scattering_albedo_at(self, wavelength_nm):
        return self.albedo

    def moments(self, count, wavelength_nm):
        return self.greek["a1"][:count]

    def matrix_moments(self, count, wavelength_nm):
        """alpha, gamma, zeta; gamma of the other sign than sasktran2's own."""
        return np.stack([self.greek["a2"][:count], -self.greek["b1"][:count], self.greek["a3"][:count]])


def spheres(volume: np.ndarray, index: complex, depth_550: float) -> Spheres:
    """The optics of dV/dln r `volume` at `RADII` by sasktran2's Mie code, scaled to an optical depth at 550 nm."""
    import sasktran2 as sk
    from sasktran2.mie.distribution import compute_greek_coefficients

    angle = np.linspace(0.0, 180.0, ANGLES)
    # numbers in each step of ln r
    number = volume / RADII**3
    mie, extinction, scattering, greek = sk.mie.LinearizedMie(), [], [], []
    for nm in (550.0, *NM):
        out = mie.calculate(2e3 * np.pi * RADII / nm, index, np.cos(np.radians(angle)), False).values
        area = number * np.pi * RADII**2
        extinction.append(np.sum(area * out.Qext))
        scattering.append(np.sum(area * out.Qsca))
        s1, s2 = out.S1, out.S2
        parts = (
            np.abs(s1) ** 2 + np.abs(s2) ** 2, np.abs(s1) ** 2 - np.abs(s2) ** 2, 2.0 * np.real(s1 * np.conj(s2)),
            2.0 * np.imag(s1 * np.conj(s2)),
        )  # fmt: skip
        p11, p12, p33, p34 = (number @ part for part in parts)
        mean = 0.5 * np.trapezoid(p11 * np.sin(np.radians(angle)), np.radians(angle))
        rows = [(p / mean)[None] for p in (p11, p12, p11, p33, p34, p33)]
        greek.append(compute_greek_coefficients(*rows, angle_grid=angle, num_coeff=MOMENTS))
    degree = 2.0 * np.arange(MOMENTS) + 1.0
    names = ("a1", "a2", "a3", "a4", "b1", "b2")
    tables = {n: np.stack([row[i][0] for row in greek[1:]], axis=1) / degree[:, None] for i, n in enumerate(names)}
    depth = depth_550 * np.array(extinction[1:]) / extinction[0]
    return Spheres(depth, np.array(scattering[1:]) / np.array(extinction[1:]), tables)


def modes(case: dict) -> np.ndarray:
    """dV/dln r of two lognormal modes, by volume in the proportion that makes about `fine_share` of the depth."""
    log = np.log(RADII)

    def mode(radius, width):
        return np.exp(-0.5 * ((log - np.log(radius)) / width) ** 2) / width

    # extinction by volume goes about as 1 / effective radius; the optics that come out are the truth
    share = case["fine_share"]
    fine, coarse = 0.5 * share * case["fine_radius"] / 0.15, (1.0 - share) * case["coarse_radius"] / 1.0
    return fine * mode(case["fine_radius"], case["fine_width"]) + coarse * mode(
        case["coarse_radius"], case["coarse_width"]
    )


def binned(volume: np.ndarray, random: np.random.Generator) -> np.ndarray:
    """The same on `BINS`, each moved by a tenth, straight between them in the logarithm of radius."""
    at = np.interp(np.log(BINS), np.log(RADII), volume) * (1.0 + 0.1 * random.standard_normal(BINS.size))
    return np.interp(np.log(RADII), np.log(BINS), at, left=0.0, right=0.0)


def fine_effective_radius(volume: np.ndarray) -> float:
    """Of what is smaller than 0.6 um, as AERONET parts the modes at the least between them."""
    inside = (RADII > 0.4) & (RADII < 1.2)
    least = RADII[inside][np.argmin(volume[inside])]
    fine = least > RADII
    return float(np.sum(volume[fine]) / np.sum(volume[fine] / RADII[fine]))


def case_of(number: int) -> tuple[dict, np.ndarray, np.random.Generator]:
    """What a case is made of, dV/dln r at `RADII` in any unit, and the generator of its noise."""
    random = np.random.default_rng([SEED, number])
    case = {name: float(random.uniform(*ends)) for name, ends in RANGES.items()}
    volume = modes(case)
    return case, binned(volume, random) if number % 2 else volume, random


def made(number: int, polarised: bool = True) -> tuple[skyfit.Sky, dict]:
    """A case's sky without the beam, and its truth."""
    case, volume, random = case_of(number)
    haze = spheres(volume, case["index"] + 1j * -case["absorption"], case["depth"])
    sun = case["sun_zenith_deg"]
    azimuth = np.concatenate([np.array(AZIMUTHS), -np.array(AZIMUTHS[:-1])])
    zenith = np.full(azimuth.size, sun)
    air = skyfit.Atmosphere(skyfit.Rayleigh(), None, skyfit.Ozone(300.0), skyfit.Ground(case["ground"]))

    off, seen = np.degrees(POINTING) * random.standard_normal((2, NM.size)), []
    for i, (up, aside) in enumerate(off.T):
        only = SimpleNamespace(constituents=(*air.constituents, haze.at(i)), ground=air.ground)
        turned = azimuth + aside / np.sin(np.radians(sun))
        stokes = foreign.sasktran2_stokes(
            only, sun, zenith + up, turned, NM[i : i + 1], polarised, "spherical", layers=LAYERS, moments=MOMENTS
        )
        seen.append(stokes[0][:, 0])
    light = np.stack(seen, axis=1)
    irradiance = np.asarray(skyfit.light.extraterrestrial_irradiance(jnp.asarray(NM), 10.0), float)
    radiance = light * irradiance * (1.0 + CALIBRATION * random.standard_normal(NM.size))
    radiance = radiance * (1.0 + NOISE * random.standard_normal(radiance.shape))
    views = np.radians(np.stack([zenith, azimuth]))
    sky = skyfit.Sky(
        radiance=radiance[None], sigma=STATED * radiance[None], usable=np.ones((1, *radiance.shape), bool),
        view_zenith=views[0], view_azimuth=views[1], wavelength_nm=NM, sun_zenith=np.radians([sun]),
        sun_azimuth=np.zeros(1), time=np.full(1, np.datetime64("NaT")), sun_distance_au=1.0, pressure_pa=101325.0,
        ozone_du=300.0, fwhm_nm=10.0, calibration_sigma=STATED_CALIBRATION, source=f"case {number}",
        view_zenith_by_wavelength=np.repeat(views[0][None, :, None], NM.size, axis=2),
        view_azimuth_by_wavelength=np.repeat(views[1][None, :, None], NM.size, axis=2),
    )  # fmt: skip
    optics = {
        f"{name}_{nm:.0f}": float(value)
        for name, row in (
            ("aerosol_optical_depth", haze.depth), ("single_scattering_albedo", haze.albedo),
            ("asymmetry", haze.greek["a1"][1]),
        )
        for nm, value in zip(NM[:3], row[:3], strict=True)
    }  # fmt: skip
    truth = {"case": case, "binned": bool(number % 2), "beam": haze.depth.tolist()}
    return sky, truth | {"optics": optics | {"fine_effective_radius": fine_effective_radius(volume)}}


def inverted(sky: skyfit.Sky, truth: dict) -> dict:
    began = time.perf_counter()
    fit = skyfit.invert(sky)
    found = skyfit.aerosol_optics(fit)
    row = {"seconds": time.perf_counter() - began, "result": fit.result[0], "steps": int(fit.steps[0])}
    row["off"] = {name: float(found[name].value[0] - value) for name, value in truth["optics"].items()}
    row["sigma"] = {name: float(found[name].sigma[0]) for name in truth["optics"]}
    row["common"], row["scale"], row["notes"] = fit.common[0].tolist(), float(fit.scale[0]), list(fit.notes)
    row["parameters"] = {n: [float(fit.values[0, i]), float(fit.sigma[0, i])] for i, n in enumerate(fit.free)}
    return row


def summary(rows: list[dict]) -> dict:
    record = {}
    for name in rows[0]["sky"]["off"]:
        record[name] = {}
        for kind in ("beam", "sky"):
            off, sigma = (np.array([row[kind][key][name] for row in rows]) for key in ("off", "sigma"))
            truth = np.array([row["truth"]["optics"][name] for row in rows])
            hazy = np.array([row["truth"]["optics"]["aerosol_optical_depth_440"] >= HAZY for row in rows])
            some = hazy if name.startswith("single") else np.ones_like(hazy)
            record[name][kind] = {
                "within_2": float(np.mean(np.abs(off[some]) < 2.0 * sigma[some])),
                "rms": float(np.sqrt(np.mean(off[some] ** 2))),
                "rms_relative": float(np.sqrt(np.mean((off[some] / truth[some]) ** 2))),
                "median_sigma": float(np.median(sigma[some])),
                "cases": int(some.sum()),
            }
    return record


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--cases", type=int, default=16)
    arguments = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    rows = []
    for number in range(arguments.cases):
        sky, truth = made(number)
        random = np.random.default_rng([SEED, number, 1])
        depth = np.array(truth["beam"]) + BEAM * random.standard_normal(NM.size)
        stated = np.full((1, NM.size), STATED_BEAM)
        beam = replace(sky, aerosol_optical_depth=depth[None], aerosol_optical_depth_sigma=stated)
        rows.append({"truth": truth, "beam": inverted(beam, truth), "sky": inverted(sky, truth)})
        for kind in ("beam", "sky"):
            row = rows[-1][kind]
            z = {n: round(v / row["sigma"][n], 1) for n, v in row["off"].items()}
            print(number, kind, row["result"], row["steps"], f"{row['seconds']:.0f} s", z, flush=True)
    record = {"summary": summary(rows), "cases": rows, "made_with": made_with(SEED, ("sasktran2",))}
    RESULT.write_text(json.dumps(record, indent=2) + "\n")
    print(json.dumps(record["summary"], indent=1))


if __name__ == "__main__":
    main()
