"""Tables of times, and of the analytic skies and pictures whose point is speed."""

from .marks import milliseconds


def speed(record: dict) -> str:
    """The table of times, ours and the rivals', of one run."""
    rows, ratios = record["rows"], record["ratios"]
    names = [name for name, row in rows.items() if "max_relative_error" in row and "single" not in name]
    lines = [
        "| one flat sky, 343 x 41, all in one run | time | max error to 85° |",
        "|---|---|---|",
        *(
            f"| {name.removesuffix(' flat')} | {milliseconds(rows[name]['seconds'])} ms "
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


def growth(record: dict) -> str:
    """How time and memory grow with the size of a question."""
    lines = [
        "| what grows | from, to | time | memory at most | time grows as size to the power |",
        "|---|---|---|---|---|",
    ]
    for name, axis in record["axes"].items():
        rows = [row for row in axis["rows"] if "seconds" in row]
        first, last = rows[0], rows[-1]
        power = "-" if axis["exponent"] is None else f"{axis['exponent']:.2g}"
        lines.append(
            f"| {name} | {first['size']:,}, {last['size']:,} "
            f"| {milliseconds(first['seconds'])} ms, {milliseconds(last['seconds'])} ms "
            f"| {max(row['memory_GiB'] for row in rows):.2g} GiB | {power} |"
        )
    lines += [
        "",
        "`OrdersOfScattering.normal`, spherical, float32, of directions (4 wavelengths), wavelengths (100 directions)",
        "and radius bins in a Jacobian; `fit_many` and a joint fit by single scattering of 20 directions and 4",
        "wavelengths. The power is that between the two largest sizes; memory is all of the process. A joint fit takes",
        f"all times at once; devices are those that XLA is made to see on {record['cores']} cores.",
    ]
    return "\n".join(lines)
