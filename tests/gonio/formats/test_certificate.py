"""Reflectances in digital calibration certificates: D-SI of both generations, what is ambiguous, what is wrong."""

import math
import re
from pathlib import Path

import pytest

from gonio import plugins
from gonio.errors import ConfigError
from gonio.formats.certificate import reflectance
from gonio.lab.acquisition.measure import carry_out, find_rig
from gonio.lab.acquisition.plan import load_plan
from gonio.lab.reduction.brdf import reduce
from gonio.samples.description import SampleDescription

HEAD = """<?xml version="1.0" encoding="UTF-8"?>
<dcc:digitalCalibrationCertificate xmlns:dcc="https://ptb.de/dcc" xmlns:si="https://ptb.de/si" schemaVersion="3.3.0">
 <dcc:measurementResults><dcc:measurementResult><dcc:name><dcc:content lang="en">White tile 7</dcc:content></dcc:name>
  <dcc:results><dcc:result><dcc:name><dcc:content lang="en">Results</dcc:content></dcc:name><dcc:data>
"""
TAIL = """</dcc:data></dcc:result></dcc:results></dcc:measurementResult></dcc:measurementResults>
</dcc:digitalCalibrationCertificate>"""
QUANTITY = (
    '<dcc:quantity id="{id}"><dcc:name><dcc:content lang="en">{name}</dcc:content></dcc:name>{body}</dcc:quantity>'
)
OLD = """<si:real><si:value>{value}</si:value><si:unit>{unit}</si:unit>
<si:expandedUnc><si:uncertainty>{u}</si:uncertainty>
<si:coverageFactor>2</si:coverageFactor><si:coverageProbability>0.95</si:coverageProbability></si:expandedUnc></si:real>"""
NEW = """<si:real><si:value>{value}</si:value><si:unit>{unit}</si:unit>
<si:measurementUncertaintyUnivariate><si:expandedMU>
<si:valueExpandedMU>{u}</si:valueExpandedMU><si:coverageFactor>2</si:coverageFactor></si:expandedMU>
</si:measurementUncertaintyUnivariate></si:real>"""
LISTS = (
    "<si:realListXMLList><si:valueXMLList>700 450 550</si:valueXMLList>"
    "<si:unitXMLList>\\nano\\metre</si:unitXMLList></si:realListXMLList>",
    "<si:realListXMLList><si:valueXMLList>0.97 0.98 0.99</si:valueXMLList><si:unitXMLList>\\one</si:unitXMLList>"
    "<si:measurementUncertaintyUnivariateXMLList><si:expandedMUXMLList><si:valueExpandedMUXMLList>0.01 0.02 0.006"
    "</si:valueExpandedMUXMLList><si:coverageFactorXMLList>2</si:coverageFactorXMLList></si:expandedMUXMLList>"
    "</si:measurementUncertaintyUnivariateXMLList></si:realListXMLList>",
)


def dcc(folder: Path, *quantities: tuple[str, str]) -> Path:
    body = "".join(QUANTITY.format(id=f"q{k}", name=name, body=xml) for k, (name, xml) in enumerate(quantities))
    path = folder / "white.xml"
    path.write_text(HEAD + body + TAIL, encoding="utf-8")
    return path


def rig_file(folder: Path, of_reference: str) -> str:
    """The simulated rig's own file, with other keys of how bright its reference is."""
    head, table, rest = re.split(r"(?m)^(\[reference\].*\n)", plugins.load("gonio.rigs", "sim").toml)
    own, gap, others = rest.partition("\n[")
    kept = [line for line in own.splitlines() if not re.match(r"(albedo|u_rel|error)\b", line)]
    (folder / "rig.toml").write_text(head + table + "\n".join([of_reference, *kept]) + gap + others, encoding="utf-8")
    return str(folder / "rig.toml")


@pytest.mark.parametrize("form", [OLD, NEW], ids=["D-SI 1", "D-SI 2"])
@pytest.mark.parametrize(("unit", "factor"), [("\\one", 1.0), ("\\percent", 100.0)])
def test_one_value_is_read_with_its_standard_uncertainty(tmp_path: Path, form: str, unit: str, factor: float) -> None:
    stated = form.format(value=0.985 * factor, unit=unit, u=0.008 * factor)
    temperature = form.format(value=296.0, unit="\\kelvin", u=0.5)
    found = reflectance(dcc(tmp_path, ("Room temperature", temperature), ("Reflectance 8/d", stated)))
    assert [*found.values, *found.u] == pytest.approx([0.985, 0.004])
    assert found.wavelengths_nm == ()


