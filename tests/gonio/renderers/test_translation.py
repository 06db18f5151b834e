"""Materials of glTF and Blender: their BRDFs, the fit to a sample, and the files."""

from __future__ import annotations

import ast
import json
import math
import struct
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from gonio import measurement
from gonio.cli.tables import convert
from gonio.errors import ConfigError
from gonio.models import CookTorrance, HeTorrance, Lambert
from gonio.renderers import gltf, principled, translation
from gonio.renderers.microfacet import Geometry, Material
from tests.gonio.renderers.test_measured import sampled

COLOUR = np.array([0.6, 0.3, 0.1])
MATERIALS = [
    gltf.MetallicRoughness(COLOUR, 0.4),
    gltf.Dielectric(COLOUR, 0.5, 1.6, 1.0),
    gltf.Coated(gltf.Dielectric(COLOUR, 0.7, 1.5, 1.0), 0.8, 0.2),
    principled.Metal(COLOUR, 0.4, 0.8),
    principled.Plastic(COLOUR, 0.45, 1.6, 0.5),
]


def target() -> translation.Target:
    """Directions, and a white that tests replace."""
    return translation.of_model(Lambert(albedo=0.5), "white")


@pytest.mark.parametrize("material", MATERIALS, ids=lambda m: type(m).__name__)
def test_a_material_is_found_again(material: Material) -> None:
    given = target()
    given = replace(given, values=material.brdf(given.geometry))
    to = "gltf" if type(material) in gltf.KINDS else "principled"
    made = translation.translate(given, to)
    # the optimiser's tolerance (1e-8 of the cost); a coat's parameters trade against its base's
    np.testing.assert_allclose(made.material.brdf(given.geometry), given.values, rtol=0.02)
    assert not any("WARNING" in remark for remark in made.remarks)
    if not isinstance(material, gltf.Coated):
        assert type(made.material) is type(material)
        key = "roughnessFactor" if to == "gltf" else "Roughness"
        assert made.material.shown()[key] == pytest.approx(material.shown()[key], rel=0.01)


@pytest.mark.parametrize("roughness", [0.2, 0.5, 1.0])
@pytest.mark.parametrize("lobe", [gltf._lobe, principled._lobe])
def test_lobes_are_ggx_at_the_mirror_direction_and_keep_their_energy(lobe: object, roughness: float) -> None:
    assert callable(lobe)
    normal = Geometry(*np.ones((4, 1)))
    # D = 1/(pi alpha^2), G = 1: a quarter of it
    assert lobe(normal, roughness)[0] == pytest.approx(1 / (4 * math.pi * roughness**4), rel=1e-12)
    cosines, pairs, share = principled._hemisphere()
    albedo = (lobe(pairs, roughness) * share).reshape(cosines.size, -1).sum(axis=1)
    assert (albedo < 1.005).all()  # single scattering loses light and makes none; the quadrature has half a percent
    if roughness == 0.2:
        assert albedo[-1] == pytest.approx(1.0, abs=0.01)
    if roughness == 1.0:  # at the normal brdf = 1/(2 pi (1 + cos)), whose integral with the cosine is 1 - ln 2
        assert albedo[-1] == pytest.approx(1 - math.log(2), abs=1e-3)


def test_both_programs_fresnel_has_its_limits() -> None:
    ior = 1.5
    f = principled.Plastic(COLOUR, 0.3, ior, 0.5)._fresnel(np.array([1.0, 1e-9]))
    np.testing.assert_allclose(f, [0.04, 1.0], atol=1e-6)
    brewster = math.cos(math.atan(ior))
    r_s = ((ior**2 - 1) / (ior**2 + 1)) ** 2  # at Brewster's angle nothing of p comes back
    assert principled._dielectric(np.array([brewster]), ior)[0] == pytest.approx(r_s / 2, rel=1e-12)


def write_sample(folder: Path, text: str) -> str:
    (folder / "s.toml").write_text(text)
    return str(folder / "s.toml")


GLOSS = (
    'name = "paint"\nmodel = "cook-torrance"\n[parameters]\ns = 0.4\nd = 0.6\nslopes = 0.3\nior = 1.5\n'
    'diffuse_albedo = 0.5\nconvention = "normalised"\n'
)


