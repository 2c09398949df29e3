"""The command line: ``main`` runs any command of the table, and ``run``, ``list``, ``replay`` and ``traces`` are here."""
