"""Logs of nvidia-smi, and of requests to a language model, read from text files of any size."""
