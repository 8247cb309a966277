"""Sunlight by Preetham's A.1 against the ground's sun of others: spectrum, colour, luminance.

The paper (sec. 3.1) found turbidity 2 within 2 % of Wyszecki & Stiles' chromaticity and luminance of the sun. Those
numbers were not to be had; ASTM G173's direct beam, SPECTRL2 and the sun of lighting engineering stand for them.
"""

import importlib
import json
import math
import platform
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pvlib

import skyfit
from skyfit.atmosphere import angstrom_coefficient
from skyfit.scene import relative_airmass


RESULT = Path(__file__).resolve().parents[1] / "results" / "sunlight.json"
NM = np.arange(380.0, 781.0)
# zenith angle of airmass 1.5
G173_SUN = 48.19
# ASTM G173-03: aerosol optical depth at 500 nm, ozone (m at NTP), precipitable water (m)
G173_DEPTH, G173_OZONE, G173_WATER = 0.084, 0.003438, 0.0142


def scene_of(sun_deg, nm, irradiance="astm_g173"):
    return skyfit.Scene.from_degrees(sun_deg, skyfit.hemisphere(1), nm, irradiance=irradiance)


def colour_of(radiance, nm):
    return dict(zip(("x", "y", "Y"), np.asarray(skyfit.xyY(radiance, nm)).tolist(), strict=True))


def against_g173():
    table = pvlib.spectrum.get_reference_spectra(standard="ASTM G173-03")["direct"]
    standard = colour_of(jnp.asarray(table.reindex(NM).to_numpy()), NM)
    same = (G173_DEPTH * 0.5**1.3 + 0.04586) / 0.04608
    rows = []
    for name, sunlight in (
        ("its own haze, ozone and water", skyfit.Sunlight(same, ozone=G173_OZONE, water_vapour=G173_WATER)),
        ("turbidity 2, the defaults", skyfit.Sunlight(2.0)),
    ):
        ours = colour_of(sunlight.irradiance(scene_of(G173_SUN, NM)), NM)
        percent = {key: 100.0 * (ours[key] / standard[key] - 1.0) for key in standard}
        rows.append({"with": name, "turbidity": float(sunlight.turbidity), "ours": ours, "error_percent": percent})
    return {"standard": standard, "rows": rows}


def against_spectrl2():
    table = importlib.import_module("pvlib.spectrum.spectrl2")._SPECTRL2_COEFFS
    distance = pvlib.irradiance.get_extra_radiation(93, solar_constant=1.0, method="spencer")
    rows = []
    for sun in (0.0, 48.19, 60.0, 80.0):
        airmass = float(relative_airmass(np.radians(sun)))
        depth = float(angstrom_coefficient(2.0)) * 0.5**-1.3
        beam = pvlib.spectrum.spectrl2(sun, sun, 0.0, 0.0, 101325.0, airmass, 2.0, 0.35, depth, dayofyear=93, alpha=1.3)
        nm = beam["wavelength"]
        some = (nm >= 380.0) & (nm <= 780.0)
        expected = (np.ravel(beam["dni"]) / (table["spectral_irradiance_et"] * distance))[some]
        error = 100.0 * (np.asarray(skyfit.Sunlight(2.0).transmittance(np.radians(sun), nm[some])) / expected - 1.0)
        nm = nm[some]
        band = ((nm > 680.0) & (nm < 700.0)) | ((nm > 710.0) & (nm < 740.0)) | ((nm > 745.0) & (nm < 775.0))
        rows.append(
            {
                "sun_zenith_deg": sun,
                "median_abs_percent": float(np.median(np.abs(error[~band]))),
                "max_abs_percent": float(np.max(np.abs(error[~band]))),
                "max_abs_percent_in_bands": float(np.max(np.abs(error[band]))),
            }
        )
    return rows


def luminance_of_the_disc():
    """At turbidity 2 with the paper's own solar spectrum, against gensky's 1.5e9 (1.147 - 0.147 / sin h) cd m^-2."""
    nm = np.arange(380.0, 751.0, 10.0)
    rows = []
    for sun in (0.0, 30.0, 48.19, 60.0, 75.0):
        ours = colour_of(skyfit.Sunlight(2.0).radiance(scene_of(sun, nm, "preetham")), nm)
        gensky = 1.5e9 * (1.147 - 0.147 / math.cos(math.radians(sun)))
        rows.append({"sun_zenith_deg": sun, **ours, "gensky": gensky, "percent": 100.0 * (ours["Y"] / gensky - 1.0)})
    return rows


def main():
    jax.config.update("jax_enable_x64", True)
    result = {
        "versions": {"jax": jax.__version__, "numpy": np.__version__, "pvlib": pvlib.__version__},
        "dtype": "float64",
        "machine": platform.machine(),
        "astm_g173_direct": against_g173(),
        "spectrl2_direct_normal": against_spectrl2(),
        "luminance_of_the_disc": luminance_of_the_disc(),
    }
    RESULT.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    print(RESULT.read_text(encoding="utf-8"))


if __name__ == "__main__":
    main()
