"""Which figures of the papers can be made."""

FIGURES = {
    "htsg-6": "specular, directional diffuse and uniform diffuse: the parts of one surface",
    "htsg-7": "rough aluminium at 2.0 µm: a specular spike over a weak lobe",
    "htsg-8": "the same aluminium at 0.5 µm: off-specular lobes, and a spike at 75 degrees",
    "htsg-9": "magnesium oxide ceramic: uniform diffuse, and what emerges at grazing incidence",
    "htsg-10": "sandpaper at normal incidence: bright at grazing reflection",
    "htsg-11": "smooth blue plastic: spikes over a uniform diffuse part, absolute",
    "cook-torrance-3": "Beckmann's and the Gaussian facet distribution, gentle and steep",
    "cook-torrance-4": "spectrum of a copper mirror, and of the daylight that it reflects",
    "cook-torrance-5": "reflectance and colour of copper over the angle of incidence",
    "blinn-5": "Phong's and Torrance and Sparrow's highlights at 30 degrees",
    "blinn-6": "the same at 70 degrees",
    "oren-nayar-5": "radiance of a rough diffuse surface, with and without interreflection",
    "oren-nayar-6": "its BRDF over the incidence, and its radiance outside the plane",
    "oren-nayar-8": "wall plaster",
    "oren-nayar-9": "white sand",
    "oren-nayar-10": "foam: body and surface reflection",
    "oren-nayar-11": "cotton towel: body and surface reflection",
    "oren-nayar-13": "brightness across a clay vase",
}
"""Name and subject of every figure that can be made, in the order of the index."""
