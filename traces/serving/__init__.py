"""Requests to language models, the machines that serve them, and the power that this takes."""
