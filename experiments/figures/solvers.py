"""Tables of the solvers: against oracles, polarised, at every height, by tolerance, in hard cases."""

from .marks import GEOMETRIES, milliseconds


def tables(record: dict) -> str:
    """The README's tables as Markdown."""
    lines = [
        "| solver | preset | geometry | sun, view to | max error | median error | one sky (343 x 41) |",
        "|---|---|---|---|---|---|---|",
    ]
    for row in record["oracles"]:
        lines.append(
            f"| {row['solver']} | {row['preset']} | {row['geometry']} "
            f"| {row['max_sun_zenith']:.0f}°, {row['max_view_zenith']:.0f}° "
            f"| {100 * row['max_relative_error']:.2g} % | {100 * row['median_relative_error']:.2g} % "
            f"| {1e3 * row['seconds_per_sky']:.1f} ms |"
        )
    lines += [
        "",
        "Flat: against 32-stream discrete ordinates (nanodisort); spherical: against backward Monte Carlo, whose own",
        "standard error is 0.1-0.4 %. The larger of a Rayleigh and an aerosol file is shown. Times are float32 on "
        f"{record['made_with']['machine']}.",
        "",
        "| the sample sky (sasktran2, polarised, 1 % noise) | truth | recovered |",
        "|---|---|---|",
    ]
    for name, entry in record["sample"]["parameters"].items():
        lines.append(f"| {name.replace('_', ' ')} | {entry['truth']:g} | {entry['value']:.5g} ± {entry['sigma']:.2g} |")
    return "\n".join(lines)


def polarised(record: dict, fits: dict) -> str:
    """What leaving polarisation out costs, and what taking it along does: against tables, in time, in fits."""
    lines = [
        "| air of optical depth 0.02-1 against vector tables (Natraj et al. 2009) | max error | median error "
        "| max error of Q, U over I | one sky (343 x 41) |",
        "|---|---|---|---|---|",
    ]
    cost, noise = record["polarised_over_scalar"], fits["made_with"]["noise"]
    for row in record["vector"]["rows"]:
        name, of_q_u = f"{row['preset']}, {'polarised' if row['polarised'] else 'scalar'}", row["max_error_q_u_over_i"]
        lines.append(
            f"| orders {name} | {100 * row['max_relative_error']:.2g} % | {100 * row['median_relative_error']:.2g} % "
            f"| {'-' if of_q_u is None else f'{100 * of_q_u:.2g} %'} | {milliseconds(cost['presets'][name])} ms |"
        )
    of_radiance, of_gradient, of_jacobian = (
        " and ".join(f"{cost[geometry][kind]['polarised over scalar']:.3g}" for geometry in GEOMETRIES)
        for kind in ("radiance", "gradient", "jacobian")
    )
    clear = ("{:.1f} to {:.1f} % off at {} nm".format(*_extremes(fits, colour), colour) for colour in ("383", "710"))
    names = {
        "aerosol_optical_depth": "optical depth",
        "angstrom_exponent": "the Angstrom exponent",
        "single_scattering_albedo": "single-scattering albedo",
    }

    def off(fit):
        return ", ".join(f"{fit[key]['rms']:.2g} in {words}" for key, words in names.items())

    def within(fit):
        shares = [row["share within 2 sigma"] for row in fit.values() if isinstance(row, dict)]
        return f"{100 * min(shares):.0f}-{100 * max(shares):.0f} %"

    same, other = (fits[part] for part in ("recovery", "recovery, haze polarised by 0.6, unknown to the fit"))
    allowed = other["polarised, model error allowed for"]
    lines += [
        "",
        "Flat, ground albedo 0-0.8, sun and view to 84°, float32; fastest of runs in turns. Polarised over scalar,",
        f"flat and spherical: {of_radiance} times as long for the radiance, {of_gradient} for its gradient,",
        f"{of_jacobian} for its Jacobian to 8 parameters. In a clear sky (haze {fits['made_with']['haze']:g}, "
        "sun at 30-75°)",
        f"the scalar solver is {' and '.join(clear)}. Fitted to",
        f"{same['skies']} polarised skies of sasktran2 with {100 * noise:.0f} % noise, it is off by",
        f"{off(same['scalar'])} (rms);",
        f"the polarised one by {off(same['polarised'])},",
        f"with {within(same['polarised'])} of the truths, by parameter, within 2 sigma of the noise. Where haze",
        f"polarises by 0.6 and the fit assumes 0.25, it is off by {off(other['polarised'])};",
        f"{within(other['polarised'])} within 2 sigma of the noise, {within(allowed)} with the default model error.",
    ]
    return "\n".join(lines)


def from_every_height(record: dict) -> str:
    """Polarised light at the bottom, inside and at the top of five atmospheres, against Monte Carlo."""
    lines = [
        "| every height, views up and down, flat (Emde et al. 2015) | points | z rms of I, Q, U "
        "| beyond 3 sigma, of I | points within |",
        "|---|---|---|---|---|",
    ]
    for preset in ("fine", "normal"):
        for case, row in record[preset].items():
            z = ", ".join(f"{row[name]['z rms']:.2f}" for name in "IQU")
            beyond, share = (
                pick(row[name][key] for name in "IQU") for pick, key in ((max, "beyond 3 sigma"), (min, "within"))
            )
            lines.append(
                f"| {case[:2].upper()}{case[2:]}, {preset} | {row['points']} | {z} | {100 * beyond:.2g} % "
                f"| {100 * share:.4g} % |"
            )
    worst = max(row[name]["z rms"] for case, row in _observers(record["fine"]) for name in "IQU" if "by" not in case)
    lines += [
        "",
        "Deviations from MYSTIC over its standard errors; what three of these leave of the largest, over I; the share",
        f"of points within {100 * record['target']['beyond 3 sigma']:.2g} % and three of them. A3's table is read as",
        f"MYSTIC reads it; by splines it is another. The largest z of `fine` at one height, up or down: {worst:.2f}.",
    ]
    return "\n".join(lines)


