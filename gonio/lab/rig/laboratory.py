"""Who measured what, and where: the table `[laboratory]` of a rig file or a plan (docs/interchange.md).

Nothing here changes a measurement. It goes from the run into the table, and from there into BiRD and DataCite records.
Every key is optional: what a record needs and nobody has stated is named when that record is asked for.
"""

from typing import Annotated

from pydantic import Field, StringConstraints, field_validator

from gonio.config import Positive, Strict, parse
from gonio.typing import TomlTable, laid_over

Words = Annotated[str, StringConstraints(min_length=1, strip_whitespace=True)]
"""A text that says something."""
Email = Annotated[str, StringConstraints(pattern=r"^[^@\s]+@[^@\s]+\.[^@\s]+$")]
Link = Annotated[str, StringConstraints(pattern=r"^https?://\S+$")]
Orcid = Annotated[str, StringConstraints(pattern=r"^\d{4}-\d{4}-\d{4}-\d{3}[\dX]$")]
Doi = Annotated[str, StringConstraints(pattern=r"^10\.\d{4,}/\S+$")]


class Address(Strict):
    """Where the organisation is."""

    country: Words | None = None
    county: Words | None = None
    city: Words | None = None
    street: Words | None = None
    building: Words | None = None
    """Number in the street."""
    room: Words | None = None
    postal_code: Words | None = None


class Specimen(Strict):
    """The sample as a thing: what a simulated sample's file does not say."""

    name: Words | None = None
    """Name of the sample; in a simulated run that of the sample's file, unless it is given."""
    type: Words | None = None
    """Kind by how it reflects: "diffuse reflectance standard", "brushed metal"."""
    shape: Words | None = None
    """As "disc" or "cuboid"."""
    diameter_mm: Positive | None = None
    length_mm: Positive | None = None
    width_mm: Positive | None = None
    height_mm: Positive | None = None
    thickness_mm: Positive | None = None
    zero_azimuth: Words | None = None
    """Where on the sample azimuth 0 is: "toward the mark on its edge"."""
    manufacturer: Words | None = None
    material: Words | None = None
    treatment: Words | None = None
    """What was done to it before the measurement."""


class Instrument(Strict):
    """What the rig's keys do not say of lamp and camera."""

    manufacturer: Words | None = None
    serial_number: Words | None = None
    lamp: Words | None = None
    lamp_type: Words | None = None
    """As "xenon arc" or "LED"."""
    lamp_power_w: Positive | None = None
    lamp_range_nm: tuple[Positive, Positive] | None = None
    """Shortest and longest wavelength of its light."""
    beam_diameter_mm: Positive | None = None
    """Diameter of the beam on the sample."""
    camera: Words | None = None
    camera_range_nm: tuple[Positive, Positive] | None = None
    """Shortest and longest wavelength that the sensor answers to."""

    @field_validator("lamp_range_nm", "camera_range_nm")
    @classmethod
    def _rises(cls, value: tuple[float, float] | None) -> tuple[float, float] | None:
        if value is not None and value[0] >= value[1]:
            raise ValueError("the shortest wavelength comes first, then the longest")
        return value


class Creator(Strict):
    """An author of the data."""

    name: Words
    """As "Family, Given", or that of an organisation."""
    orcid: Orcid | None = None
    affiliation: Words | None = None


class Funding(Strict):
    """Who paid."""

    funder: Words
    award: Words | None = None
    """Its number."""
    title: Words | None = None


class Laboratory(Strict):
    """The table `[laboratory]`."""

    organisation: Words | None = None
    contact: Words | None = None
    """Name of a person."""
    email: Email | None = None
    website: Link | None = None
    operator: Words | None = None
    """Who measured."""
    address: Address = Address()
    sample: Specimen = Specimen()
    instrument: Instrument = Instrument()
    temperature_c: Annotated[float, Field(gt=-273.15)] | None = None
    """Temperature of the room [C], while the sample was measured."""
    u_temperature_c: Annotated[float, Field(ge=0)] | None = None
    relative_humidity_percent: Annotated[float, Field(ge=0, le=100)] | None = None
    title: Words | None = None
    description: Words | None = None
    license: Words | None = None
    """Its short name, as "CC-BY-4.0"."""
    license_link: Link | None = None
    rights_holder: Words | None = None
    creators: tuple[Creator, ...] = ()
    publisher: Words | None = None
    """Who makes the data available; otherwise the organisation."""
    publication_year: Annotated[int, Field(ge=1000, le=9999)] | None = None
    doi: Doi | None = None
    funding: tuple[Funding, ...] = ()

    def stated(self) -> TomlTable:
        """What is stated, and nothing else: nested tables as TOML and JSON have them."""
        return _said(self.model_dump(mode="json", exclude_none=True))


def merged(below: Laboratory | None, above: Laboratory | None) -> Laboratory | None:
    """Two tables as one, key by key; where both state a key, that of `above` counts. A list is one key."""
    if below is None or above is None:
        return below if above is None else above
    return parse(Laboratory, laid_over(below.stated(), above.stated()), "laboratory")


def _said(values: TomlTable) -> TomlTable:
    inner = {key: _said(value) if isinstance(value, dict) else value for key, value in values.items()}
    return {key: value for key, value in inner.items() if value not in ({}, [])}
