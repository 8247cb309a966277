"""The zenith sky after sunset against measurements: Patat et al. 2006 over Paranal, U B V R I, nothing fitted.

    python -m experiments.validation.twilight [--preset normal]

`Spherical` in air of the US Standard Atmosphere 1976 above 2635 m, haze of 0.03 at 550 nm and 270 DU of ozone; the dark
sky of the site is added. Also without ozone, and with the sun half of the refraction at its setting higher, which makes
good most of what straight rays miss at 550 nm (experiments/validation/refraction.py). Writes
experiments/results/twilight.json and twilight.png.
"""

import argparse
import json

import numpy as np

import skyfit
from experiments.benchmarks.tiers import HERE, made_with
from skyfit.atmosphere import pressure_at_altitude
from skyfit.light import extraterrestrial_irradiance
from skyfit.measured.solar_position import refraction


RESULT, PICTURE = HERE / "results" / "twilight.json", HERE / "results" / "twilight.png"
ALTITUDE = 2635.0
# A&A 455, 385: m = a0 + a1 x + a2 x^2, mag arcsec^-2, x degrees of the sun's zenith angle beyond 95
MEASURED = {
    "U": (11.78, 1.376, -0.039), "B": (11.84, 1.411, -0.041), "V": (11.84, 1.518, -0.057),
    "R": (11.40, 1.567, -0.064), "I": (10.93, 1.470, -0.062),
}  # fmt: skip
# the Sun as they quote it: V -26.74, U-B 0.13, B-V 0.65, V-R 0.52, V-I 0.81
SUN = {"U": -25.96, "B": -26.09, "V": -26.74, "R": -27.26, "I": -27.55}
# effective wavelengths and widths, nm: Bessell 2005, ARA&A 43, 293, Table 1; taken as Gaussians of that width
BANDS = {"U": (366.3, 65.0), "B": (436.1, 89.0), "V": (544.8, 84.0), "R": (640.7, 158.0), "I": (798.0, 154.0)}
# the dark sky of Paranal, mag arcsec^-2: Patat 2003, A&A 400, 1183
DARK = {"U": 22.28, "B": 22.64, "V": 21.61, "R": 20.87, "I": 19.71}
ARCSEC2 = (np.pi / 180.0 / 3600.0) ** 2
# zenith angles of the sun, degrees
SUNS = np.arange(95.0, 103.01, 0.5)
NM = np.arange(310.0, 1000.0, 15.0)


def atmosphere_of(ozone: float) -> skyfit.Atmosphere:
    """Air above the station, whose ground it stands on."""
    whole = skyfit.Levels.us_standard_1976()
    height, density = np.asarray(whole.height), np.asarray(whole.density_at)
    above = height > ALTITUDE
    ground = np.exp(np.interp(ALTITUDE, height, np.log(density)))
    profile = skyfit.Levels(
        np.concatenate([[0.0], height[above] - ALTITUDE]), np.concatenate([[ground], density[above]])
    )
    air = skyfit.Rayleigh(pressure=float(pressure_at_altitude(ALTITUDE)), profile=profile)
    layer = skyfit.OzoneLayer(height=20e3 - ALTITUDE)
    haze = skyfit.Aerosol(0.03, profile=skyfit.Exponential(1200.0))
    gas = skyfit.Ozone(column=ozone, profile=layer) if ozone else None
    return skyfit.Atmosphere(rayleigh=air, aerosol=haze, ozone=gas)


def magnitudes(solver: skyfit.Spherical, ozone: float, lifted: float = 0.0) -> dict[str, np.ndarray]:
    """Zenith sky in mag arcsec^-2 under `SUNS` that stand some degrees higher, the dark sky in it."""
    suns = SUNS - lifted
    field = solver.prepare(atmosphere_of(ozone), NM, sun_zenith=np.radians(suns[[0, -1]]))
    up = skyfit.Directions(np.zeros(1), np.zeros(1))
    sunlight = np.asarray(extraterrestrial_irradiance(NM, None, "astm_g173"))
    scenes = [skyfit.Scene.from_degrees(sun, up, NM, irradiance="unit") for sun in suns]
    light = np.stack([np.asarray(field.radiance(scene))[0] for scene in scenes])
    found = {}
    for band, (centre, width) in BANDS.items():
        weight = sunlight * NM * np.exp(-4.0 * np.log(2.0) * ((NM - centre) / width) ** 2)
        scattered = light @ weight / weight.sum() * ARCSEC2
        sky = 10.0 ** (-0.4 * SUN[band]) * scattered
        found[band] = -2.5 * np.log10(sky + 10.0 ** (-0.4 * DARK[band]))
    return found


