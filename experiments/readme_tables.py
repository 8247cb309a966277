"""Puts the figures of experiments/results/accuracy.json and benchmark.json into README.md, between its markers."""

import json
import pathlib


HERE = pathlib.Path(__file__).resolve().parent
README = HERE.parent / "README.md"
RESULT = HERE / "results" / "accuracy.json"
BENCHMARK = HERE / "results" / "benchmark.json"
START, END = "<!-- figures of experiments/results/accuracy.json -->", "<!-- end of figures -->"


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
        "| the sample sky (sasktran2, 1 % noise) | truth | recovered |",
        "|---|---|---|",
    ]
    for name, entry in record["sample"]["parameters"].items():
        lines.append(f"| {name.replace('_', ' ')} | {entry['truth']:g} | {entry['value']:.5g} ± {entry['sigma']:.2g} |")
    peers = sorted(record["measured"]["peers"].items(), key=lambda item: item[1])
    scans = record["measured"]["scans"]
    overall = record["refit"]["overall"]
    lines += [
        "",
        "| eight measured skies (Kider et al. 2014) | RMSE, mW m⁻² sr⁻¹ nm⁻¹ |",
        "|---|---|",
        f"| skyfit, each scan fitted with nine parameters | {record['measured']['all']:.1f} "
        f"({min(scans):.1f} to {max(scans):.1f}) |",
        *(f"| {name}, not fitted | {value:.1f} |" for name, value in peers[:3]),
        f"| Preetham 1999, not fitted | {dict(peers)['preetham']:.1f} |",
        "",
        "| coefficients against 60 simulated skies, to view zenith 80° | median luminance error | median xy distance |",
        "|---|---|---|",
        *(f"| {name} | {100 * e[0]:.1f} % | {e[1]:.4f} |" for name, e in overall.items()),
    ]
    return "\n".join(lines)


def _milliseconds(row: dict) -> str:
    value = 1e3 * row["seconds"]
    return f"{value:.0f}" if value >= 100.0 else f"{value:.2g}"


def speed(record: dict) -> str:
    """The table of times, ours and the rivals', of one run."""
    rows, ratios = record["rows"], record["ratios"]
    names = [name for name, row in rows.items() if "max_relative_error" in row and "single" not in name]
    lines = [
        "| one flat sky, 343 x 41, all in one run | time | max error to 85° |",
        "|---|---|---|",
        *(
            f"| {name.removesuffix(' flat')} | {_milliseconds(rows[name])} ms "
            f"| {100 * rows[name]['max_relative_error']:.2g} % |"
            for name in names
            if not name.startswith("PythonicDISORT")
        ),
        "",
        f"Times of `experiments/benchmark.py`, float32, {record['made_with']['machine']}. Spherical: normal "
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


def updated(text: str, record: dict) -> str:
    """The README's text with the tables made anew."""
    before, rest = text.split(START)
    _, after = rest.split(END)
    times = speed(json.loads(BENCHMARK.read_text()))
    return f"{before}{START}\n{tables(record)}\n\n{times}\n{END}{after}"


if __name__ == "__main__":
    README.write_text(updated(README.read_text(), json.loads(RESULT.read_text())))