@pytest.mark.parametrize("ending", ["gltf", "glb"])
def test_gltf_files_load_and_state_their_residuals(tmp_path: Path, ending: str) -> None:
    out = tmp_path / f"paint.{ending}"
    convert(write_sample(tmp_path, GLOSS), out)
    scene = trimesh.load_scene(out)
    (mesh,) = scene.geometry.values()
    assert mesh.is_watertight or mesh.merge_vertices() is None
    assert mesh.area == pytest.approx(4 * math.pi, rel=0.02)  # facets of a unit sphere
    assert mesh.volume > 0  # seen from outside
    assert mesh.visual.material.name == "paint"
    data = out.read_bytes()
    if ending == "glb":
        magic, version, length = struct.unpack_from("<4sII", data)
        assert (magic, version, length) == (b"glTF", 2, len(data))
        size, kind = struct.unpack_from("<I4s", data, 12)
        assert kind == b"JSON"
        document = json.loads(data[20 : 20 + size])
    else:
        document = json.loads(data)
    (material,) = document["materials"]
    assert set(material.get("extensions", {})) == set(document.get("extensionsUsed", []))
    factors = material["pbrMetallicRoughness"]
    assert len(factors["baseColorFactor"]) == 4
    assert 0 <= factors["roughnessFactor"] <= 1
    residuals = material["extras"]["residuals"]
    assert {r["region"] for r in residuals} >= {"around the mirror direction", "elsewhere"}
    assert all(0.5 < r["median_ratio"] < 2 for r in residuals)


def test_blenders_parameters_are_json_or_a_script(tmp_path: Path) -> None:
    source = write_sample(tmp_path, GLOSS)
    convert(source, tmp_path / "m.json", None, "principled")
    document = json.loads((tmp_path / "m.json").read_text())
    assert document["distribution"] == "GGX"
    assert document["extras"]["residuals"]
    convert(source, tmp_path / "m.py", None, "principled")
    tree = ast.parse((tmp_path / "m.py").read_text())
    calls = [n.args[0].value for n in ast.walk(tree) if isinstance(n, ast.Call) and ast.unparse(n.func) == "json.loads"]  # type: ignore[attr-defined]
    assert [json.loads(c) for c in calls] == [document["extras"], document["inputs"]]
    with pytest.raises(ConfigError, match=r'".json", or as a script'):
        convert(source, tmp_path / "m.blend", None, "principled")
    with pytest.raises(ConfigError, match=r'ends in ".gltf"'):
        convert(source, tmp_path / "m.xml", None, "gltf")


def test_a_quote_in_a_name_stays_a_name(tmp_path: Path) -> None:
    convert(write_sample(tmp_path, GLOSS.replace("paint", "a'b\\\\n {x}")), tmp_path / "m.py", None, "principled")
    assert "a'b\\\\n {x}" in (tmp_path / "m.py").read_text()
    ast.parse((tmp_path / "m.py").read_text())


def test_a_table_is_fitted_at_its_own_directions(tmp_path: Path) -> None:
    model = CookTorrance(0.5, 0.5, 0.3, 1.5, diffuse_albedo=0.3, convention="normalised")
    measurement.write(sampled(model, [20, 45, 60], 5), tmp_path / "t.csv")
    convert(str(tmp_path / "t.csv"), tmp_path / "m.json", None, "principled")
    document = json.loads((tmp_path / "m.json").read_text())
    assert any("of the table, and to nothing beyond them" in r for r in document["extras"]["remarks"])


@pytest.mark.slow
def test_what_a_material_cannot_say_is_said() -> None:
    smooth = translation.of_model(HeTorrance(sigma0_um=0.02, tau_um=2.0, ior="Al"), "mirror")
    assert any("specular spike" in note for note in smooth.notes)
    grazing = replace(target(), values=np.where(target().geometry.cos_r[:, None] < 0.3, 1.0, 0.1))
    assert any(r.startswith("WARNING") and "grazing" in r for r in translation.translate(grazing, "gltf").remarks)


def test_a_spectrum_becomes_a_colour() -> None:
    copper = translation.of_model(HeTorrance(sigma0_um=0.3, tau_um=1.5, ior="Cu"), "copper")
    red, green, blue = np.median(copper.values, axis=0)
    assert red > green > blue
