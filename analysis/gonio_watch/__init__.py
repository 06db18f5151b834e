"""A run on a page and in the terminal, while it is measured or afterwards: `gonio watch`."""
