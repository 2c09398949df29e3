"""A local law from the feeder's model: what an agent computes at commissioning, and does each second."""
