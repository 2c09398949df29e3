"""What several tests share, one idea a file."""
