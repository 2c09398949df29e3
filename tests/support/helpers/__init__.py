"""What several test files share, one idea a file; pytest finds it by ``pythonpath`` in pyproject.toml.

It stands below ``support`` because ``tests`` itself must not be on the path: its folders bear the packages' names.
"""
