"""Trainings, their scores and the tables of learning algorithms."""
