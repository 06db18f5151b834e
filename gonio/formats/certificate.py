"""Digital calibration certificates of a reference's reflectance: DCC (versions 2 and 3) with D-SI values.

A DCC is XML. Its quantities stand in `dcc:quantity`, named, with an `si:real` (one value) or an `si:realListXMLList`
(one a wavelength). Versions 1 and 2 of D-SI write the uncertainty differently; both are read. Elements are known by
their names without the namespace's version.
"""

import itertools
import math
import re
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

from gonio.disk import read_file
from gonio.errors import ConfigError, DataError, os_error_as
from gonio.formats import xml_text

MOST_BYTES = 16 * 2**20
_RATIOS = {"\\one": 1.0, "1": 1.0, "": 1.0, "\\percent": 0.01, "%": 0.01}
_LENGTHS = {"\\nano\\metre": 1.0, "\\nano\\meter": 1.0, "\\micro\\metre": 1e3, "\\metre": 1e9, "\\milli\\metre": 1e6}
_MEANT = re.compile("reflectan|albedo|remission|radiance.?factor|reflexionsgrad|strahldichtefaktor", re.IGNORECASE)


@dataclass(frozen=True)
class CertifiedReflectance:
    """What a certificate says of a reference."""

    name: str
    wavelengths_nm: tuple[float, ...]
    """Ascending; nothing where one value stands for all."""
    values: tuple[float, ...]
    u: tuple[float, ...]
    """Standard uncertainties."""


def reflectance(path: Path, wanted: str | None = None) -> CertifiedReflectance:
    """The reflectance in a certificate.

    Parameters
    ----------
    path
        The XML file.
    wanted
        Part of the quantity's name, or its id; needed where several quantities may be meant.

    Raises
    ------
    ConfigError
        The file cannot be read, is no DCC, or holds no such quantity or several.
    """
    root = _root(path)
    found: dict[str, CertifiedReflectance] = {}
    for result in _all(root, "result"):
        quantities = [(_name(q), q) for q in _all(result, "quantity")]
        waves = next((w for _, q in quantities if (w := _values(q, _LENGTHS, path)) and len(w[0]) > 1), None)
        for name, quantity in quantities:
            label = f"{_name(result)}: {name}".strip(": ")
            kind = f"{label} {quantity.get('refType') or ''}"
            meant = wanted.lower() in kind.lower() or wanted == quantity.get("id") if wanted else _MEANT.search(kind)
            if meant and (known := _values(quantity, _RATIOS, path)) is not None:
                found[label] = _reflectance(label, known, waves[0] if waves else (), path)
    if len(found) == 1:
        return next(iter(found.values()))
    listed = "; ".join(found) or "; ".join(dict.fromkeys(_name(q) for q in _all(root, "quantity") if _name(q)))
    if found or wanted:
        raise ConfigError(
            f"{path}: reference.certificate_quantity = {wanted!r}: {len(found)} quantities are called so; "
            f"name one of: {listed}"
        )
    raise ConfigError(
        f"{path}: reference.certificate: no quantity is called a reflectance; name the right one as "
        f"reference.certificate_quantity. The file has: {listed or 'none'}"
    )


def _root(path: Path) -> ElementTree.Element:
    with os_error_as(ConfigError, f"{path}: reference.certificate cannot be read"):
        data = read_file(path, MOST_BYTES + 1)
    if len(data) > MOST_BYTES:
        raise ConfigError(f"{path}: reference.certificate is larger than {MOST_BYTES >> 20} MiB")
    try:
        root = xml_text.root(data, f"{path}: reference.certificate")
    except DataError as error:
        raise ConfigError(str(error)) from None
    if _local(root) != "digitalCalibrationCertificate":
        raise ConfigError(f"{path}: reference.certificate is no digital calibration certificate (DCC)")
    return root


