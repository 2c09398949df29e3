"""The search for the least cost of single episodes that no linear program plans, over their actions."""
