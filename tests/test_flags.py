"""The CF conventions of what a file says of its own samples: flags, valid ranges, fill values, packing."""

import numpy as np
import pytest
import xarray

from skyfit.measured import read
from skyfit.measured.readers.flags import harmless
from skyfit.measured.writing import write_sky


AXES = ("time", "direction", "wavelength")
UNITS = {"units": "W m-2 sr-1 nm-1"}


def written(folder, radiance=None, about=(), encoding=(), flags=(), **variables):
    """A file of 2 directions x 3 wavelengths; `flags`: name -> (dimensions, values, attributes)."""
    light = np.array([[[0.10, 0.20, 0.30], [0.11, 0.21, 0.31]]]) if radiance is None else np.asarray(radiance)
    data = xarray.Dataset(
        {
            "radiance": (AXES, light, UNITS | dict(about)),
            "sun_zenith": ("time", [40.0]),
            "sun_azimuth": ("time", [120.0]),
            **variables,
        },
        {
            "view_zenith": ("direction", [10.0, 60.0]),
            "view_azimuth": ("direction", [0.0, 90.0]),
            "wavelength": ("wavelength", [400.0, 500.0, 600.0]),
        },
    )
    data = data.assign({name: (dims, np.asarray(values, np.int8), told) for name, (dims, values, told) in flags})
    data.to_netcdf(folder / "sky.nc", engine="h5netcdf", encoding={"radiance": dict(encoding)} if encoding else None)
    return read(folder / "sky.nc")


BITS = {"flag_masks": np.array([1, 2, 4], np.int8), "flag_meanings": "cloud saturated good_calibration"}
VALUES = {"flag_values": np.array([0, 1, 2, 3], np.int8), "flag_meanings": "good cloud not_evaluated rain"}
ARGO = {"flag_values": np.array([1, 2, 4], np.int8), "flag_meanings": "good_data probably_good_data bad_data"}
EACH = ([[[0, 1, 2], [3, 1, 0]]],)


@pytest.mark.parametrize(
    ("name", "dims", "values", "about", "masked"),
    [
        ("quality_flag", AXES, *EACH, {}, {"flagged 1": 2, "flagged 2": 1, "flagged 3": 1}),
        ("qc", AXES, *EACH, VALUES, {"flagged cloud": 2, "flagged rain": 1}),
        # any name, where the attributes tell
        ("judgement", AXES, *EACH, VALUES, {"flagged cloud": 2, "flagged rain": 1}),
        ("qc", AXES, *EACH, BITS, {"flagged cloud": 3, "flagged saturated": 1}),
        (
            "qc", AXES, *EACH,
            {"flag_masks": [3, 3], "flag_values": [1, 3], "flag_meanings": "cloud rain"},
            {"flagged cloud": 2, "flagged rain": 1},
        ),
        (
            "qc", AXES, *EACH,
            {"flag_values": [1, 2], "flag_meanings": "ok bad"},
            {"flagged bad": 1, "flagged 0": 2, "flagged 3": 1},
        ),
        ("qc", AXES, *EACH, {"flag_values": [0, 1, 2]}, {"flagged 1": 2, "flagged 2": 1, "flagged 3": 1}),
        (
            "qc", AXES, *EACH,
            {"flag_values": "0b, 1b", "flag_meanings": "ok bad"},
            {"flagged bad": 2, "flagged 2": 1, "flagged 3": 1},
        ),
        ("qc", ("direction",), [1, 4], ARGO, {"flagged bad_data": 3}),
        ("qc", ("wavelength",), [1, 2, 4], ARGO, {"flagged bad_data": 2}),
        ("qc", ("time",), [4], ARGO, {"flagged bad_data": 6}),
    ],
)  # fmt: skip
def test_flagged_samples_are_masked_and_counted_by_what_the_flag_means(tmp_path, name, dims, values, about, masked):
    sky = written(tmp_path, flags={name: (dims, values, about)}.items())
    assert sky.masked == {f"{reason} by {name}": count for reason, count in masked.items()}
    assert np.count_nonzero(~sky.usable) == sum(masked.values())
    said = [note for note in sky.notes if "0 is taken as good" in note]
    assert bool(said) == (not about) and not any("not used" in note for note in sky.notes)


