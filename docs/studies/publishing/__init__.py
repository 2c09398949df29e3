"""Data, policies and entries that the project publishes."""
