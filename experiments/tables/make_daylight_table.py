"""Writes the CIE daylight basis of data/ from the one that colour-science ships."""

from pathlib import Path

import colour
from colour.colorimetry import SDS_BASIS_FUNCTIONS_CIE_ILLUMINANT_D_SERIES


TABLE = Path(__file__).resolve().parents[2] / "data" / "cie_daylight_basis.csv"
HEADER = (
    "# source: CIE 015:2018, components of the relative spectral distribution of daylight (Judd et al. 1964)",
    "# columns: wavelength_nm nm; s0 mean, s1 and s2 first two characteristic vectors, relative power",
    "# every 10 nm as measured, between them the mean of both neighbours, as the CIE interpolates",
    f"# extracted by experiments/tables/make_daylight_table.py from colour-science {colour.__version__}",
    "# licence: BSD-3-Clause (colour-science, Copyright 2013 Colour Developers)",
    "wavelength_nm,s0,s1,s2",
)


def main():
    basis = [SDS_BASIS_FUNCTIONS_CIE_ILLUMINANT_D_SERIES[name] for name in ("S0", "S1", "S2")]
    rows = zip(basis[0].wavelengths, *(component.values for component in basis), strict=True)
    lines = [*HEADER, *(",".join(f"{value:.12g}" for value in row) for row in rows)]
    TABLE.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
