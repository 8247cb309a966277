"""Tables of inversions: measured skies, skies of other solvers, error bars, photometers."""

# entries of the simulated skies that are no kind of noise
_ABOUT = ("truth", "skies", "made_with")


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
        f"starts reach the best chi-square. {many['skies']} skies of 30 directions and 8 wavelengths by `fit_many` and "
        f"the scalar solver: {many['skies per second']:.1f} a second, polarised "
        f"{many['polarised']['skies per second']:.1f}.",
    ]
    return "\n".join(lines)


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
