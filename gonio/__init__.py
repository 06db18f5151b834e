"""The core of the goniometer workbench: directions, rigs, plans, acquisition, radiometry, tables and models."""

__version__ = "0.1.0"
