"""Learned policies as they are kept and run: networks of NumPy arrays, their files and cards. Needs no torch."""