def _observers(cases: dict) -> list[tuple[str, dict]]:
    return [(case, row) for case, record in cases.items() for row in record["observers"].values()]


def _extremes(fits: dict, colour: str) -> tuple[float, float]:
    """Least and largest price in per cent, over suns and angles."""
    rows = [
        cells[colour]
        for part, record in fits.items()
        if part.startswith("price")
        for cells in record["scalar over polarised, per cent"]["skyfit"].values()
    ]
    return min(row["min"] for row in rows), max(row["max"] for row in rows)


def ground_to_space(record: dict) -> str:
    """Solvers from the ground to space and from noon to night: errors, size, time."""
    lines = [
        "| ground to space, Monte Carlo | " + " | ".join(record["tolerance"]) + " | field | prepare | 343 views |",
        "|---|" + "---|" * (len(record["tolerance"]) + 3),
    ]
    for name, row in record["solvers"].items():
        cells = []
        for span in record["tolerance"]:
            part = row["ranges"][span]
            if "median" not in part:
                cells.append("refused")
                continue
            refused = f", {part['refused']} of {part['lines']} refused" if part["refused"] else ""
            within = f"{100 * part['within tolerance + 3 sigma']:.3g} %"
            median = 100 * part["median"]
            cells.append(f"{median:.2g}" if median < 99.5 else f"{median:.0f}")
            cells[-1] += f" % ({within}{refused})"
        cost = row["cost"]
        prepare = next((f"{value:.2g} s" for key, value in cost.items() if key.startswith("prepare 1")), "-")
        size = f"{cost['field, bytes'] / 1e6:.2g} MB" if "field, bytes" in cost else "-"
        lines.append(
            f"| {name} | " + " | ".join(cells) + f" | {size} | {prepare} "
            f"| {1e3 * cost['lookup of 343 directions, s']:.2g} ms |"
        )
    tolerances = ", ".join(f"{100 * value:g}" for value in record["tolerance"].values())
    lines += [
        "",
        "Three atmospheres, observers at 0, 10, 30 and 400 km, by zenith angle of the sun: median error and, in",
        f"brackets, the share of lines within {tolerances} % and three standard errors of the Monte Carlo. One",
        "wavelength; times are of shared cores under whatever else they did.",
    ]
    return "\n".join(lines)


def by_tolerance(record: dict) -> str:
    """What `choose` and `estimate_error` make of scenes held out."""
    lines = [
        "| `choose`, scenes held out | judged | within the tolerance | no solver found | expected over true error | "
        "time within 1.5 x the best |",
        "|---|---|---|---|---|---|",
    ]
    for tolerance, row in record["tolerances"].items():
        lines.append(
            f"| {tolerance} | {row['judged']} of {row['scenes']} | {100 * row['within the tolerance']:.1f} % | "
            f"{row['no solver found']} | {row['median of expected over true error']:.1f} | "
            f"{100 * row['time within 1.5 x the best']:.0f} % |"
        )
    every = record["estimate_error"]["all"]
    lines += [
        "",
        "Largest errors of a scene, against `OrdersOfScattering.fine(polarised=True)`; the others are given to `fine`",
        "itself, or no solver was found. The best is the cheapest that would have done, in hindsight. The bound",
        f"of `estimate_error` holds in {100 * every['covered']:.1f} % of ten programs' answers, at "
        f"{every['median ratio']:.1f} times the true error in the median.",
    ]
    return "\n".join(lines)


def hard(record: dict) -> str:
    """What becomes of random scenes over all that a scene can be."""
    lines = [
        "| random scenes | scenes | not finite | negative | with gradients | of them not finite | "
        "float32 farther than 1e-3 from float64, of spectra |",
        "|---|---|---|---|---|---|---|",
    ]
    for name, row in record["programs"].items():
        bad = [sum(row[dtype][what] for dtype in ("float32", "float64")) for what in ("not finite", "negative")]
        slopes, far = row["scenes with gradients"], row["float32 farther than 1e-3"]
        wrong = row["float32"].get("gradients not finite", 0) + row["float64"].get("gradients not finite", 0)
        lines.append(
            f"| {name} | {row['scenes']} | {bad[0]} | {bad[1]} | {slopes} | {wrong if slopes else '-'} | "
            f"{far} of {row['spectra']} |"
        )
    lines += [
        "",
        "A Sobol sequence over suns, views, heights, haze (optical depth to 50, asymmetry of -0.95 to 0.999), ground,",
        "ozone and wavelengths, `draft`, in float32 and float64. No radiance is negative because what streams",
        "leave below nothing is nothing: such views, under thick haze that absorbs or scatters backward, are black,",
        "not right.",
    ]
    return "\n".join(lines)
