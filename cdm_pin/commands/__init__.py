"""The commands of the console script, one module each: ``add_parser`` and ``run``."""