def main():
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--preset", default="normal", choices=("draft", "normal", "fine"))
    given = arguments.parse_args()
    solver = getattr(skyfit.Spherical, given.preset)()
    ours, grey = magnitudes(solver, 270.0), magnitudes(solver, 0.0)
    half = 0.5 * float(refraction(np.array([-5.0]), float(pressure_at_altitude(ALTITUDE)))[0])
    higher = magnitudes(solver, 270.0, half)
    beyond = SUNS - 95.0
    rows = {}
    for band, (a0, a1, a2) in MEASURED.items():
        last = 103.0 if band in "UB" else 101.0
        judged = SUNS <= last
        measured = a0 + a1 * beyond + a2 * beyond**2
        slope, lifted = (np.gradient(m[band], SUNS) - (a1 + 2.0 * a2 * beyond) for m in (ours, higher))
        rows[band] = {
            "suns_deg": [95.0, last],
            "measured": measured.tolist(),
            "model": ours[band].tolist(),
            "model_without_ozone": grey[band].tolist(),
            "model_half_refraction": higher[band].tolist(),
            "largest_difference_mag": float(np.max(np.abs(ours[band] - measured)[judged])),
            "largest_slope_difference_mag_per_deg": float(np.max(np.abs(slope)[judged][1:-1])),
            "largest_difference_without_ozone_mag": float(np.max(np.abs(grey[band] - measured)[judged])),
            "largest_difference_half_refraction_mag": float(np.max(np.abs(higher[band] - measured)[judged])),
            "largest_slope_difference_half_refraction_mag_per_deg": float(np.max(np.abs(lifted)[judged][1:-1])),
        }
    record = {
        "made_with": made_with(None),
        "solver": given.preset,
        "half_refraction_deg": half,
        "suns_deg": SUNS.tolist(),
        "bands": rows,
    }
    RESULT.write_text(json.dumps(record, indent=1) + "\n")
    draw(rows)
    for band, row in rows.items():
        print(
            f"{band}: {row['largest_difference_mag']:.2f} mag, slope {row['largest_slope_difference_mag_per_deg']:.2f} "
            f"mag/deg; without ozone {row['largest_difference_without_ozone_mag']:.2f} mag; half of the refraction "
            f"{row['largest_difference_half_refraction_mag']:.2f} mag, slope "
            f"{row['largest_slope_difference_half_refraction_mag_per_deg']:.2f} mag/deg"
        )


def draw(rows):
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    figure, (left, right) = plt.subplots(1, 2, figsize=(10.0, 4.4), layout="constrained")
    colours = {"U": "tab:purple", "B": "tab:blue", "V": "tab:green", "R": "tab:red", "I": "tab:brown"}
    for band, row in rows.items():
        left.plot(SUNS, row["measured"], "o", ms=3, color=colours[band], label=f"{band}, measured")
        left.plot(SUNS, row["model"], color=colours[band])
        left.plot(SUNS, row["model_half_refraction"], "--", color=colours[band])
        left.plot(SUNS, row["model_without_ozone"], ":", color=colours[band])
    left.invert_yaxis()
    left.set(xlabel="sun zenith angle, degrees", ylabel="zenith sky, mag arcsec$^{-2}$")
    left.legend(
        fontsize=8, title="lines: Spherical; dashed: half of the refraction; dotted: no ozone", title_fontsize=8
    )
    for one, other in ("UB", "BV", "VR", "VI"):
        colour = {name: np.array(rows[one][name]) - np.array(rows[other][name]) for name in ("measured", "model")}
        line = right.plot(SUNS, colour["model"], label=f"{one} - {other}")[0]
        right.plot(SUNS, colour["measured"], "o", ms=3, color=line.get_color())
        bare = np.array(rows[one]["model_without_ozone"]) - np.array(rows[other]["model_without_ozone"])
        right.plot(SUNS, bare, ":", color=line.get_color())
    right.set(xlabel="sun zenith angle, degrees", ylabel="colour, mag")
    right.legend(fontsize=8)
    figure.savefig(PICTURE, dpi=110)


if __name__ == "__main__":
    main()