def test_a_run_is_reduced_with_what_the_certificate_says_of_its_wavelength(tmp_path: Path) -> None:
    dcc(tmp_path, ("Wavelength", LISTS[0]), ("Spectral reflectance", LISTS[1]))
    rig = find_rig(rig_file(tmp_path, 'certificate = "white.xml"'))
    assert list(rig.description.reference.spectrum[0]) == pytest.approx([450.0, 0.98, 0.01 / 0.98])
    at, u_rel = rig.description.reference.at(500.0)
    assert (at, u_rel) == pytest.approx((0.985, 0.5 * (0.01 / 0.98 + 0.003 / 0.99)))
    (tmp_path / "plan.toml").write_text(
        'name = "p"\nwavelength_nm = [550]\n[[sweep]]\ntheta_i_deg = [30]\ntheta_r_deg = [0, 10]\n'
    )
    sample = SampleDescription(name="matt", model="lambert", parameters={"albedo": 0.5})
    table = reduce(carry_out(load_plan(tmp_path / "plan.toml"), rig, tmp_path / "run", sample=sample))
    assert (tmp_path / "run" / "certificate.xml").read_bytes() == (tmp_path / "white.xml").read_bytes()
    # the noise of some thousand pixels; the simulated white has exactly what its certificate says
    assert table["brdf"].to_numpy() == pytest.approx(0.5 / math.pi, rel=0.01)
    assert (table["s_reference"] / table["brdf"]).to_numpy() == pytest.approx(0.003 / 0.99, rel=1e-3)
    (tmp_path / "plan.toml").write_text((tmp_path / "plan.toml").read_text().replace("550", "400"))
    with pytest.raises(ConfigError, match="certifies 450 to 700 nm"):
        carry_out(load_plan(tmp_path / "plan.toml"), rig, tmp_path / "other", sample=sample)
    assert not (tmp_path / "other").exists()


def test_a_rig_names_one_of_several_quantities(tmp_path: Path) -> None:
    both = (NEW.format(value=value, unit="\\one", u=0.01) for value in (0.97, 0.91))
    dcc(tmp_path, *zip(("Reflectance 8/d", "Reflectance 0/45"), both, strict=True))
    named = 'certificate = "white.xml"\ncertificate_quantity = "0/45"'
    assert find_rig(rig_file(tmp_path, named)).description.reference.albedo == 0.91
    with pytest.raises(ConfigError, match="certificate_quantity"):
        find_rig(rig_file(tmp_path, 'certificate = "white.xml"'))


def test_the_kind_of_a_quantity_counts_as_its_name(tmp_path: Path) -> None:
    path = dcc(tmp_path, ("Messwert", NEW.format(value=0.97, unit="\\one", u=0.01)))
    path.write_text(path.read_text().replace('id="q0"', 'id="q0" refType="optics_diffuseReflectance"'))
    assert list(reflectance(path).values) == pytest.approx([0.97])


def test_what_is_ambiguous_or_wrong_is_named(tmp_path: Path) -> None:
    one = NEW.format(value=0.985, unit="\\one", u=0.008)
    path = dcc(tmp_path, ("Reflectance 8/d", one), ("Reflectance 0/45", one))
    with pytest.raises(ConfigError, match=r"Reflectance 8/d.*Reflectance 0/45"):
        reflectance(path)
    assert reflectance(path, "0/45").name.endswith("Reflectance 0/45")
    assert reflectance(path, "q0").name.endswith("Reflectance 8/d")
    with pytest.raises(ConfigError, match=r"no quantity is called a reflectance.*Length"):
        reflectance(dcc(tmp_path, ("Length", one)))
    with pytest.raises(ConfigError, match="up to 1"):
        reflectance(dcc(tmp_path, ("Reflectance", NEW.format(value=98.5, unit="\\one", u=0.8))))
    path.write_text("<html/>")
    with pytest.raises(ConfigError, match="no digital calibration certificate"):
        reflectance(path)
    path.write_text('<!DOCTYPE x [<!ENTITY a "b">]><x>&a;</x>')
    with pytest.raises(ConfigError, match="declares entities"):
        reflectance(path)
    with pytest.raises(ConfigError, match="cannot be read"):
        reflectance(tmp_path / "none.xml")
    dcc(tmp_path, ("Reflectance", one))
    with pytest.raises(ConfigError, match=r"reference.certificate and reference.albedo both say"):
        find_rig(rig_file(tmp_path, 'certificate = "white.xml"\nalbedo = 0.9'))


@pytest.mark.parametrize(("k", "said"), [("<si:coverageFactor>0</si:coverageFactor>", "of 0"), ("", "missing")])
def test_an_expanded_uncertainty_without_its_factor_is_refused(tmp_path: Path, k: str, said: str) -> None:
    stated = OLD.format(value=0.9, unit="\\one", u=0.01).replace("<si:coverageFactor>2</si:coverageFactor>", k)
    with pytest.raises(ConfigError, match=rf"white\.xml: Reflectance: .*its coverageFactor is {said}"):
        reflectance(dcc(tmp_path, ("Reflectance", stated)))
