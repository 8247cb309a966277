"""The page of validation: what was compared, with whose, what came out, which files say so."""


def validated(
    record,
    iprt,
    space,
    recovery,
    almucantar,
    measured,
    bars,
    twilight,
    sunlight,
    continuity,
    aerial,
    lighting,
    shader,
    closure,
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
    networks, mie = (closure["summary"]["spheres"][which] for which in ("off", "from_miepython"))
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
            f"optics of {networks['retrievals']} network retrievals of spheres, by their sizes and indices",
            "AERONET's kernels; miepython", "single scattering albedo and asymmetry "
            f"{networks['ssa']['median']:.2g} and {networks['asymmetry']['median']:.2g} off in the median, "
            f"{networks['ssa']['largest']:.1g} and {networks['asymmetry']['largest']:.1g} at most; "
            f"{mie['ssa']['largest']:.1g} and {mie['asymmetry']['largest']:.1g} at most from exact Mie theory",
            f"{folder}/closure", "closure",
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
