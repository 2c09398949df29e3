"""Whether a scenario is worth learning on: what simple rules and perfect foresight reach, and what to change."""
