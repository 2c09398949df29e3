"""What the page of a replay is made of: its HTML, its style and its scripts, which ``replay_page`` puts together."""
