"""Studies that prove the workbench and serve no measurement: run by hand, with `python -m tools.studies`."""
