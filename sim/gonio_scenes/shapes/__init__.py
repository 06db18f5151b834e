"""Shapes of a scene: what a scene file says of each, and where rays meet them."""

from typing import Annotated

from pydantic import Field

from gonio_scenes.shapes.analytic import Box, Cylinder, Disc, Plane, Revolution, Sphere
from gonio_scenes.shapes.heightfield import HeightField
from gonio_scenes.shapes.shape import Ints, Shape, ShapeTable, Surface

AnyShape = Annotated[Plane | Disc | Sphere | Cylinder | Box | Revolution | HeightField, Field(discriminator="kind")]
"""The table of any shape, by its `kind`."""

__all__ = [
    "AnyShape",
    "Box",
    "Cylinder",
    "Disc",
    "HeightField",
    "Ints",
    "Plane",
    "Revolution",
    "Shape",
    "ShapeTable",
    "Sphere",
    "Surface",
]
