"""Controllers with a model of the feeder, and hindsight, which knows the whole episode."""
