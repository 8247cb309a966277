"""Puts the figures of experiments/results/*.json into README.md and pages of docs/, between their markers."""

import json
import pathlib


HERE = pathlib.Path(__file__).resolve().parent
README = HERE.parent / "README.md"
ACCURACY = HERE.parent / "docs" / "accuracy.md"
VALIDATION = HERE.parent / "docs" / "validation.md"
RESULT = HERE / "results" / "accuracy.json"
BENCHMARK = HERE / "results" / "benchmark.json"
REFIT = HERE / "results" / "refit.json"
FITS = HERE / "results" / "perez_fits.json"
AERIAL = HERE / "results" / "aerial_perspective.json"
DOME = HERE / "results" / "dome_speed.json"
MEASURED = HERE / "results" / "measured_sky.json"
RECOVERY = HERE / "results" / "recovery.json"
INVERSION = HERE / "results" / "inversion_speed.json"
MANY = HERE / "results" / "fit_many.json"
POLARISATION = HERE / "results" / "polarisation.json"
SPACE = HERE / "results" / "space.json"
CHOOSE = HERE / "results" / "choose.json"
HARD = HERE / "results" / "hard_cases.json"
IPRT = HERE / "results" / "iprt.json"
ALMUCANTARS = HERE / "results" / "almucantars.json"
SIZE_BINS = HERE / "results" / "size_bins.json"
BARS = HERE / "results" / "error_bars.json"
TWILIGHT = HERE / "results" / "twilight.json"
SUNLIGHT = HERE / "results" / "sunlight.json"
CONTINUITY = HERE / "results" / "continuity.json"
LIGHTING, SHADER = HERE / "results" / "lighting.json", HERE / "results" / "shader_page.json"
GEOMETRIES = ("flat", "spherical")
TABLES = "<!-- figures of experiments/results/accuracy.json -->", "<!-- end of figures -->"
SUMMARY = "<!-- summary of experiments/results -->", "<!-- end of summary -->"
VALIDATED = "<!-- validation of experiments/results -->", "<!-- end of validation -->"
PRINTED = "<!-- printed fit of experiments/results/accuracy.json -->", "<!-- end of printed fit -->"


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
            f"| {'-' if of_q_u is None else f'{100 * of_q_u:.2g} %'} | {_milliseconds(cost['presets'][name])} ms |"
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


