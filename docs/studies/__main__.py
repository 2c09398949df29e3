"""Runs ``python -m docs.studies``."""

from docs.studies.commands import main

if __name__ == "__main__":
    main()
