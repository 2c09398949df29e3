"""Text files of samples: read in blocks, checked line by line, and given as columns of times and power."""
