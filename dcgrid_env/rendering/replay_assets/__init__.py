"""HTML, style and scripts of the replay page, which ``replay_page`` combines."""