def inverted(measured: dict, recovery: dict, speed: dict, many: dict) -> str:
    """The tables of inversions: measured skies beside the peers, skies of other solvers, speed."""
    together = [half for half in measured["halves"] if half["fit"] == "together"]
    held = {
        key: sorted(half[key] for half in together) for key in ("held_out", "held_out_beyond_20", "held_out_beyond_10")
    }
    middle = {key: values[len(values) // 2] for key, values in held.items()}
    peers = measured["peers"]
    best = sorted(peers, key=lambda name: peers[name]["all"])[:2]
    lines = [
        "| eight measured skies (Kider et al. 2014), RMSE in mW m⁻² sr⁻¹ nm⁻¹ | all | beyond 20° of the sun |",
        "|---|---|---|",
        f"| fitted together, one aerosol and calibration for the day | {measured['together']['all']:.2f} "
        f"| {measured['together']['beyond_20']:.2f} |",
        f"| each fitted by itself | {measured['alone']['all']:.2f} | {measured['alone']['beyond_20']:.2f} |",
        f"| together, on directions held out (median of {len(together)} random halves) | {middle['held_out']:.2f} "
        f"| {middle['held_out_beyond_20']:.2f} |",
        *(f"| {name}, not fitted | {peers[name]['all']:.1f} | {peers[name]['beyond_20']:.1f} |" for name in best),
        f"| Preetham 1999, not fitted | {peers['preetham']['all']:.1f} | {peers['preetham']['beyond_20']:.1f} |",
        "",
        "Held out over all is ruled by one direction 4-8° from the sun a scan, whose pointing the others do not tell "
        f"to a degree; beyond 10° it is {middle['held_out_beyond_10']:.2f}.",
        "",
        "| 100 skies of sasktran2, 1 % noise, 240 samples | within | of them | within 2 sigma | largest sigma |",
        "|---|---|---|---|---|",
    ]
    for name, entry in recovery["sasktran2 flat, normal"]["parameters"].items():
        if "limit" in entry and entry["limit"] is not None:
            lines.append(
                f"| {name.replace('_', ' ')} | {entry['limit']:g} | {100 * entry['share within limit']:.0f} % "
                f"| {100 * entry['share within 2 sigma']:.0f} % | {entry['sigma max']:.2g} |"
            )
    scan, starts = speed["scan"], speed["starts"]
    lines += [
        "",
        f"One measured scan, ten parameters: {scan['seconds']['ours']:.2g} s after compilation, "
        f"{scan['scipy_over_ours']:.1f} times as fast as scipy's",
        "`least_squares` over the same jitted residual and "
        f"{scan['scipy_over_sasktran2_over_ours']:.0f} times as fast as it would be over sasktran2. "
        f"{100 * starts['share']:.1f} % of {starts['starts']} random",
        f"starts reach the best cost. A thousand skies by `fit_many`: {many['skies per second']:.0f} a second.",
    ]
    return "\n".join(lines)


# entries of the simulated skies that are no kind of noise
_ABOUT = ("truth", "skies", "made_with")


def error_bars(record: dict) -> str:
    """Whether sigmas hold: between halves of measured skies, of held-out directions, on simulated skies."""
    halves = {name: part for name, part in record["halves"].items() if name != "made_with"}
    spheres, lobes = halves["particles"], halves["two lobes"]
    lines = [
        "| eight measured skies by halves, particles | off over sigma, rms | within 2 sigma | sigma, settled, median |",
        "|---|---|---|---|",
    ]
    for name, row in spheres["parameters"].items():
        lines.append(
            f"| {name.replace('_', ' ')} | {row['rms']:.2f} | {100 * row['within_2']:.0f} % "
            f"| {row['median_sigma_settled']:.2g} |"
        )
    lines += [
        "",
        "| held-out directions, settled scans | RMSE all, mW | to 10° | beyond 10° | beyond 20° | within 1 sigma "
        "| 2 sigma |",
        "|---|---|---|---|---|---|---|",
    ]
    for name, part in (("particles", spheres), ("two lobes", lobes)):
        rmse, (one, two) = part["held_out_rmse"], part["held_out_within"]["all"]
        shown = " | ".join(
            f"{rmse[f'settled, {where}']:.2f}" for where in ("all", "within_10", "beyond_10", "beyond_20")
        )
        lines.append(f"| {name} | {shown} | {100 * one:.0f} % | {100 * two:.0f} % |")
    simulated = {n: part["within_1_2"].values() for n, part in record["simulated"].items() if n not in _ABOUT}
    told = []
    for name, shares in simulated.items():
        one, two = ([100 * share[k] for share in shares] for k in (0, 1))
        told.append(f"{name}: {min(one):.0f}-{max(one):.0f} % and {min(two):.0f}-{max(two):.0f} %")
    lines += [
        "",
        f"Of {record['simulated']['skies']} simulated skies the truth lies within one and two sigma, by parameter,",
        f"with noise {'; '.join(told)}.",
    ]
    return "\n".join(lines)


def almucantars(record: dict) -> str:
    """A photometer's almucantars of an independent solver, inverted by the default question."""
    lines = [
        "| almucantars of sasktran2, default question | with the beam, rms | within 2 sigma | sky alone, rms "
        "| within 2 sigma |",
        "|---|---|---|---|---|",
    ]
    for name, row in record["summary"].items():
        relative = name.endswith("radius")
        key, factor, unit = ("rms_relative", 100.0, " %") if relative else ("rms", 1.0, "")
        cells = (
            f"{factor * row[kind][key]:.2g}{unit} | {100 * row[kind]['within_2']:.0f} %" for kind in ("beam", "sky")
        )
        lines.append(f"| {name.replace('_', ' ')} | {' | '.join(cells)} |")
    hazy = record["summary"]["single_scattering_albedo_440"]["beam"]["cases"]
    lines += [
        "",
        f"{len(record['cases'])} hazes by its own Mie code, half of them of bins that no two modes make; noise 1 %,",
        f"scales 0.5 % and pointing 0.1° off. Albedos of the {hazy} with an optical depth of 0.2 or more at 440 nm.",
    ]
    return "\n".join(lines)


def size_bins(record: dict) -> str:
    """Size distributions in bins from almucantars of an independent solver."""
    found = record["summary"]
    low, high = found["counted_um"]
    lines = [
        f"| sizes in bins, {found['cases']} almucantars with the beam | within 2 sigma | off, median | within 10 % |",
        "|---|---|---|---|",
    ]
    for name, row in found["quantities"].items():
        place = f", {low:g}-{high:g} um" if name == "volume_size_distribution" else ""
        lines.append(
            f"| {name.replace('_', ' ')}{place} ({row['numbers']}) | {100 * row['within_2_sigma']:.1f} % "
            f"| {100 * row['median_off_relative']:.2g} % | {100 * row['within_10_percent']:.0f} % |"
        )
    lines += [
        "",
        "Optical depth 0.2 or more at 440 nm; sasktran2's skies of its own Mie code on 320 radii, scalar, by turns of",
        "two modes and of straight lines a tenth off them; `--free bins`. Sigma is stated larger than what was added",
        "(noise 2 and 1 %, calibration 5 and 0.5 %, depth 0.01 and 0.005), so that 2 sigma hold more than 95 %.",
    ]
    return "\n".join(lines)


def _milliseconds(seconds: float) -> str:
    value = 1e3 * seconds
    return f"{value:.0f}" if value >= 100.0 else f"{value:.2g}"


def speed(record: dict) -> str:
    """The table of times, ours and the rivals', of one run."""
    rows, ratios = record["rows"], record["ratios"]
    names = [name for name, row in rows.items() if "max_relative_error" in row and "single" not in name]
    lines = [
        "| one flat sky, 343 x 41, all in one run | time | max error to 85° |",
        "|---|---|---|",
        *(
            f"| {name.removesuffix(' flat')} | {_milliseconds(rows[name]['seconds'])} ms "
            f"| {100 * rows[name]['max_relative_error']:.2g} % |"
            for name in names
            if not name.startswith("PythonicDISORT")
        ),
        "",
        f"Times of `experiments/benchmarks/benchmark.py`, float32, {record['made_with']['machine']}. Spherical: normal "
        f"{1e3 * rows['orders normal spherical']['seconds']:.2g} ms a sky,",
        f"{1e3 * ratios['batch of 60, spherical']['seconds_per_sky']:.2g} ms in a batch of 60; the Jacobian to 8 "
        f"parameters {1e3 * rows['jacobian spherical']['seconds']:.2g} ms, "
        f"{ratios['jacobian over forward, spherical']:.1f} times the sky (sasktran2:",
        f"{rows['sasktran2 jacobian flat']['seconds']:.2g} s, "
        f"{ratios['sasktran2 jacobian over its forward']:.0f} times). "
        f"First sky in a new process: {record['first_result']['no cache']['first_result_seconds']:.1f} s, "
        f"{record['first_result']['warm cache']['first_result_seconds']:.1f} s with a warm cache.",
    ]
    return "\n".join(lines)


def analytic(refit: dict, fits: dict) -> str:
    """The tables of the analytic skies: coefficients against simulated skies not in the fit and measured ones."""
    linear, extended = refit["all orders"]["held_out"], refit["extended"]["held_out"]
    wide = refit["linear form on the extended form's skies"]
    rows = [
        ("T 2-6, sun to 82.5°", "published", linear, "published"),
        ("", "refitted", linear, "refitted"),
        ("", "best five for each sky alone", linear, "best five"),
        ("T 1-10, sun to 85°", "linear form, refitted", {"overall": {"x": wide["overall"]}}, "x"),
        ("", "`ExtendedPreetham`", extended, "refitted"),
        ("", "best five for each sky alone", extended, "best five"),
    ]
    lines = [
        "| skies not in the fit, view to 80° | coefficients | luminance, median | 95 % within | xy distance |",
        "|---|---|---|---|---|",
    ]
    for where, name, part, key in rows:
        e = part["overall"][key]
        lines.append(
            f"| {where} | {name} | {100 * e['luminance']:.1f} % | {100 * e['luminance_95']:.1f} % "
            f"| {e['chromaticity']:.4f} |"
        )
    lines += [
        "",
        "| eight measured skies, turbidity fitted to each | spectral RMSE, mW m⁻² sr⁻¹ nm⁻¹ | luminance RMSE, cd m⁻² |",
        "|---|---|---|",
    ]
    for name in ("published", "refitted", "extended"):
        row = refit["measured"][name]
        lines.append(f"| {name} | {row['spectral_rmse']:.1f} | {row['luminance_rmse']:.0f} |")
    paper = refit["paper: two orders, no ground, flat below 70"]
    ratios = {d: fits["rows"][f"{d}, two threads"]["times faster than scipy"] for d in ("float32", "float64")}
    lines += [
        "",
        f"The paper's simulation, 60 skies, takes {paper['simulation_seconds']:.2g} s here (it took 600 CPU hours), "
        f"the fit {paper['fit_seconds']:.2g} s;",
        f"the extended form {refit['extended']['simulation_seconds']:.2g} and {refit['extended']['fit_seconds']:.2g} s "
        f"(float64, {refit['made_with']['machine']}). `fit_perez` fits the",
        f"five parameters to skies {ratios['float32']:.0f} (float32) and {ratios['float64']:.0f} (float64) times as "
        "fast as scipy's Levenberg-Marquardt with the analytic Jacobian.",
    ]
    return "\n".join(lines)


def pictures(aerial: dict, dome: dict) -> str:
    """Aerial perspective beside the paper's closed form, and the fast dome beside its rival."""
    errors, level = aerial["errors"]["all"], aerial["errors"]["level, cos < 1e-4"]
    lines = [
        "| in-scatter, T 1-10, eye 0-8 km, to 150 km | max error | beyond 0.5 % | level views, beyond 0.5 % |",
        "|---|---|---|---|",
    ]
    for name in ("normal, float32", "normal, float64", "the paper, float32", "the paper, float64"):
        most = errors[name]["max_percent"]
        shown = most if isinstance(most, str) else "enormous" if most > 1e6 else f"{most:.2g} %"
        shares = (f"{100 * part[name]['share_over_half_percent']:.2g} % of rays" for part in (errors, level))
        label = name if name.startswith("the paper") else f"`AerialPerspective` {name}"
        lines.append(f"| {label} | {shown} | {' | '.join(shares)} |")
    rows = dome["rows"]
    ours, scalar, vector = (rows[n]["seconds"] for n in ("skyfit", "mitsuba, scalar render", "mitsuba, vectorised"))
    lines += [
        "",
        f"A dome of 1024 x 1024 pixels takes {1e3 * ours:.2g} ms by `rgb` (float32, {dome['machine']}), "
        f"{scalar / ours:.0f} times less than Mitsuba's `sunsky`",
        f"rendered by its scalar variant and {vector / ours:.1f} times less than evaluated by its vectorised one.",
    ]
    return "\n".join(lines)


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


def validated(
    record, iprt, space, recovery, almucantar, measured, bars, twilight, sunlight, continuity, aerial, lighting, shader
) -> str:
    """What was compared, with whose, what came out, and which files say so: in three parts, by who made the other."""

    def row(what, whose, figure, script, result):
        return f"| {what} | {whose} | {figure} | `{script}.py`, `{result}.json` |"

    def errors(median, most):
        return f"{100 * median:.2g} % in the median, {100 * most:.2g} % at most"

    def oracle(solver, preset, geometry):
        rows = [r for r in record["oracles"] if (r["solver"], r["preset"], r["geometry"]) == (solver, preset, geometry)]
        most = min(rows, key=lambda r: r["max_sun_zenith"])
        return errors(most["median_relative_error"], most["max_relative_error"])

    tables_of = {(r["preset"], r["polarised"]): r for r in record["vector"]["rows"]}
    natraj = tables_of["fine", True]
    cases = {name: case for name, case in iprt["fine"].items() if "splines" not in name}
    z = max(case[stokes]["z rms"] for case in cases.values() for stokes in "IQU")
    ranges = space["solvers"]["spherical"]["ranges"]
    dusk, night = ranges["sun 89-96"], ranges["sun 96-108"]
    depth = recovery["sasktran2 flat, normal"]["parameters"]["aerosol_optical_depth"]
    both = almucantar["summary"]["aerosol_optical_depth_440"]
    halves = bars["halves"]["particles"]["parameters"]["aerosol_optical_depth"]
    off = {
        name: max(abs(a - b) for a, b in zip(band["model"], band["measured"], strict=True))
        for name, band in twilight["bands"].items()
    }
    direct = sunlight["spectrl2_direct_normal"]
    spectral = max(r["median_abs_percent"] for r in direct if r["sun_zenith_deg"] <= 60.0)
    jumps = max(part["all"]["largest"] for part in continuity["through sunset"].values())
    best = min(measured["peers"], key=lambda name: measured["peers"][name]["all"])
    head = ["| what | whose | what came out | script, result file |", "|---|---|---|---|"]
    accuracy, folder = ("validation/accuracy", "accuracy"), "validation"
    return "\n".join([
        "## Published truth",
        "",
        *head,
        row(
            "polarised light of air, optical depth to 1", "tables of Natraj et al. 2009",
            f"`fine`: I {errors(natraj['median_relative_error'], natraj['max_relative_error'])}; Q and U over I "
            f"{100 * natraj['max_error_q_u_over_i']:.2g} % at most", *accuracy,
        ),
        row(
            "polarised light at every height, cases A1-A3, B1, B2", "IPRT, Emde et al. 2015, by MYSTIC",
            f"`fine`: deviations are {z:.2f} of MYSTIC's own standard errors at most (rms)", f"{folder}/iprt", "iprt",
        ),
        row(
            "in-scattered light before objects", "quadrature of scipy",
            f"{aerial['errors']['all']['normal, float32']['max_percent']:.2g} % at most",
            f"{folder}/aerial_perspective", "aerial_perspective",
        ),
        row("single scattering to a sun at 95°", "quadrature", oracle("single", "normal", "spherical"), *accuracy),
        row(
            "the sun's direct spectrum", "SPECTRL2 of pvlib",
            f"{spectral:.2g} % in the median outside bands, sun to 60°", f"{folder}/sunlight", "sunlight",
        ),
        "",
        "## Another code",
        "",
        *head,
        row("all orders, flat", "nanodisort, 32 streams", oracle("orders", "normal", "flat"), *accuracy),
        row("all orders, spherical", "backward Monte Carlo", oracle("orders", "normal", "spherical"), *accuracy),
        row(
            "ground to space, sun at 89-96°", "backward Monte Carlo", errors(dusk["median"], dusk["worst"]),
            f"{folder}/space", "space",
        ),
        row(
            "ground to space, sun at 96-108°", "backward Monte Carlo", errors(night["median"], night["worst"]),
            f"{folder}/space", "space",
        ),
        row(
            "retrieval of 100 skies, 1 % noise", "sasktran2",
            f"{100 * depth['share within 2 sigma']:.0f} % of optical depths within two sigma", f"{folder}/recovery",
            "recovery",
        ),
        row(
            f"retrieval of {len(almucantar['cases'])} almucantars", "sasktran2 and its Mie code",
            f"optical depth at 440 nm {both['sky']['rms']:.2g} off (rms) from the sky alone, {both['beam']['rms']:.2g} "
            "with the beam", f"{folder}/almucantars", "almucantars",
        ),
        row(
            "no step through sunset", "itself, every 0.01° of the sun",
            f"what bends from one to the next is {100 * jumps:.2g} % at most", f"{folder}/continuity", "continuity",
        ),
        row(
            "planes lit by a rendered map and its lamp", "mitsuba",
            f"{100 * lighting['worst']:.2g} % at most from the solver's irradiance", f"{folder}/lighting", "lighting",
        ),
        row(
            "the exported shader in a browser", "chromium, WebGL 2",
            f"{shader['largest_step_of_8_bits']} step of 8 bits at most from `sky.rgb`", "studies/shader_page",
            "shader_page",
        ),
        "",
        "## Measured",
        "",
        *head,
        row(
            "eight skies of one morning", "Kider et al. 2014",
            f"{measured['alone']['all']:.1f} mW m⁻² sr⁻¹ nm⁻¹ RMSE fitted; {measured['peers'][best]['all']:.1f} the "
            f"best unfitted model of others, {best}", "studies/measured_sky", "measured_sky",
        ),
        row(
            "the same by halves of their directions", "Kider et al. 2014",
            f"optical depths differ by {halves['rms']:.2f} of their sigma (rms)", f"{folder}/error_bars", "error_bars",
        ),
        row(
            "the zenith after sunset, sun to 103°, nothing fitted", "Patat et al. 2006, Paranal",
            ", ".join(f"{name} {value:.1f}" for name, value in off.items()) + " mag at most", f"{folder}/twilight",
            "twilight",
        ),
    ])  # fmt: skip


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


def between(text: str, marks: tuple[str, str], content: str) -> str:
    """The text with other content between two marks."""
    before, rest = text.split(marks[0])
    _, after = rest.split(marks[1])
    return f"{before}{marks[0]}\n{content}\n{marks[1]}{after}"


def updated() -> dict[pathlib.Path, str]:
    """The pages with their figures made anew."""

    def read(path):
        return json.loads(path.read_text())

    record, measured, recovery, refit = (read(path) for path in (RESULT, MEASURED, RECOVERY, REFIT))
    tables_of = "\n\n".join(
        (
            tables(record),
            polarised(record, read(POLARISATION)),
            from_every_height(read(IPRT)),
            ground_to_space(read(SPACE)),
            by_tolerance(read(CHOOSE)),
            hard(read(HARD)),
            inverted(measured, recovery, read(INVERSION), read(MANY)),
            error_bars(read(BARS)),
            almucantars(read(ALMUCANTARS)),
            size_bins(read(SIZE_BINS)),
            speed(read(BENCHMARK)),
            analytic(refit, read(FITS)),
            pictures(read(AERIAL), read(DOME)),
        )
    )
    readme = between(README.read_text(), SUMMARY, summary(record, measured, recovery, refit, read(SPACE)))
    readme = between(readme, PRINTED, f"```\n{record['sample']['printed']}\n```")
    compared = (record, read(IPRT), read(SPACE), recovery, read(ALMUCANTARS), measured, read(BARS))
    compared += (read(TWILIGHT), read(SUNLIGHT), read(CONTINUITY), read(AERIAL), read(LIGHTING), read(SHADER))
    return {
        README: readme,
        ACCURACY: between(ACCURACY.read_text(), TABLES, tables_of),
        VALIDATION: between(VALIDATION.read_text(), VALIDATED, validated(*compared)),
    }


if __name__ == "__main__":
    for path, text in updated().items():
        path.write_text(text)
