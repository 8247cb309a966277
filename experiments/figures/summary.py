"""The README's one table."""


def summary(record: dict, measured: dict, recovery: dict, refit: dict, space: dict) -> str:
    """The README's one table: what is compared, with what, how far apart."""
    by_oracle = {
        (row["solver"], row["preset"], row["geometry"], row["max_sun_zenith"]): row for row in record["oracles"]
    }
    lines = ["| what | against | median error | max error |", "|---|---|---|---|"]

    def error(what, against, row):
        middle, most = (100 * row[key] for key in ("median_relative_error", "max_relative_error"))
        lines.append(f"| {what} | {against} | {middle:.2g} % | {most:.2g} % |")

    sun_85 = [key for key in by_oracle if key[:3] == ("orders", "normal", "flat")][0]
    sun_80 = min(key for key in by_oracle if key[:3] == ("orders", "normal", "spherical"))
    error("single scattering, `normal`, sun to 95°", "quadrature", by_oracle[("single", "normal", "spherical", 95.0)])
    error("all orders, `normal`, flat, to 85°", "discrete ordinates, 32 streams", by_oracle[sun_85])
    error("all orders, `normal`, spherical, to 80°", "Monte Carlo (itself 0.1-0.4 %)", by_oracle[sun_80])
    whole = space["solvers"]["spherical"]["ranges"]
    for span, sun in (("sun <= 89", "to 89°"), ("sun 89-96", "89-96°"), ("sun 96-108", "96-108°")):
        row = {"median_relative_error": whole[span]["median"], "max_relative_error": whole[span]["worst"]}
        error(f"`Spherical.normal`, ground to space, sun {sun}", "Monte Carlo (itself 0.1-0.7 %)", row)
    vector = next(row for row in record["vector"]["rows"] if row["preset"] == "normal" and row["polarised"])
    error("polarised, `normal`, air of optical depth to 1", "tables of Natraj et al. 2009", vector)
    best = min(measured["peers"], key=lambda name: measured["peers"][name]["all"])
    lines += [
        "",
        f"Eight measured skies (Kider et al. 2014) are fitted to {measured['alone']['all']:.1f} mW m⁻² sr⁻¹ nm⁻¹ RMSE; "
        f"the best unfitted model of others, {best}, has {measured['peers'][best]['all']:.1f}.",
    ]
    depth = recovery["sasktran2 flat, normal"]["parameters"]["aerosol_optical_depth"]
    extended = refit["extended"]["held_out"]["overall"]["refitted"]
    lines += [
        f"In 100 skies of sasktran2 with 1 % noise, {100 * depth['share within 2 sigma']:.0f} % of the aerosol optical "
        "depths are within two sigma.",
        "`ExtendedPreetham` has the luminance of skies it has not seen to "
        f"{100 * extended['luminance']:.1f} % (median).",
        "[docs/accuracy.md](docs/accuracy.md) has all tables, and time beside error.",
    ]
    return "\n".join(lines)
