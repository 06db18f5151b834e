"""Two measurements, files or models compared point by point."""
