"""How good the models are: the papers' own figures made again, and speed against error."""
