"""The command line: ``main`` runs every command; ``run``, ``list``, ``replay`` and ``traces`` are in this folder."""