def _reflectance(
    name: str, known: tuple[tuple[float, ...], tuple[float, ...]], waves: tuple[float, ...], path: Path
) -> CertifiedReflectance:
    values, u = known
    if not all(0.0 < value <= 1.0 for value in values):
        raise ConfigError(f"{path}: {name} = {min(values):g} to {max(values):g}: a reflectance lies above 0, up to 1")
    if len(values) == 1:
        return CertifiedReflectance(name, (), values, u)
    if len(waves) != len(values):
        raise ConfigError(f"{path}: {name} has {len(values)} values and {len(waves)} wavelengths beside them")
    order = sorted(range(len(waves)), key=lambda k: waves[k])
    if any(waves[b] <= waves[a] for a, b in itertools.pairwise(order)):
        raise ConfigError(f"{path}: {name}: a wavelength stands there twice")
    return CertifiedReflectance(name, *(tuple(column[k] for k in order) for column in (waves, values, u)))


def _values(
    quantity: ElementTree.Element, units: dict[str, float], path: Path
) -> tuple[tuple[float, ...], tuple[float, ...]] | None:
    """Values and standard uncertainties of a quantity, where it has one of these units; without uncertainty: 0."""
    for real in quantity.iter():
        if _local(real) not in ("real", "realListXMLList"):
            continue
        unit = (_text(real, "unit") or _text(real, "unitXMLList")).split()
        if len(set(unit)) > 1 or "".join(unit[:1]) not in units:
            continue
        factor = units["".join(unit[:1])]
        values = _numbers(real, ("value", "valueXMLList"), path)
        if not values:
            continue
        standard = _numbers(
            real, ("valueStandardMU", "valueStandardMUXMLList", "standardUnc", "standardUncXMLList"), path
        )
        if not standard:
            expanded = _numbers(
                real, ("uncertainty", "uncertaintyXMLList", "valueExpandedMU", "valueExpandedMUXMLList"), path
            )
            k = _numbers(real, ("coverageFactor", "coverageFactorXMLList"), path)
            if expanded and (not k or min(k) <= 0):
                said = f"of {min(k):g}" if k else "missing"
                raise ConfigError(
                    f"{path}: {_name(quantity)}: an expanded uncertainty, and its coverageFactor is {said}"
                )
            k = k * len(expanded) if len(k) == 1 else k
            if len(k) != len(expanded) and expanded:
                raise ConfigError(
                    f"{path}: {_name(quantity)}: {len(expanded)} uncertainties, {len(k)} coverage factors"
                )
            standard = tuple(each / factor_k for each, factor_k in zip(expanded, k, strict=bool(expanded)))
        standard = standard * len(values) if len(standard) == 1 else standard or (0.0,) * len(values)
        if len(standard) != len(values):
            raise ConfigError(f"{path}: {_name(quantity)}: {len(values)} values, {len(standard)} uncertainties")
        if any(u < 0 for u in standard):
            raise ConfigError(f"{path}: {_name(quantity)}: an uncertainty below 0")
        return tuple(factor * value for value in values), tuple(factor * u for u in standard)
    return None


def _numbers(where: ElementTree.Element, names: tuple[str, ...], path: Path) -> tuple[float, ...]:
    text = next((said for name in names if (said := _text(where, name))), "")
    try:
        found = tuple(float(word) for word in text.split())
    except ValueError:
        raise ConfigError(f"{path}: {names[0]} = {text[:60]!r} is no number") from None
    if not all(math.isfinite(value) for value in found):
        raise ConfigError(f"{path}: {names[0]} = {text[:60]!r} is not finite")
    return found


def _all(where: ElementTree.Element, name: str) -> list[ElementTree.Element]:
    return [element for element in where.iter() if _local(element) == name]


def _text(where: ElementTree.Element, name: str) -> str:
    return next(((element.text or "").strip() for element in where.iter() if _local(element) == name), "")


def _name(where: ElementTree.Element) -> str:
    """The first content of an element's own name; else what its refType says."""
    own = next((child for child in where if _local(child) == "name"), None)
    said = _text(own, "content") if own is not None else ""
    return said or (where.get("refType") or "").replace("_", " ")


def _local(element: ElementTree.Element) -> str:
    return str(element.tag).rpartition("}")[2]
