"""Training algorithms, one a file; each one's configuration is its command line."""
