"""Puts the figures of experiments/results/*.json into README.md and pages of docs/, between their markers."""

import json
import pathlib

from .marks import between, PRINTED, SUMMARY, TABLES, VALIDATED
from .retrievals import almucantars, error_bars, inverted, size_bins
from .solvers import by_tolerance, from_every_height, ground_to_space, hard, polarised, tables
from .speed import analytic, growth, pictures, speed
from .summary import summary
from .validation import validated


HERE = pathlib.Path(__file__).resolve().parents[1]
README = HERE.parent / "README.md"
ACCURACY = HERE.parent / "docs" / "accuracy.md"
VALIDATION = HERE.parent / "docs" / "validation.md"


def updated() -> dict[pathlib.Path, str]:
    """The pages with their figures made anew."""

    def read(name):
        return json.loads((HERE / "results" / f"{name}.json").read_text())

    record, measured, recovery, refit = (read(name) for name in ("accuracy", "measured_sky", "recovery", "refit"))
    space, iprt, aerial, photometer = (read(name) for name in ("space", "iprt", "aerial_perspective", "almucantars"))
    bars = read("error_bars")
    tables_of = "\n\n".join(
        (
            tables(record),
            polarised(record, read("polarisation")),
            from_every_height(iprt),
            ground_to_space(space),
            by_tolerance(read("choose")),
            hard(read("hard_cases")),
            inverted(measured, recovery, read("inversion_speed"), read("fit_many")),
            error_bars(bars),
            almucantars(photometer),
            size_bins(read("size_bins")),
            speed(read("benchmark")),
            growth(read("scaling")),
            analytic(refit, read("perez_fits")),
            pictures(aerial, read("dome_speed")),
        )
    )
    readme = between(README.read_text(), SUMMARY, summary(record, measured, recovery, refit, space))
    readme = between(readme, PRINTED, f"```\n{record['sample']['printed']}\n```")
    compared = (record, iprt, space, recovery, photometer, measured, bars, read("twilight"), read("sunlight"))
    compared += tuple(read(name) for name in ("continuity", "aerial_perspective", "lighting", "shader_page", "closure"))
    return {
        README: readme,
        ACCURACY: between(ACCURACY.read_text(), TABLES, tables_of),
        VALIDATION: between(VALIDATION.read_text(), VALIDATED, validated(*compared)),
    }
