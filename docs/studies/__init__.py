"""Makers of the data, policies and pages that this project publishes: ``python -m docs.studies COMMAND``."""
