"""Controllers over scenarios and the fixed test split: units of work, what is kept of them, tables and the report."""