def test_a_flag_is_known_by_the_radiance_that_names_it_and_may_have_holes(tmp_path):
    flag = "f", (AXES, [[[0, 1, 2], [9, 0, 0]]], {"flag_values": [0, 1, 2], "flag_meanings": "good bad good"})
    sky = written(tmp_path, about={"ancillary_variables": "f"}, flags=[flag])
    assert sky.masked == {"flagged bad by f": 1, "flagged 9 by f": 1}
    holed = flag[1][0], flag[1][1], {**flag[1][2], "_FillValue": np.int8(9)}
    assert written(tmp_path, flags=[("qc", holed)]).masked == {"without a flag in qc": 1, "flagged bad by qc": 1}


@pytest.mark.parametrize(
    ("meaning", "expected"),
    [
        ("good", True), ("good_data", True), ("probably_good", True), ("clear_sky", True), ("no_qc_performed", True),
        ("not_evaluated", True), ("unchecked", True), ("unknown", True), ("OK", True),
        ("bad", False), ("not_good", False), ("probably_bad_data", False), ("invalid", False), ("cloud", False),
        ("not_usable", False), ("missing", False), ("saturated", False),
    ],
)  # fmt: skip
def test_what_a_meaning_says_of_a_sample(meaning, expected):
    assert harmless(meaning) == expected


PACKED = {"scale_factor": 1e-4, "add_offset": 0.1, "dtype": "int16", "_FillValue": np.int16(-999)}


@pytest.mark.parametrize(
    ("about", "encoding", "masked"),
    [
        ({"valid_range": [0.0, 0.25]}, {}, {"outside its valid range": 2}),
        ({"valid_min": 0.15}, {}, {"outside its valid range": 2}),
        ({"valid_max": 0.205}, {}, {"outside its valid range": 3}),
        ({"valid_min": 0.15, "valid_max": 0.25}, {}, {"outside its valid range": 4}),
        ({"valid_range": [0.1, 0.31]}, {}, {}),
        # as packed, 0.1 to 0.25
        ({"valid_range": np.array([0, 1500], np.int16)}, PACKED, {"outside its valid range": 2}),
        ({"valid_max": np.int16(1500)}, PACKED, {"outside its valid range": 2}),
        # in the type of the unpacked numbers
        ({"valid_range": np.array([0.1, 0.25])}, PACKED, {"outside its valid range": 2}),
        ({}, PACKED, {}),
        ({"missing_value": 0.3}, {}, {"missing": 1}),
        ({}, {"_FillValue": 0.3}, {"missing": 1}),
    ],
)
def test_samples_outside_their_range_are_masked(tmp_path, about, encoding, masked):
    sky = written(tmp_path, about=about, encoding=encoding)
    assert sky.masked == masked
    if not masked:
        np.testing.assert_allclose(sky.radiance.max(), 0.31, atol=1e-4)


def test_other_numbers_outside_their_range_are_as_missing(tmp_path):
    sigma = AXES, np.full((1, 2, 3), 0.01), UNITS
    sigma[1][0, 0, 0] = 5.0
    beam = ("time", "wavelength"), [[0.5, 9.0, 0.7]], {"units": "W m-2 nm-1", "valid_max": 3.0}
    sky = written(tmp_path, sigma=(*sigma[:2], UNITS | {"valid_max": 1.0}), direct_normal_irradiance=beam)
    assert sky.masked == {"sigma not positive": 1}
    assert sky.direct_irradiance is not None
    assert np.isnan(sky.direct_irradiance[0]).tolist() == [False, True, False]
    with pytest.raises(ValueError, match=r"sky\.nc: .*`sun_zenith`"):
        written(tmp_path, sun_zenith=("time", [40.0], {"valid_max": 30.0}))


