"""What to rename where the columns of a table made by hand are nearly those of the measurement table."""

import difflib
import itertools
import re
from collections import defaultdict
from collections.abc import Sequence

from gonio.formats.reader import ANGLES, COLUMNS

NEEDED = (*ANGLES, "brdf")
"""The columns that every table has."""

_ANGLE = re.compile(
    r"(theta|tetha|thetha|theat|teta|phi|θ|ϑ|φ|ϕ|polar|azimuth)_?"
    r"(i|in|inc|incident|incidence|src|source|l|light|r|o|out|s|refl|reflected|scat|scattered|det|detector|v|view)"
)
"""Half and difference angles (theta_h, theta_d) are none of these, and are no measurement table's."""
_REVERSED = re.compile(
    r"(source|src|light|incident|incidence|inc|in|viewing|view|detector|det|receiver|reflected|reflection|observation|"
    r"obs|out)_?(zenith|polar|theta|azimuth|phi|z|az|a)(_angle)?"
)
_SHORT = {"ti": "theta_i_deg", "pi": "phi_i_deg", "tr": "theta_r_deg", "pr": "phi_r_deg"}
"""Angles where all four are called so."""
_SUN = {"theta_s": "theta_i_deg", "phi_s": "phi_i_deg"}
"""Angles of the source where theta_v is the viewer's; else s is where light is scattered to."""
_AZIMUTHS = ("phi", "φ", "ϕ", "azimuth", "az", "a")
_INCIDENT = ("i", "src", "source", "l")
_UNITS = {
    "": "", "deg": "deg", "degree": "deg", "degrees": "deg", "°": "deg", "rad": "rad", "radian": "rad",
    "radians": "rad", "nm": "nm", "um": "um", "µm": "um", "μm": "um", "micron": "um", "microns": "um",
    "1/sr": "1/sr", "sr^-1": "1/sr", "sr^_1": "1/sr", "sr-1": "1/sr", "sr⁻¹": "1/sr",
    "per_sr": "1/sr", "%": "%", "percent": "%", "pct": "%",
}  # fmt: skip
_NAMES = {
    "wavelength_nm": {"wavelength", "lambda", "wl", "wvl", "λ"},
    "polarisation": {"polarization", "polarisation", "pol"},
    "sample": {"sample", "sample_name"},
    "brdf": {"brdf", "bsdf", "f_r", "fr", "brdf_value"},
    "u_brdf": {"u_brdf", "ubrdf", "brdf_u", "brdf_unc", "brdf_uncertainty", "u_f_r", "uncertainty", "unc",
               "unc_brdf", "sigma_brdf", "std_brdf", "brdf_std", "u(brdf)"},
    "flag": {"flag", "flags"},
}  # fmt: skip
_BY_NAME = {name: column for column, names in _NAMES.items() for name in names}
_FACTOR = {"reflectance_factor", "radiance_factor"}
_ALLOWED = {"deg": "_deg", "rad": "_deg", "nm": "_nm", "um": "_nm", "1/sr": "brdf"}
"""How the name of a column that may have this unit ends."""
_REMARKS = {
    "theta_i_deg": "degrees, toward the source",
    "theta_r_deg": "degrees, toward the detector",
    "phi_i_deg": "degrees, toward the source",
    "phi_r_deg": "degrees, toward the detector; the mirror side is phi_i + 180",
    "wavelength_nm": "nanometres",
    "brdf": "1/sr; a reflectance factor is divided by pi first",
    "u_brdf": "1/sr, standard uncertainties; an expanded uncertainty U is divided by its k first",
}
_CONVERTED = {"rad": "multiply its radians by 180/pi", "um": "multiply its micrometres by 1000"}
_LOOKED_AT = 64
"""Unknown columns that are looked at, at most: a file with more of them is another kind of table."""


def column_hints(header: Sequence[str]) -> list[str]:
    """A sentence for each unknown column that is nearly one of the measurement table, saying how to make it that.

    There is none for a column that the table has already, nor where several columns could be the same one.
    """
    return [_sentence(name, column, unit) for column, (name, unit) in found_in(header).items()]


def are_units(cells: Sequence[str]) -> bool:
    """Whether a line holds units alone, as it may stand under a header: words for units, and empty cells."""
    said = [*map(unit_of, cells)]
    return None not in said and any(unit not in ("", "-") for unit in said)


