"""A DataCite record (metadata schema 4, as JSON) of a measured table, from what its laboratory states.

It is what a repository asks for when data get a DOI. Without `laboratory.doi` the record has none yet.
"""

import json
from pathlib import Path

from gonio.errors import ConfigError
from gonio.formats.reader import Need, get, laboratory_of, require, write_bytes
from gonio.typing import DataFrame, JsonObject

_SCHEMA = "http://datacite.org/schema/kernel-4"
_NEEDED: tuple[Need, ...] = ("creators", "publication_year", ("publisher", "organisation"))


def record(frame: DataFrame, path: Path) -> JsonObject:
    """The record of a table; `path` is for messages.

    Raises
    ------
    ConfigError
        The table states no laboratory, or not all that a record needs; the message names every key that is missing.
    """
    stated = laboratory_of(frame)
    if stated is None:
        raise ConfigError(
            f"{path}: the table does not say whose it is: a DataCite record needs a table [laboratory] in the plan or "
            "the rig file of its run (docs/interchange.md)"
        )
    named = get(stated, "sample.name") or frame.attrs.get("sample")
    needed: list[Need] = [*_NEEDED, *([] if named else [("title", "sample.name")])]
    require(stated, needed, "a DataCite record", path)
    simulated = (frame.attrs.get("provenance") or {}).get("simulated") is True
    what = "Simulated measurement" if simulated else "Measurement"
    out: JsonObject = {
        "schemaVersion": _SCHEMA,
        "types": {"resourceTypeGeneral": "Dataset", "resourceType": f"{what} of a BRDF"},
        "creators": [_creator(one) for one in stated["creators"]],
        "titles": [{"title": stated.get("title") or f"BRDF of {named}"}],
        "publisher": {"name": stated.get("publisher") or stated["organisation"]},
        "publicationYear": str(stated["publication_year"]),
        "subjects": [{"subject": "BRDF"}, {"subject": "goniometry"}],
        "formats": ["text/csv"],
        "sizes": [f"{len(frame)} values"],
    }
    of = stated.get
    contact = {"contributorType": "ContactPerson", "name": of("contact")}
    contact |= {"affiliation": [{"name": of("organisation")}]} if "organisation" in stated else {}
    rights = {"rights": of("license")} | ({"rightsUri": of("license_link")} if "license_link" in stated else {})
    names = {"funder": "funderName", "award": "awardNumber", "title": "awardTitle"}
    optional: JsonObject = {
        "measured": ("dates", [{"date": str(of("measured"))[:10], "dateType": "Collected"}]),
        "doi": ("doi", of("doi")),
        "contact": ("contributors", [contact]),
        "license": ("rightsList", [rights]),
        "description": ("descriptions", [{"description": of("description"), "descriptionType": "Abstract"}]),
        "funding": ("fundingReferences", [{names[k]: v for k, v in one.items()} for one in of("funding", [])]),
    }
    return out | dict(entry for key, entry in optional.items() if key in stated)


def encode(content: JsonObject) -> bytes:
    """A record as a file has it."""
    return json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False).encode() + b"\n"


def write(frame: DataFrame, path: Path) -> list[str]:
    """Write the record of a table.

    Returns
    -------
    list of str
        That there is no DOI yet, where that is so.

    Raises
    ------
    ConfigError
        As `record` does, or the file cannot be written.
    """
    content = record(frame, path)
    write_bytes(path, encode(content))
    return [] if "doi" in content else ["the record has no DOI yet: laboratory.doi, once there is one"]


def _creator(stated: JsonObject) -> JsonObject:
    out: JsonObject = {"name": stated["name"]}
    family, comma, first = stated["name"].partition(",")
    if comma and first.strip():
        out |= {"nameType": "Personal", "familyName": family.strip(), "givenName": first.strip()}
    if "orcid" in stated:
        scheme = {"nameIdentifierScheme": "ORCID", "schemeUri": "https://orcid.org"}
        identifier = {"nameIdentifier": f"https://orcid.org/{stated['orcid']}"} | scheme
        out |= {"nameType": "Personal", "nameIdentifiers": [identifier]}
    if "affiliation" in stated:
        out["affiliation"] = [{"name": stated["affiliation"]}]
    return out
