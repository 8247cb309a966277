"""A corpus of broken skies: each ends in an error of one line, in a flag, or in the right answer.

A flag is what a user sees of a fit: a result other than "successful", a parameter at its bound or not determined, a
note, samples masked. Damage that only a reader meets is in test_broken_files.py, options of the program in test_cli.py.
"""

import numpy as np
import pytest
from broken_skies import FILES, FREE, SKIES, SOLVER, TRUTH

import skyfit
from skyfit.retrieve import Fit, invert


CASES = SKIES | FILES


def flags(fit: Fit) -> list[str]:
    """What a user is told of a fit, the numbers apart."""
    told = [*fit.notes, *(name for name in fit.result if name != "successful")]
    told += [sentence for at_time in fit.undetermined for sentence in at_time]
    told += [f"{count} samples {reason}" for reason, count in fit.sky.masked.items()]
    return told + ["at bound"] * bool(fit.at_bound.any()) + ["not determined"] * (not fit.determined.all())


def off(fit: Fit) -> float:
    """The largest distance from the truth, in sigma."""
    known = [place for place, name in enumerate(fit.free) if name in TRUTH]
    distance = np.abs(fit.values[:, known] - [TRUTH[fit.free[place]] for place in known])
    return float(np.max(distance / fit.sigma[:, known]))


@pytest.mark.parametrize("name", CASES)
def test_a_broken_sky_is_refused_or_flagged(name, tmp_path):
    case = CASES[name]
    try:
        made = case.make(tmp_path)
        sky = made if isinstance(made, skyfit.Sky) else skyfit.read(made[0], **made[1])
        fit = invert(sky, case.free, SOLVER)
    except ValueError as refusal:
        line = str(refusal)
        assert case.ends == "error", line
        assert "\n" not in line and len(line) < 500
        assert all(part in line for part in case.parts), line
        return
    told = flags(fit)
    assert case.ends != "error", (fit.values, told)
    assert all(any(part in sentence for sentence in told) for part in case.parts), told
    # never a confident wrong answer
    assert told or off(fit) < 5.0, (fit.values, fit.sigma)
    if case.ends == "right":
        assert set(fit.result) == {"successful"} and off(fit) < 5.0
        # nothing else is told
        assert all(any(part in sentence for part in case.parts) for sentence in told), told
    else:
        assert told


# the options of the program for what `read` takes
OPTIONS = {
    "latitude": "--latitude", "longitude": "--longitude", "utc_offset": "--utc-offset", "altitude": "--altitude",
    "fwhm_nm": "--fwhm",
}  # fmt: skip
# all that must be refused, and of the others some, whose pictures take longest
DRAWN = (
    "netcdf", "netcdf with holes", "netcdf a time twice", "netcdf axes under each other's name",
)  # fmt: skip
CALLED = {name: case for name, case in FILES.items() if case.ends == "error" or name in DRAWN}


@pytest.fixture(scope="module")
def commands(skyfit_command, tmp_path_factory):
    """`skyfit invert` on every file, each in a folder of its own: its code, what it printed, and what it wrote."""
    report = {}
    for name, case in CALLED.items():
        folder = tmp_path_factory.mktemp("command")
        path, options = case.make(folder)
        before = sorted(folder.rglob("*"))
        words = [word for key, value in options.items() for word in (OPTIONS[key], str(value))]
        settings = ["--free", ",".join(FREE), "--solver", "single", "--preset", "draft", "--geometry", "flat"]
        done = skyfit_command("invert", path, "--out", folder / "out", *settings, *words, cwd=folder, check=False)
        written = [str(one.relative_to(folder)) for one in sorted(folder.rglob("*")) if one not in before]
        report[name] = [done.returncode, done.stdout, done.stderr, written]
    return report


@pytest.mark.parametrize("name", CALLED)
def test_a_broken_file_on_the_command_line(commands, name):
    code, printed, complaint, written = commands[name]
    case = CALLED[name]
    assert "Traceback" not in complaint, complaint
    if case.ends == "error":
        (line,) = [line for line in complaint.splitlines() if line.strip()]
        assert code == 2 and line.startswith("skyfit: ") and printed == "" and written == []
        assert all(part in line for part in case.parts), line
        return
    assert code == 0, complaint
    assert written == ["out", "out/fit.json", "out/fit.nc", "out/fit.png"]
    assert all(part in " ".join(printed.split()) for part in case.parts), printed


def test_the_corpus_is_as_large_as_was_asked():
    assert sum(case.ends != "right" for case in CASES.values()) >= 100
