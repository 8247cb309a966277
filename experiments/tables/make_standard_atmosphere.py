"""Writes data/us_standard_atmosphere_1976.csv from the formulas of the standard as the package `fluids` has them."""

from pathlib import Path

import fluids
from fluids.atmosphere import ATMOSPHERE_1976


DATA = Path(__file__).resolve().parents[2] / "data"
# m, geometric: 1 km and 2 km where the air is, and wider where little is left
HEIGHTS = (*range(0, 12000, 1000), *range(12000, 34000, 2000), *range(35000, 86000, 5000), 86000)
HEADER = (
    "# source: US Standard Atmosphere 1976 (NOAA, NASA, USAF), by its formulas to 86 km",
    "# columns: height_m m, geometric, above sea level; temperature_k K; pressure_pa Pa; density_kg_m3 kg m-3",
    f"# made by experiments/tables/make_standard_atmosphere.py with fluids {fluids.__version__} (MIT licence)",
    "# licence: public domain, a work of the United States government",
)


def main():
    lines = [*HEADER, "height_m,temperature_k,pressure_pa,density_kg_m3"]
    for height in HEIGHTS:
        air = ATMOSPHERE_1976(float(height))
        lines.append(f"{height},{air.T:.6g},{air.P:.7g},{air.rho:.7g}")
    (DATA / "us_standard_atmosphere_1976.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
