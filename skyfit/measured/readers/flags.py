"""Flags and valid ranges of a file's samples, by the CF conventions, and columns of flags."""

import re
from collections.abc import Iterator, Sequence

import numpy as np
from jaxtyping import Bool

from .header import plain


# names of flags that no attribute marks as such
FLAG_NAMES = frozenset(
    "quality_flag quality_flags quality flag flags qc qc_flag qc_flags radiance_qc radiance_flag".split()
)
# words of a meaning that is no reason against a sample, unless one of `_NOT` is beside them
_GOOD = frozenset(
    "good ok okay valid nominal clear pass passed normal best usable accepted acceptable fine success reliable".split()
)
_NOT = frozenset("not no non un in bad".split())
# meanings of samples that were not judged, which is no reason against them
_UNJUDGED = re.compile(r"(not?|un)_?(yet_)?(evaluated|checked|performed|assessed|tested|determined)|no_qc.*|unknown")


def flag_variables(data) -> list[str]:
    """The variables that flag `radiance`: ancillary ones of integers, and others with attributes or a name of flags."""
    named = str(data["radiance"].attrs.get("ancillary_variables", "")).split()
    found = []
    for key in map(str, data.variables):
        about, dims = data[key].attrs, data[key].dims
        told = "flag_values" in about or "flag_masks" in about or "flag" in str(about.get("standard_name", ""))
        whole = data[key].dtype.kind in "iub" and key in named
        if (told or whole or key.lower() in FLAG_NAMES) and set(dims) <= {"time", "direction", "wavelength", "channel"}:
            found.append(key)
    return found


def flagged(name: str, key: str, numbers: np.ndarray, about: dict) -> Iterator[tuple[str, Bool[np.ndarray, "..."]]]:
    """Reasons against samples and where each holds.

    **Arguments:** `numbers` of the flag `key`, NaN where it has none; `about`, its attributes: `flag_values`,
    `flag_masks` and `flag_meanings`; without them 0 is good.
    """
    values, masks = (_integers(name, key, about.get(n)) for n in ("flag_values", "flag_masks"))
    meanings = str(about.get("flag_meanings", "")).split()
    told = values if values is not None else masks
    if told is not None and meanings and len(meanings) != len(told):
        raise ValueError(
            f"{name}: variable `{key}`: expected as many flag_meanings as flags, {len(told)}, found {len(meanings)}"
        )
    missing = np.isnan(numbers)
    yield f"without a flag in {key}", missing
    whole = np.where(missing, 0, numbers).astype(np.int64)
    if told is None:
        for value in np.unique(whole[~missing & (whole != 0)]):
            yield f"flagged {value} by {key}", ~missing & (whole == value)
        return
    known = missing | (whole == 0)
    for place, number in enumerate(np.asarray(told).tolist()):
        if masks is None:
            where = ~missing & (whole == int(number))
        else:
            bits = int(masks[place])
            where = ~missing & ((whole & bits) == (bits if values is None else int(number)))
        known |= where
        meaning = meanings[place] if meanings else ("good" if int(number) == 0 else str(number))
        if not harmless(meaning):
            yield f"flagged {meaning} by {key}", where
    if masks is None:
        # if other numbers mean good, 0 is one more flag without a meaning
        bare = ~missing & (whole == 0) & ~np.isin(0, told) & any(map(harmless, meanings))
        for value in np.unique(whole[~known | bare]):
            yield f"flagged {value} by {key}", ~missing & (whole == value)


def flagged_cells(key: str, cells: Sequence[str]) -> tuple[dict[str, Bool[np.ndarray, " row"]], str]:
    """Reasons against the rows of a table by one of its columns, and a note that says how many rows are flagged.

    **Arguments:** `cells` of the column `key`, as in the file: numbers of which 0 is good, or words such as "good".
    """
    texts = np.array([cell.strip() for cell in cells])
    try:
        numbers = np.array([np.nan if text == "" else float(text) for text in texts.tolist()])
    except ValueError:
        bad = [word for word in dict.fromkeys(texts.tolist()) if not harmless(word)]
        found = {f"flagged {word} by {key}" if word else f"without a flag in {key}": texts == word for word in bad}
        how = "words that say good are taken as such"
    else:
        if np.any(numbers % 1.0 > 0.0):
            return {}, f"`{key}` holds other numbers than flags: not used"
        found = {reason: where for reason, where in flagged("", key, numbers, {}) if where.any()}
        how = "0 is taken as good"
    count = int(np.count_nonzero(np.any(list(found.values()), axis=0))) if found else 0
    return found, f"`{key}` does not say what its flags mean: {how}, {count} of {len(texts)} rows are flagged"


def _integers(name, key, told):
    """Flags as integers, also from text such as "0b, 1b"; None for none."""
    if isinstance(told, str):
        told = re.findall(r"[-+]?\w+", re.sub(r"(?<=\d)[bBsSlL]\b", "", told))
    try:
        return None if told is None else np.atleast_1d(np.asarray(told, np.int64))
    except ValueError:
        raise ValueError(f"{name}: variable `{key}`: expected whole numbers as flags, found {told!r}") from None


def harmless(meaning: str) -> bool:
    """Whether a flag's meaning is no reason against a sample."""
    text = plain(meaning)
    if _UNJUDGED.fullmatch(text):
        return True
    words = set(text.split("_"))
    return bool(words & _GOOD) and not words & _NOT


def outside(name: str, variable) -> Bool[np.ndarray, "..."]:
    """Where the numbers of a variable are not within its `valid_range`, `valid_min` and `valid_max`.

    For packed numbers the limits are packed as well, unless they have the type of the unpacked numbers.
    **Source:** NetCDF Users Guide, appendix A, and CF 1.11, 2.5.1, 8.1.
    """
    about, packing = variable.attrs, variable.encoding
    limits = about.get("valid_range", (about.get("valid_min", -np.inf), about.get("valid_max", np.inf)))
    low, high = limits if np.size(limits) == 2 else (-np.inf, np.inf)
    if not all(isinstance(limit, int | float | np.number) for limit in (low, high)):
        raise ValueError(f"{name}: variable `{variable.name}`: expected numbers for its valid range, found {limits!r}")
    scale, offset = (packing.get(name, usual) for name, usual in (("scale_factor", 1.0), ("add_offset", 0.0)))
    stored = np.dtype(packing.get("dtype", variable.dtype))
    unpacked = [limit for limit in (low, high) if np.isfinite(limit)]
    packed = {"scale_factor", "add_offset"} & packing.keys()
    if packed and all(np.asarray(limit).dtype.kind in "iu" or np.asarray(limit).dtype == stored for limit in unpacked):
        low, high = sorted((float(low) * scale + offset, float(high) * scale + offset))
    values = np.asarray(variable.values)
    # tolerance for limits in another precision than that of the numbers
    slack = 1e-6 * max(abs(limit) for limit in (low, high) if np.isfinite(limit)) if unpacked else 0.0
    with np.errstate(invalid="ignore"):
        return np.asarray((values < float(low) - slack) | (values > float(high) + slack))