def unit_of(cell: str) -> str | None:
    """The unit that a cell is, as this module writes it; "-" where it says that there is none; None for other text."""
    word = cell.strip().strip("#[]()").strip().lower()
    return "-" if word == "-" else _UNITS.get(word)


def unit_in(name: str) -> str:
    """The unit that a column's name says, as "deg", "rad", "nm", "um", "1/sr" or "%"; "" where it says none."""
    return word_and_unit(name)[1]


def found_in(header: Sequence[str]) -> dict[str, tuple[str, str]]:
    """Columns of the table that the header lacks: the one of its names that nearly is it, and the unit to name."""
    found = defaultdict(list)
    names = [*itertools.islice((name for name in header if name not in COLUMNS and len(name) <= 40), _LOOKED_AT)]
    sun = {"theta_s", "theta_v"} <= {word_and_unit(name)[0] for name in names}
    for name in names:
        near = _nearly(name)
        if near is not None and sun and (column := _SUN.get(word_and_unit(name)[0])):
            near = column, near[1]
        if near is not None and near[0] not in header:
            found[near[0]].append((name, near[1]))
    short = {name.strip().lower(): name for name in header}
    if short.keys() >= _SHORT.keys():
        found |= {column: [(short[name], "")] for name, column in _SHORT.items()}
    return {column: several[0] for column, several in found.items() if len(several) == 1}


def _sentence(name: str, column: str, unit: str) -> str:
    """How to make a column of this name that of the table."""
    if unit == "percent":
        return f"divide {name!r} by 100 pi, if it is a reflectance factor in percent, and name it {column!r}"
    if unit == "factor":
        return f"divide {name!r} by pi and name it {column!r}"
    if unit in _CONVERTED:
        return f"{_CONVERTED[unit]} and name it {column!r} (now {name!r})"
    remark = _REMARKS.get(column, "")
    return f"rename {name!r} to {column!r}" + (f" ({remark})" if remark else "")


def _nearly(name: str) -> tuple[str, str] | None:
    """The column that this name is nearly that of, if any, and the unit that `--columns` needs for it, if any."""
    word, unit = word_and_unit(name)
    if unit == "%" and (word in _FACTOR or _BY_NAME.get(word) == "brdf"):
        return "brdf", "percent"
    if word in _FACTOR and not unit:
        return "brdf", "factor"
    angle, reverse = _ANGLE.fullmatch(word), _REVERSED.fullmatch(word)
    if angle or reverse:
        what, where = angle.groups() if angle else reverse.group(2, 1) if reverse else ("", "")
        kind, side = "phi" if what in _AZIMUTHS else "theta", "i" if where.startswith(_INCIDENT) else "r"
        column = f"{kind}_{side}_deg"
    else:
        near = difflib.get_close_matches(word, _SPELT, n=1, cutoff=0.85)
        found = _BY_NAME.get(word) or (_SPELT[near[0]] if near else None)
        if found is None:
            return None
        column = found
    if unit and (unit not in _ALLOWED or not column.endswith(_ALLOWED[unit])):
        return None
    return column, unit if unit in _CONVERTED else ""


_SPELT = {"wavelength": "wavelength_nm", "polarisation": "polarisation", "sample": "sample", "u_random": "u_random"}
"""Words long enough to be known by a slip of the pen; one letter makes an angle another angle."""


def word_and_unit(name: str) -> tuple[str, str]:
    """A column's name without case, blanks and unit; and its unit, as this module writes it."""
    plain = re.sub(r"[\s\-.]+", "_", re.sub(r"(?<![a-z])sr-1", "1/sr", name.strip().lower()))
    bracketed = re.fullmatch(r"(.*?)_*[\[(]\s*(.*?)\s*[\])]", plain)
    if bracketed and bracketed[2] in _UNITS:
        return bracketed[1].strip("_"), _UNITS[bracketed[2]]
    if plain.endswith("%"):
        return plain.rstrip("%_"), "%"
    word, _, unit = plain.rpartition("_")
    if word and unit in _UNITS:
        return word.strip("_"), _UNITS[unit]
    joined = re.fullmatch(r"(.*[^_])(deg|rad|nm|um)", plain)  # without anything between
    if joined and (_ANGLE.fullmatch(joined[1]) or joined[1] in _BY_NAME):
        return joined[1], joined[2]
    return plain.strip("_"), ""
