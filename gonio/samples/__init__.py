"""Sample files: a model, its parameters, and those that change over the surface; some come with the program."""