@pytest.mark.parametrize(
    ("variables", "note"),
    [
        ({"cloud_cover": ("time", [0.1])}, "variables not used: cloud_cover"),
        ({"qc": (("band",), [0, 1])}, "variables not used: qc"),
        ({"temperature": 281.0, "humidity": 0.4}, "variables not used: temperature, humidity"),
    ],
)
def test_variables_that_are_not_used_are_named(tmp_path, variables, note):
    assert written(tmp_path, **variables).notes == (note,)


def test_flags_with_other_meanings_than_flags_are_refused(tmp_path):
    with pytest.raises(ValueError, match="variable `radiance`: expected numbers for its valid range"):
        written(tmp_path, about={"valid_min": "low"})
    with pytest.raises(ValueError, match="variable `qc`: expected whole numbers as flags"):
        written(tmp_path, flags=[("qc", (AXES, *EACH, {"flag_values": "a b"}))])
    with pytest.raises(ValueError, match="variable `qc`: expected as many flag_meanings as flags, 2, found 1"):
        written(tmp_path, flags=[("qc", (AXES, *EACH, {"flag_values": [0, 1], "flag_meanings": "good"}))])


@pytest.mark.parametrize(
    ("file", "reason", "count"),
    [
        ("f11_quality_flag.nc", "flagged 1 by quality_flag", 780),
        ("f11_valid_range.nc", "outside its valid range", 476),
    ],
)
def test_the_flags_of_the_faulty_files_are_followed(shared, file, reason, count):
    path = shared / "faults" / file
    if not path.is_file():
        pytest.skip("the faulty files are absent")
    assert read(path).masked == {reason: count}


TABLE = "view_zenith,view_azimuth,wavelength,radiance,sun_zenith,sun_azimuth"


def table(folder, key, cells):
    rows = [f"{z},20,500,0.{z},30,40,{cell}" for z, cell in zip(range(10, 70, 10), cells, strict=True)]
    (folder / "sky.csv").write_text("\n".join([f"{TABLE},{key}", *rows]) + "\n")
    return read(folder / "sky.csv")


@pytest.mark.parametrize("key", ["quality_flag", "QC", "flag"])
@pytest.mark.parametrize(
    ("cells", "reasons", "how"),
    [
        ("000000", {}, "0 is taken as good"),
        ("010200", {"flagged 1": 1, "flagged 2": 1}, "0 is taken as good"),
        ("111111", {"flagged 1": 6}, "0 is taken as good"),
        (["0", "", "0.0", "1.0", "0", "0"], {"without a flag in": 1, "flagged 1": 1}, "0 is taken as good"),
        (
            ["good", "bad", "OK", "cloud", "not checked", "bad"], {"flagged bad": 2, "flagged cloud": 1},
            "words that say good are taken as such",
        ),
    ],
)  # fmt: skip
def test_a_column_of_flags_is_followed_and_a_note_says_how_many(tmp_path, key, cells, reasons, how):
    sky = table(tmp_path, key, cells)
    told = {f"{reason} {key}" if "without" in reason else f"{reason} by {key}": n for reason, n in reasons.items()}
    count = sum(reasons.values())
    assert sky.masked == told and np.count_nonzero(~sky.usable) == count
    assert sky.notes == (f"`{key}` does not say what its flags mean: {how}, {count} of 6 rows are flagged",)
    if count < 6:
        # what is written knows which samples are bad, and says why
        write_sky(sky, tmp_path / "again.csv")
        again = read(tmp_path / "again.csv")
        assert again.notes == sky.notes
        np.testing.assert_array_equal(again.usable, sky.usable)


def test_a_column_of_grades_is_none_of_flags(tmp_path):
    sky = table(tmp_path, "quality", ["0.95", "0.9", "1", "0.2", "0", "1"])
    assert sky.usable.all() and sky.notes == ("`quality` holds other numbers than flags: not used",)
