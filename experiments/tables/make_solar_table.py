"""Writes the solar and gas absorption tables of data/ from those that pvlib ships."""

import importlib
from pathlib import Path

import pvlib


DATA = Path(__file__).resolve().parents[2] / "data"
LICENCE = (
    f"# extracted by experiments/tables/make_solar_table.py from pvlib {pvlib.__version__}",
    "# licence: BSD-3-Clause (pvlib-python, Copyright (c) pvlib-python contributors)",
)


def write(name, header, columns, rows):
    lines = [*header, *LICENCE, ",".join(columns)]
    lines += [",".join(f"{float(value):.12g}" for value in row) for row in rows]
    (DATA / name).write_text("\n".join(lines) + "\n", encoding="utf-8")


def main():
    spectra = pvlib.spectrum.get_reference_spectra(standard="ASTM G173-03")
    solar = spectra["extraterrestrial"].loc[280.0:1130.0]
    write(
        "astm_g173_extraterrestrial.csv",
        (
            "# source: ASTM G173-03 Reference Solar Spectral Irradiances, column extraterrestrial",
            "# columns: wavelength_nm nm; irradiance W m-2 nm-1 on a plane normal to the sun at",
            "# the mean Earth-Sun distance. Steps 0.5 nm to 400 nm, 1 nm beyond. Used from",
            "# 300 to 1100 nm: the ends are the margin of a convolution with a line shape.",
        ),
        ("wavelength_nm", "irradiance"),
        zip(solar.index, solar.to_numpy(), strict=True),
    )
    # the table has no public name in pvlib; `pvlib.spectrum.spectrl2` itself is the function
    gases = importlib.import_module("pvlib.spectrum.spectrl2")._SPECTRL2_COEFFS
    names = ("wavelength", "ozone_absorption", "water_vapor_absorption", "mixed_absorption")
    write(
        "spectrl2_absorption.csv",
        (
            "# source: Bird and Riordan 1986, Simple Solar Spectral Model (SPECTRL2), Table 1;",
            "# ozone, water vapour and mixed gases there after Leckner 1978, partly adjusted",
            "# columns: wavelength_nm nm;",
            "# ozone_absorption a_o, per atm-cm: exp(-a_o l m), l in atm-cm (300 DU = 0.3 atm-cm);",
            "# water_absorption a_w, per cm of precipitable water W:",
            "#   exp(-0.2385 a_w W m / (1 + 20.07 a_w W m)^0.45);",
            "# mixed_gas_absorption a_u, dimensionless, m' pressure-corrected airmass:",
            "#   exp(-1.41 a_u m' / (1 + 118.3 a_u m')^0.45)",
            "# Steps are irregular, 5 nm and more; the bands are those of a 10 nm model.",
        ),
        ("wavelength_nm", "ozone_absorption", "water_absorption", "mixed_gas_absorption"),
        ([row[name] for name in names] for row in gases if row["wavelength"] <= 1130.0),
    )


if __name__ == "__main__":
    main()
