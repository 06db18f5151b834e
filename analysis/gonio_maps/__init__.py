"""A BRDF in every pixel of a sample: `gonio reduce --map`, fits, pages, changes and textures of maps."""
