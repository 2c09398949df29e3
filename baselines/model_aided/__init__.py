"""A local law from the feeder's model: what an agent computes at commissioning, and what it does with it each second."""
