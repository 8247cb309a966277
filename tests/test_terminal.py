"""What commands print, and for whom: people in a narrow window, scripts, those who want to hear only of trouble."""

import json
from pathlib import Path

import numpy as np
import pytest
from skies import make_sky

from skyfit.analytic.perez_of_sky import SkyPerez
from skyfit.cli import printing, waiting
from skyfit.cli.options import end
from skyfit.cli.perez_report import print_perez
from skyfit.cli.sensitivity_report import print_sensitivity
from skyfit.retrieve import PARAMETERS


def words_of(printed: str) -> set[str]:
    """What was printed in a window of 80 columns, which has no wider line and no word cut short."""
    assert all(len(line.rstrip()) <= 80 for line in printed.splitlines()), printed
    assert "\N{HORIZONTAL ELLIPSIS}" not in printed, printed
    return {*printed.split()}


def test_no_table_of_sensitivities_or_of_perez_breaks_a_word(capsys):
    longest = sorted(PARAMETERS, key=len)[-8:]
    entry = {"value": -0.01234, "unit": "degree", "sigma": 0.000123, "prior_sigma": None, "determined": False}
    following = [{"view_zenith": 35.0, "view_azimuth": 164.0, "sigma": dict.fromkeys(longest, 0.000123)}] * 100
    print_sensitivity({
        "scan": "a_scan_of_a_long_name_at_the_station_in_the_morning.nc", "sun_zenith": 50.0, "directions": 94,
        "wavelength_nm": [500.0], "relative_noise": 0.02, "parameters": dict.fromkeys(longest, entry),
        "next": following,
    })  # fmt: skip
    sky = make_sky()
    numbers = np.full((2, 3, 5), -0.0123)
    covariance = np.broadcast_to(1.5e-6 * np.eye(5), (2, 3, 5, 5))
    counts = np.full((2, 3), 40), np.full((2, 3), True)
    light = "440 nm", "550 nm", "680 nm"
    print_perez(SkyPerez(sky, light, numbers, covariance, *[numbers[..., 0]] * 3, *counts))
    words = words_of(capsys.readouterr().out)
    assert {*longest, "determined", "2024-06-01", "10:00", "+-0.0012"} <= words


def test_a_sentence_ends_its_lines_between_words(capsys):
    path = "a_folder_of_results/" + 7 * "a_long_name_of_a_file_" + ".nc"
    printing.written([Path("one.nc"), Path(path)])
    printing.say("  indented " + 20 * "word ")
    printed = capsys.readouterr().out
    assert any(line.strip() == path for line in printed.splitlines()) and "\n    word" in printed


COMMANDS = """
import contextlib, io, json, sys
from skyfit.cli import main
said = []
for words in json.load(open("calls.json")):
    sys.argv[1:] = words
    out, error, code = io.StringIO(), io.StringIO(), 0
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(error):
        try:
            main()
        except SystemExit as end:
            code = end.code or 0
    said.append([code, out.getvalue(), error.getvalue()])
print(json.dumps(said))
"""


def test_every_command_speaks_to_scripts_and_can_be_quiet(python, tmp_path):
    """`--json`: one document alone on standard output; `--quiet`: nothing where all is well. One does not stay."""
    single = ("--solver", "single", "--geometry", "flat", "--preset", "draft")
    simulate = ("simulate", "--sun-zenith", "60", "--turbidity", "3", *single, "--wavelengths", "450,550,650")
    fit = ("invert", "sky.csv", "--free", "turbidity", "--prior", "turbidity=3,1", *single, "--out", "fit")
    told = ("sensitivity", "sky.csv", "--free", "turbidity", *single, "--next", "2", "--out", "told.json")
    calls = {
        "simulate": (*simulate, "--out", "sky.csv"),
        "convert": ("convert", "sky.csv", "--to", "sky.nc"),
        "invert": fit,
        "predict": ("predict", "fit/fit.json", "--at", "sky.csv", "--out", "there.nc"),
        "perez": ("perez", "sky.csv", "--out", "perez.csv"),
        "sensitivity": told,
        "export": ("export", "extended", "--to", "c", "--out", "sky.h"),
        "render": ("render", "--sun-zenith", "60", "--solver", "extended", "--size", "32x16", "--out", "a.hdr"),
    }
    spoken = [(*call, "--json") for call in calls.values()] + [(*call, "--quiet") for call in calls.values()]
    both = [("--quiet", "--json"), ()]
    spoken += [(*calls["convert"], *more) for more in both]
    refused = (*told, "--turbidity", "2", "--atmosphere", "site.toml")
    (tmp_path / "calls.json").write_text(json.dumps([*spoken, (*refused, "--quiet", "--json")]))
    done = python(COMMANDS, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    said = json.loads(done.stdout)
    documents = {}
    for name, (code, out, error) in zip(calls, said, strict=False):
        assert code == 0 and error, (name, error)
        documents[name] = json.loads(out)
    for name, (code, out, error) in zip(calls, said[len(calls) :], strict=False):
        notes = [line for line in error.splitlines() if not line.startswith(("note: ", "  "))]
        assert (code, out, notes) == (0, "", []), name
    # the same content as the record
    assert documents["invert"] == json.loads((tmp_path / "fit/fit.json").read_text())
    assert documents["sensitivity"] == json.loads((tmp_path / "told.json").read_text())
    assert documents["simulate"]["made_by"]["solver"]["name"] == "SingleScattering"
    assert documents["convert"]["usable"] == documents["predict"]["directions"] * 3
    rows = documents["perez"]["fits"]
    assert rows[0]["time"] == "time 0" and all(isinstance(row["rmse"], float) for row in rows)
    assert documents["export"]["file"] == "sky.h" and documents["render"]["pictures"][0]["file"] == "a.hdr"
    quiet, plain, refusal = said[-3:]
    assert json.loads(quiet[1])["file"] == "sky.nc" and quiet[2] == "" and "written: sky.nc" in plain[1]
    assert refusal[:2] == [2, ""] and "`--turbidity` must be left out with `--atmosphere`" in refusal[2]


def test_a_search_that_did_not_end_is_exit_code_3():
    end([("Y", "successful"), ("x", "poor_fit")])
    with pytest.raises(Exception) as found:
        end([("Y", "successful"), ("x", "max_steps_reached")])
    assert found.value.exit_code == 3


def test_how_long_a_call_takes_is_what_the_like_took(tmp_path, monkeypatch):
    now = [0.0]
    monkeypatch.setenv("JAX_COMPILATION_CACHE_DIR", str(tmp_path))
    monkeypatch.setattr(waiting.time, "monotonic", lambda: now[0])

    def call(size, seconds, program=None):
        with waiting.waiting("invert, all orders", size) as said:
            now[0] += seconds
            if program is not None:
                (tmp_path / program).write_text("")
        return said

    # nothing is known of the first, so no figure is told
    assert call("small", 21.0, "one") == ", compiling, which is kept for the next time"
    assert call("small", 3.2) == ", less than the 21 s of the first time"
    assert call("small", 3.0) == ", about 3 s as before"
    assert call("large", 30.0, "two") == ", compiling: about 21 s the last time it did"
    assert call("large", 1.0) == ", less than the 30 s of the first time"
    # what is no wait needs no estimate
    assert call("large", 1.0) == ""
    for foreign in (
        "{",
        "[]",
        '{"invert, all orders": null}',
        '{"invert, all orders": {"compiled": "x", "sizes": {}}}',
    ):
        (tmp_path / "durations.json").write_text(foreign)
        assert call("small", 3.0) == ", compiling, which is kept for the next time"
    with waiting.waiting("", "") as said:
        assert said == ""
